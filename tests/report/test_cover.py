"""The first lines of the report, the metric grid of its map, and the tracks of its cameras.

Truth: PROJ for the grid, the IANA database's offsets written by hand for the times.
"""

import re
from dataclasses import replace

import numpy as np
import pyproj
import pytest

from unbend.report.cover import PROCESSED, cover_rows, css_text, time_of_processing
from unbend.report.figure_data import metric_grid, track_of_camera
from unbend.report.map_grid_lines import grid_lines

from .manifests import manifest_of
from .test_every_number import air as air  # the fixture
from .test_page import Page, page_of, path_of, points, texts_in, whole_manifest
from .test_page import flown as flown  # the fixture
from .text_tables import lines_of


def page_with(flown, **mission) -> Page:
    manifest = whole_manifest()
    manifest["config"]["mission"] = mission
    return page_of(manifest, flown)


def test_what_the_mission_file_says_stands_first_in_any_letters(flown):
    page = page_with(
        flown,
        title="Zürich Nord — 航空写真 </style><b>",
        client='Amt "A" & B',
        operator="Luftbild GmbH",
        remarks="One.\n\nTwo <i>\nlines.",
        time_zone="Asia/Kathmandu",
    )
    assert "Zürich Nord — 航空写真 </style><b>" in page.texts_of("h1")
    assert page.texts[0][1].startswith("Zürich Nord — 航空写真 </style><b>: refraction")
    assert page.texts_of("dd")[:5] == lines_of("""
        Amt "A" & B
        Luftbild GmbH
        ridge <north> & [red]south
        2025-06-12, 15:23:17 to 15:29:19 Asia/Kathmandu (2025-06-12, 09:38:17 to 09:44:19 UTC)
        WGS 84 (EPSG:4979); heights above mean sea level and above the ellipsoid
    """)
    assert page.texts_of("p")[1:3] == ["One.", "Two <i> lines."]
    assert page.text.count("</style>") == 1
    assert "<b>" not in page.text.split("</style>")[1]
    assert page.text.count(PROCESSED) == 1


def test_a_day_that_is_another_one_here(flown):
    manifest = whole_manifest()
    manifest["config"]["mission"] = {"time_zone": "America/Los_Angeles"}
    manifest["flight"]["begin_utc"] = "2025-06-13T06:50:00Z"
    manifest["flight"]["end_utc"] = "2025-06-13T07:10:00Z"
    rows = cover_rows(manifest_of(manifest), flown)
    assert rows["Flown"] == (
        "2025-06-12, 23:50:00 to 2025-06-13, 00:10:00 America/Los_Angeles "
        "(2025-06-13, 06:50:00 to 07:10:00 UTC)"
    )
    manifest["flight"]["begin_utc"] = None
    manifest["flight"]["end_utc"] = None
    rows = cover_rows(manifest_of(manifest), flown)
    assert "unknown" in rows["Flown"]

    manifest["config"]["mission"]["date"] = "2025-06-12"
    rows = cover_rows(manifest_of(manifest), flown)
    assert rows["Flown"] == "2025-06-12 (stated)"

    manifest["config"]["stations"] = {"orientation": {"date": "2025-06-13T09:30"}}
    rows = cover_rows(manifest_of(manifest), flown)
    assert rows["Flown"] == "2025-06-13T09:30 (stated)"


def test_the_time_of_processing_has_its_zone():
    """2026-07-01 is summer time in Zurich, two hours ahead."""
    time_s = np.datetime64("2026-07-01T10:00:00").astype(np.int64)
    in_zone = time_of_processing(time_s, "Europe/Zurich")
    assert in_zone == "2026-07-01 12:00 Europe/Zurich"
    assert time_of_processing(time_s, None) == "2026-07-01 10:00 UTC"


@pytest.mark.parametrize(
    "text",
    [
        '"; } body { display: none',
        "</style>",
        "back\\slash",
        "line\nbreak",
        "é 航 ½",
    ],
)
def test_a_text_in_a_style_sheet_ends_where_it_should(text):
    content = css_text(text)[1:-1]
    assert not set(content) & set('"<>{}\n')
    assert re.sub(r"\\([0-9a-f]+) ", character, content) == text


def character(escape):
    return chr(int(escape[1], 16))


# ---------------------------------------------------------------- the metric grid

START_S = 1_749_718_800
PLACES = {
    "zone 32 north": ((8.48, 8.72, 47.33, 47.52), "EPSG:32632"),
    "south, near the edge of a zone": ((17.9, 18.1, -34.0, -33.8), "EPSG:32734"),
    "the 180th meridian": ((179.9, 180.1, -17.1, -16.9), "EPSG:32701"),
}


