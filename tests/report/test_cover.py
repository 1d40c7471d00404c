"""The first lines of the report, the metric grid of its map, and the tracks of its cameras.

Truth: PROJ for the grid, the IANA database's offsets written by hand for the times.
"""

import copy
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pyproj
import pytest

from unbend.report.cover import PROCESSED, cover_rows, css_text, time_of_processing
from unbend.report.flown import metric_grid, track_of_camera
from unbend.report.html import report_page
from unbend.report.map_grid_lines import grid_lines

from .manifests import manifest_of
from .test_every_number import air as air  # the fixture
from .test_page import Page, path_of, points, whole_manifest
from .test_page import flown as flown  # the fixture
from .text_tables import lines_of


def page_with(flown: Any, **mission: str) -> str:
    manifest = whole_manifest()
    manifest["config"]["mission"] = mission
    return report_page(manifest_of(manifest), flown)


def test_what_the_mission_file_says_stands_first_in_any_letters(flown):
    text = page_with(
        flown,
        title="Zürich Nord — 航空写真 </style><b>",
        client='Amt "A" & B',
        operator="Luftbild GmbH",
        remarks="One.\n\nTwo <i>\nlines.",
        time_zone="Asia/Kathmandu",
    )
    shown = Page(text).texts
    assert ("h1", "Zürich Nord — 航空写真 </style><b>") in shown
    assert shown[0][1].startswith("Zürich Nord — 航空写真 </style><b>: refraction")
    said = [words for tag, words in shown if tag == "dd"][:5]
    assert said == lines_of("""
        Amt "A" & B
        Luftbild GmbH
        ridge <north> & [red]south
        2025-06-12, 15:23:17 to 15:29:19 Asia/Kathmandu (2025-06-12, 09:38:17 to 09:44:19 UTC)
        WGS 84 (EPSG:4979); heights above mean sea level and above the ellipsoid
    """)
    assert [words for tag, words in shown if tag == "p"][1:3] == ["One.", "Two <i> lines."]
    assert text.count("</style>") == 1
    assert "<b>" not in text.replace("<b>", "", 0).split("</style>")[1]
    assert text.count(PROCESSED) == 1


def test_without_those_keys_the_name_is_the_title(flown):
    shown = Page(report_page(manifest_of(whole_manifest()), flown)).texts
    assert ("h1", "ridge <north> & [red]south") in shown
    assert not any(words in ("Client", "Operator", "Mission") for _, words in shown)


def test_a_day_that_is_another_one_here(flown):
    manifest = whole_manifest()
    manifest["config"]["mission"] = {"time_zone": "America/Los_Angeles"}
    manifest["flight"] |= {"begin_utc": "2025-06-13T06:50:00Z", "end_utc": "2025-06-13T07:10:00Z"}
    rows = cover_rows(manifest_of(manifest), flown)
    assert rows["Flown"] == (
        "2025-06-12, 23:50:00 to 2025-06-13, 00:10:00 America/Los_Angeles "
        "(2025-06-13, 06:50:00 to 07:10:00 UTC)"
    )
    manifest["flight"] |= {"begin_utc": None, "end_utc": None}
    assert "unknown" in cover_rows(manifest_of(manifest), flown)["Flown"]


def test_the_time_of_processing_has_its_zone():
    """2026-07-01 is summer time in Zurich, two hours ahead."""
    time_s = np.datetime64("2026-07-01T10:00:00").astype(np.int64)
    assert time_of_processing(time_s, "Europe/Zurich") == "2026-07-01 12:00 Europe/Zurich"
    assert time_of_processing(time_s, None) == "2026-07-01 10:00 UTC"


def test_a_text_in_a_style_sheet_ends_where_it_should():
    for text in ('"; } body { display: none', "</style>", "back\\slash", "line\nbreak", "é 航 ½"):
        string = css_text(text)
        assert not set(string[1:-1]) & set('"<>{}\n')
        unescaped = re.sub(r"\\([0-9a-f]+) ", lambda match: chr(int(match[1], 16)), string[1:-1])
        assert unescaped == text


# ---------------------------------------------------------------- the metric grid