@pytest.mark.parametrize(("limits", "code"), PLACES.values(), ids=PLACES)
def test_the_lines_of_the_grid_are_where_proj_has_them(limits, code):
    grid = metric_grid(limits)
    assert grid.identifier == code
    lines = grid_lines(grid, limits[:2], limits[2:])
    assert 4 <= len(lines) <= 14
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", code, always_xy=True)
    eastings = []
    northings = []
    for line in lines:
        is_drawn = np.isfinite(line.lon_deg)
        longitude = line.lon_deg[is_drawn]
        latitude = line.lat_deg[is_drawn]
        assert longitude.min() >= limits[0]
        assert latitude.max() <= limits[3]
        metres = float(line.label.replace("\u202f", ""))
        x, y = to_grid.transform(longitude, latitude)
        if line.is_easting:
            eastings.append(metres)
            np.testing.assert_allclose(x, metres, atol=1e-3)
        else:
            northings.append(metres)
            np.testing.assert_allclose(y, metres, atol=1e-3)
    assert eastings
    assert northings
    assert len(set(np.diff(eastings))) <= 1
    assert len(set(np.diff(northings))) <= 1


def test_nearer_to_a_pole_there_is_no_grid(flown):
    assert metric_grid((10.0, 11.0, 84.5, 84.9)) is None
    assert metric_grid((10.0, 70.0, 40.0, 41.0)) is None, "a place that is far off the flight"
    page = page_of(whole_manifest(), replace(flown, grid=None))
    assert 'class="metric"' not in page.text


def test_the_map_has_the_grid_beside_degrees(flown):
    with_grid = replace(flown, grid=metric_grid(flown.limits_deg))
    page = page_of(whole_manifest(), with_grid)
    for screen in ("wide", "narrow"):
        drawing = page.drawings["map", screen]
        labels = []
        for text in drawing.iter("text"):
            if "metric" in text.get("class", ""):
                labels.append(text.text)
        assert len(labels) >= 3
        for label in labels:
            assert re.fullmatch("[0-9\u202f]+", label)
        ticks = texts_in(drawing, class_="tick")
        assert any("." in tick for tick in ticks)  # degrees
    assert "UTM zone 32S, numbers in metres" in page.text
    assert "map grid UTM zone 32S (EPSG:32732)" in page.text


# ---------------------------------------------------------------- tracks of cameras


def test_each_camera_has_a_line_with_its_own_colour_and_style(flown):
    page = page_of(whole_manifest(), flown)
    for figure in ("map", "height"):
        drawing = page.drawings[figure, "wide"]
        belly = points(path_of(drawing, "line camera c1 s1"))
        tail = points(path_of(drawing, "line camera c2 s2"))
        assert len(belly) == 2
        assert len(tail) == 1  # of its two exposures one cannot be used
        assert belly[0][0] < belly[1][0]
    styles = re.findall(r"\.s(\d) \{ stroke-dasharray: ([\d ]+)", page.text)
    numbers, dashes = zip(*styles, strict=True)
    assert "".join(numbers) == "2345678"
    assert len(set(dashes)) == 7


def test_a_camera_alone_has_no_line_of_its_own(flown):
    alone = whole_manifest()
    del alone["correction"]["cameras"]["tail"]
    del alone["flight"]["cameras"]["tail"]
    for drawing in page_of(alone, flown).drawings.values():
        for path in drawing.iter("path"):
            assert "line camera" not in str(path.attrib)


def test_a_track_is_in_the_order_of_time_and_ends_with_its_strip(flown):
    seconds = np.array([30.0, 0.0, 10.0, 20.0, 500.0, 510.0, 5.0])
    exposures = {
        "image": np.array([f"i{n}" for n in range(7)], dtype=object),
        "camera": np.array([*"aaaaaab"], dtype=object),
        "time_ns": (1e9 * (START_S + seconds)).astype(np.int64),
        "lat_deg": 47.0 + seconds / 1000.0,
        "lon_deg": 8.0 + seconds / 1000.0,
        "h_msl_m": 3000.0 + seconds,
        "ground_m": np.full(7, 500.0),
        "status": np.full(7, "ok", object),
        "shown_as": np.full(7, "ok"),
    }
    track = {name: column[:0] for name, column in flown.track.items()}
    track_of_a = track_of_camera(replace(flown, exposures=exposures, track=track), "a")
    np.testing.assert_allclose(track_of_a.h_msl_m, [3000, 3010, 3020, 3030, np.nan, 3500, 3510])
    np.testing.assert_allclose(track_of_a.time, [0, 10, 20, 30, np.nan, 500, 510])