PLACES = {
    "zone 32 north": ((8.48, 8.72), (47.33, 47.52), "EPSG:32632"),
    "south, near the edge of a zone": ((17.9, 18.1), (-34.0, -33.8), "EPSG:32734"),
    "the 180th meridian": ((179.9, 180.1), (-17.1, -16.9), "EPSG:32701"),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_lines_of_the_grid_are_where_proj_has_them(place):
    lon, lat, code = PLACES[place]
    grid = metric_grid((*lon, *lat))
    assert grid.identifier == code
    lines = grid_lines(grid, lon, lat)
    assert {line.is_easting for line in lines} == {True, False}
    assert 4 <= len(lines) <= 14
    to_grid = pyproj.Transformer.from_crs("EPSG:4326", code, always_xy=True)
    for line in lines:
        known = np.isfinite(line.lon_deg)
        x, y = to_grid.transform(line.lon_deg[known], line.lat_deg[known])
        value = float(line.label.replace("\u202f", ""))
        np.testing.assert_allclose(x if line.is_easting else y, value, atol=1e-3)
        assert (line.lon_deg[known] >= lon[0]).all()
        assert (line.lat_deg[known] <= lat[1]).all()
    for kind in (True, False):
        values = [
            float(line.label.replace("\u202f", "")) for line in lines if line.is_easting is kind
        ]
        assert len(set(np.diff(values))) <= 1


def test_nearer_to_a_pole_there_is_no_grid(flown):
    assert metric_grid((10.0, 11.0, 84.5, 84.9)) is None
    assert metric_grid((10.0, 70.0, 40.0, 41.0)) is None, "a place that is far off the flight"
    without = report_page(manifest_of(whole_manifest()), replace(flown, grid=None))
    assert 'class="metric"' not in without


def test_the_map_has_the_grid_beside_degrees(flown):
    with_grid = replace(flown, grid=metric_grid(flown.limits_deg))
    page = Page(report_page(manifest_of(whole_manifest()), with_grid))
    for screen in ("wide", "narrow"):
        drawing = page.drawings["map", screen]
        labels = [t.text for t in drawing.iter("text") if "metric" in (t.get("class") or "")]
        assert len(labels) >= 3
        assert all(re.fullmatch("[0-9\u202f]+", label) for label in labels)
        ticks = [t.text for t in drawing.iter("text") if t.get("class") == "tick"]
        assert any("." in tick for tick in ticks), "degrees"
    assert "UTM zone 32S, numbers in metres" in page.text
    assert "map grid UTM zone 32S (EPSG:32732)" in page.text


# ---------------------------------------------------------------- tracks of cameras


def test_each_camera_has_a_line_with_its_own_colour_and_style(flown):
    page = Page(report_page(manifest_of(whole_manifest()), flown))
    for figure in ("map", "height"):
        drawing = page.drawings[figure, "wide"]
        belly = points(path_of(drawing, "line camera c1 s1"))
        tail = points(path_of(drawing, "line camera c2 s2"))
        assert len(belly) == 2
        assert len(tail) == 1  # of its two exposures one cannot be used
        assert belly[0][0] < belly[1][0]
    styles = re.findall(r"\.s(\d) \{ stroke-dasharray: ([\d ]+)", page.text)
    assert [number for number, _ in styles] == [str(number) for number in range(2, 9)]
    assert len({dashes for _, dashes in styles}) == 7
    alone = whole_manifest()
    for part in (alone["correction"]["cameras"], alone["flight"]["cameras"]):
        part.pop("tail")
    assert "line camera" not in re.sub(
        r"<style.*?</style>", "", report_page(manifest_of(alone), flown), flags=re.S
    )


def test_a_track_is_in_the_order_of_time_and_ends_with_its_strip(flown):
    seconds = np.array([30.0, 0.0, 10.0, 20.0, 500.0, 510.0, 5.0])
    exposures = {
        "image": np.array([f"i{n}" for n in range(7)], dtype=object),
        "camera": np.array(["a"] * 6 + ["b"], dtype=object),
        "time_ns": (1e9 * (1_749_718_800 + seconds)).astype(np.int64),
        "lat_deg": 47.0 + seconds / 1000.0,
        "lon_deg": 8.0 + seconds / 1000.0,
        "h_msl_m": 3000.0 + seconds,
        "ground_m": np.full(7, 500.0),
        "status": np.array(["ok"] * 7, dtype=object),
        "shown_as": np.array(["ok"] * 7),
    }
    track = {name: column[:0] for name, column in flown.track.items()}
    own = track_of_camera(replace(copy.copy(flown), exposures=exposures, track=track), "a")
    np.testing.assert_allclose(own.h_msl_m, [3000, 3010, 3020, 3030, np.nan, 3500, 3510])
    np.testing.assert_allclose(own.time, [0, 10, 20, 30, np.nan, 500, 510])
