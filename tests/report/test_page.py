"""The page of a manifest in which every number differs: its cells, and what its figures draw.

The expected texts are written by hand from the manifest. What is drawn is read back from the SVG
with the numbers at its axes, and compared with the manifest and with the table behind the figure.
"""

import copy
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import yaml

from unbend.flight.ground_times import LoggedPath
from unbend.flight.stations import empty_stations
from unbend.refraction.camera.camera import Camera
from unbend.report.air_curves import air_curves
from unbend.report.figure_data import Flown, flown_of
from unbend.report.report_page import report_page

from .manifests import manifest_of
from .test_every_number import (
    AIR,
    AIR_AT_2000_M,
    CORRECTION,
    EFFECTS,
    LEDGER,
    MANIFEST,
    SAMPLES,
    SENSORS,
    SOURCES,
    STEPS,
    VERDICT,
)
from .test_every_number import air as air  # the fixture
from .text_tables import lines_of, rows_of

BEGIN_NS = int(np.datetime64("2025-06-12T09:30:00", "ns").astype(np.int64))

MORE = """
correction:
  cameras:
    belly:
      histogram_px: {step: 0.5, counts: [3, 0, 17]}
      histogram_m: {step: 0.1, counts: [11, 29]}
      field:
        format_px: [2800, 2000]
        columns: 14
        x_px: [100.0, 1500.0]
        y_px: [100.0, 1900.0]
        dx_px: [3.3, 0.0]
        dy_px: [4.4, -2.5]
    tail:
      histogram_px: {step: 0.2, counts: [5, 31]}
      histogram_m: {step: 0.1, counts: [2, 37]}
      field:
        format_px: [2800, 2000]
        columns: 14
        x_px: [100.0, 1500.0]
        y_px: [100.0, 1900.0]
        dx_px: [-0.5, -0.25]
        dy_px: [0.0, 0.0]
observations: {causes: {no_ground: no height <is> known}}
config: {ground: {height: {column: h_g_m}}}
flight:
  begin_utc: "2025-06-12T09:38:17Z"
  end_utc: "2025-06-12T09:44:19Z"
  latitude_deg: [-47.5, -47.4233, -47.3]
  longitude_deg: [8.5, 8.6624, 8.7]
  h_msl_m: [3445.2, 3450.1, 3454.4]
  cameras:
    belly:
      exposures: 61
      format_px: [2800, 2000]
      principal_distance_px: 4567.25
      principal_point_px: [1402.5, 997.25]
      height_above_ground_m: [2823.4, 2927.3, 3061.2]
      axis_nadir_angle_deg: 1.66
      nadir_px: [1407.0, 1011.0]
    tail:
      exposures: 34
      format_px: [2800, 2000]
      principal_distance_px: 3210.0
      height_above_ground_m: null
      axis_nadir_angle_deg: 45.24
      nadir_px: [-4567.0, 1003.0]
sigma_budget:
  belly:
    air: {px: {median: 0.011, p95: 0.022}, m: {median: 0.0033, p95: 0.0077}}
    station: {px: {median: 0.023, p95: 0.046}, m: {median: 0.0069, p95: 0.0161}}
    all: {px: {median: 0.031, p95: 0.062}, m: {median: 0.0093, p95: 0.0217}}
  tail:
    air: {px: {median: 0.0051, p95: 0.0102}, m: {median: 0.00153, p95: 0.00357}}
    ground: {px: {median: 0.0071, p95: 0.0142}, m: {median: 0.00213, p95: 0.00497}}
    cabin: {px: {median: 0.0083, p95: 0.0166}, m: {median: 0.00249, p95: 0.00581}}
    all: {px: {median: 0.0097, p95: 0.0194}, m: {median: 0.00291, p95: 0.00679}}
ground_heights:
  lowest_m: 392.21
  median_m: 512.05
  highest_m: 629.24
  histogram: {first_m: 350.0, step: 100.0, counts: [7, 41, 19]}
heights:
  stations: GPS[0]
  undulation: {source: EGM96, min_m: 46.31, max_m: 47.62}
log: {format: dataflash, duration_s: 1349.9, time_base: GPS <x>}
versions: {unbend: 9.8.7, numpy: 2.3.4}
fingerprint: f00df00df00df00df00df00df00df00df00df00df00df00df00df00df00df00d
exit_code: 3
"""
"""What only the page shows; of the sigma budget no number occurs twice."""


def whole_manifest():
    """The manifest of the other tests, with what only the page shows."""
    return with_sections(copy.deepcopy(MANIFEST), yaml.safe_load(MORE))


def with_sections(values, more):
    """Values with more of them within their sections."""
    for key, value in more.items():
        is_section = isinstance(values.get(key), dict)
        values[key] = with_sections(values[key], value) if is_section else value
    return values


@pytest.fixture(scope="module")
def flown(air) -> Flown:
    seconds = np.array([0.0, 300.0, 600.0, 900.0])
    time_ns = BEGIN_NS + (1e9 * seconds).astype(np.int64)
    exposures = {
        "image": np.array(["b1", "b2", "t<1>", "t2"], dtype=object),
        "camera": np.array(["belly", "belly", "tail", "tail"], dtype=object),
        "time_ns": time_ns + 60 * 10**9,
        "lat_deg": np.array([-47.401, -47.412, -47.424, -47.435]),
        "lon_deg": np.array([8.611, 8.623, 8.634, 8.646]),
        "h_msl_m": np.array([3401.0, 3412.0, 3423.0, 3434.0]),
        "ground_m": np.array([501.0, 512.0, 523.0, np.nan]),
        "status": np.array(["ok", "ok", "suspect", "in_gap"], dtype=object),
        "shown_as": np.array(["ok", "ok", "suspect", "unusable"]),
    }
    track = {
        "time_ns": time_ns,
        "lat_deg": np.array([-47.39, -47.41, -47.43, -47.44]),
        "lon_deg": np.array([8.60, 8.62, 8.64, 8.65]),
        "h_msl_m": np.array([450.0, 3400.0, 3420.0, 460.0]),
    }
    corners = np.array([[[8.60, -47.40], [8.62, -47.40], [8.62, -47.42], [8.60, -47.42]]])
    return Flown(
        exposures=exposures,
        counts={"ok": 5, "suspect": 1, "unusable": 1},
        track=track,
        footprints={"belly": corners, "tail": corners + 0.01},
        footprint_count=4,
        limits_deg=(8.60, 8.65, -47.44, -47.39),
        relief=None,
        air=air_curves(air, SAMPLES, np.array([700.0, 3700.0])),
    )


class Page(HTMLParser):
    """Tables by the heading above them, list items and paragraphs of a page, and its drawings."""

    def __init__(self, text):
        super().__init__()
        self.text = text
        self.drawings: dict[tuple[str, str], ET.Element] = {}
        for name, figure in re.findall(r'<figure id="figure-(\w+)">(.*?)</figure>', text, re.S):
            drawings = re.findall(r'(?s)(?=<svg class="(wide|narrow)")(.*?</svg>)', figure)
            for screen, svg in drawings:
                self.drawings[name, screen] = ET.fromstring(svg)
        self.tables: dict[str, list[list[list[str]]]] = {}
        self.texts: list[tuple[str, str]] = []
        self._cell = ""
        self._heading = ""
        self.feed(re.sub(r"<svg.*?</svg>|<nav.*?</nav>|<style.*?</style>", "", text, flags=re.S))

    def texts_of(self, tag):
        """The texts of all elements of a kind, in their order."""
        return [text for element, text in self.texts if element == tag]

    def caption(self, begin):
        """The caption of the figure that begins with these words."""
        (caption,) = (text for text in self.texts_of("figcaption") if text.startswith(begin))
        return caption

    def handle_starttag(self, tag, attrs):
        self._cell = self._cell if tag in ("code", "br", "span") else ""
        if tag == "table":
            self.tables.setdefault(self._heading, []).append([])
        elif tag == "tr":
            self.tables[self._heading][-1].append([])

    def handle_data(self, data):
        self._cell += data

    def handle_endtag(self, tag):
        cell = " ".join(self._cell.split())
        if tag in ("td", "th"):
            self.tables[self._heading][-1][-1].append(cell)
        elif tag in ("h1", "h2", "h3", "p", "li", "title", "dd", "figcaption"):
            self.texts.append((tag, cell))
            self._heading = cell if tag == "h2" else self._heading
        if tag not in ("code", "br", "span"):
            self._cell = ""


def page_of(values, flown) -> Page:
    return Page(report_page(manifest_of(values), flown))


@pytest.fixture(scope="module")
def page(flown) -> Page:
    return page_of(whole_manifest(), flown)


def texts_in(panel: ET.Element, **attributes):
    """The texts of a drawing that have these attributes; class_ is the class."""
    wanted = {name.strip("_").replace("_", "-"): value for name, value in attributes.items()}
    return [text.text or "" for text in panel.iter("text") if wanted.items() <= text.attrib.items()]


def test_every_cell_of_the_tables(page):
    (cameras,) = page.tables["Flight"]
    assert cameras == rows_of("""
        camera | exposures | format | principal distance \
            | principal point, from the upper left corner | axis from nadir | above ground | window
        belly | 61 | 2800 × 2000 px | 4567.25 px | 1402.5, 997.25 px | 1.7° \
            | 2823 to 3061 m, median 2927 m | none
        tail | 34 | 2800 × 2000 px | 3210 px | unknown | 45.2° | unknown | plane
    """)
    correction, sizes = page.tables["How large the correction is"]
    assert correction == CORRECTION
    assert sizes == rows_of("""
        camera            | from | to  | observations
        belly, image [px] | 0    | 0.5 | 3
        belly, image [px] | 0.5  | 1   | 0
        belly, image [px] | 1    | 1.5 | 17
        belly, ground [m] | 0    | 0.1 | 11
        belly, ground [m] | 0.1  | 0.2 | 29
        tail, image [px]  | 0    | 0.2 | 5
        tail, image [px]  | 0.2  | 0.4 | 31
        tail, ground [m]  | 0    | 0.1 | 2
        tail, ground [m]  | 0.1  | 0.2 | 37
    """)
    (field,) = page.tables["The correction over the image"]
    assert field == rows_of("""
        camera | x [px] | y [px] | dx [px]  | dy [px]
        belly  | 100    | 100    | 3.30000  | 4.40000
        belly  | 1500   | 1900   | 0.00000  | -2.50000
        tail   | 100    | 100    | -0.50000 | 0.00000
        tail   | 1500   | 1900   | -0.25000 | 0.00000
    """)
    _, sources, samples, sensors = page.tables["The air"]
    assert (sources, sensors) == (SOURCES, SENSORS)
    assert samples == rows_of("""
        sensor            | sample                | count
        BARO[0], pressure | used                  | 1,203
                          | no value              | 27
                          | no height at its time | 4
    """)
    (budget,) = page.tables["Sigma budget"]
    assert budget == rows_of("""
                             | median    | 95 %     | median, ground | 95 %, ground
        belly
        the shift itself     | 1 px      | 1 px     | 1.1 m          | 1.1 m
        sigma: air outside   | 0.011 px  | 0.022 px | 3.3 mm         | 7.7 mm
        sigma: station       | 0.023 px  | 0.046 px | 6.9 mm         | 16 mm
        sigma: all parts     | 0.031 px  | 0.062 px | 9.3 mm         | 22 mm
        tail
        the shift itself     | 2 px      | 2 px     | 2.1 m          | 2.1 m
        sigma: air outside   | 0.0051 px | 0.01 px  | 1.5 mm         | 3.6 mm
        sigma: ground height | 0.0071 px | 0.014 px | 2.1 mm         | 5 mm
        sigma: cabin or lens | 0.0083 px | 0.017 px | 2.5 mm         | 5.8 mm
        sigma: all parts     | 0.0097 px | 0.019 px | 2.9 mm         | 6.8 mm
    """)
    (ground,) = page.tables["Ground heights used"]
    assert ground == rows_of("""
               | from [m] | to [m] | observations
        ground | 350      | 450    | 7
        ground | 450      | 550    | 41
        ground | 550      | 650    | 19
    """)
    observations, stations = page.tables["Rows by status"]
    assert observations == rows_of("""
        observations                                                         | number | share
        ok corrected                                                         | 4,987  | 99.3 %
        no_ground not corrected: no ground heightCause: no height <is> known | 13     | 0.259 %
        misses_ground not corrected: the ray does not reach the ground       | 21     | 0.418 %
    """)
    assert stations == rows_of("""
        stations                   | number | share
        ok usable                  | 88     | 92.6 %
        in_gap in a gap of the log | 7      | 7.37 %
    """)
    (inputs,) = page.tables["Provenance"]
    assert inputs == [
        ["input", "file", "SHA-256"],
        ["log", "a&b.bin", "0123456789abcdef" * 4],
        ["observations", "o.csv", "fedcba9876543210" * 4],
    ]


def test_every_sentence_between_the_tables(page):
    title = "ridge <north> & [red]south: refraction correction, report of unbend"
    assert page.texts[0] == ("title", title)
    assert "ridge <north> & [red]south" in page.texts_of("h1")
    assert page.texts_of("h2") == lines_of("""
        Flight
        Map
        Height against time
        How large the correction is
        The correction over the image
        The air
        Sigma budget
        Ground heights used
        Rows by status
        Ledger
        What is not removed
        How to use the results in the adjustment
        Provenance
    """)
    assert page.texts_of("dd") == lines_of(f"""
        2025-06-12, 09:38:17 to 09:44:19 UTC
        WGS 84 (EPSG:4979); heights above mean sea level and above the ellipsoid
        95 exposures, 2025-06-12, 09:38:17 to 09:44:19 UTC
        47.4233° S, 8.6624° E (WGS 84, middle of the exposures)
        3445 to 3454 m above mean sea level, by GPS[0]
        46.3 to 47.6 m, by EGM96
        dataflash, 22.5 minutes; time base: GPS <x>
        unbend 9.8.7, method spherical
        {"f00d" * 16}
        outside pressure from BARO[0], temperature from <b>HYGR[0]
        numpy 2.3.4, unbend 9.8.7
    """)
    heights = (
        "From column h_g_m of the observations: 392.2 to 629.2 m above mean sea level, median "
        "512.0 m."
    )
    assert {VERDICT, AIR, *EFFECTS, heights} <= set(page.texts_of("p"))
    items = page.texts_of("li")
    assert {*STEPS, "METAR: 61 km away"} <= set(items)
    ledger = [f"{sentence} {code}" for _, code, sentence in LEDGER]
    assert [item for item in items if item in ledger] == ledger
    assert page.texts_of("h3") == lines_of("""
        Lost or damaged (2)
        Warnings (1)
        Replaced by a substitute (1)
        Notes (1)
    """)
    arrows = "The arrows are the correction: corrected minus measured coordinates."
    assert arrows in page.caption("Mean correction")
    counts = "4 of 7 exposures are shown. 2 of 4 footprints are shown."
    assert counts in page.caption("Map of the flight")
    assert "5 exposures, ok" in page.text
    samples = "samples: temperature hygr[0], 1 of 3 used; pressure baro[0], 2 of 2 used"
    assert samples in page.text.lower()


def numbers(text):
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", text)]


def points(path):
    """(n, 2) absolute places of M and L in a path."""
    return np.array([numbers(m)[:2] for m in re.findall(r"[ML](-?[\d.]+ -?[\d.]+)", path)])


def arrows(path):
    """(n, 4) places and directions of the arrows of a path."""
    return np.array(re.findall(r"M(\S+) (\S+)l(\S+) (\S+)l", path), np.float64)


def scale(panel: ET.Element, axis, value_of=float):
    """A function from pixels to values, from the numbers at an axis: x below it, y beside it."""
    anchor = {"x": "middle", "y": "end"}[axis]
    shift = {"x": 0.0, "y": -4.0}[axis]  # a text stands on its line
    pixels = []
    values = []
    for text in panel.iter("text"):
        is_tick = text.get("class") == "tick" and text.get("text-anchor") == anchor
        if is_tick and re.fullmatch(r"[-\d,.:]+", text.text or ""):
            pixels.append(float(text.get(axis, "")) + shift)
            values.append(value_of(text.text.replace(",", "")))
    assert len(pixels) >= 2
    if len(pixels) > 2:
        # The last number of an axis may stand left of its tick, where there is no room for it.
        pixels.pop()
        values.pop()
    slope, offset = np.polyfit(pixels, values, 1)
    return lambda place: slope * np.asarray(place) + offset


def path_of(panel: ET.Element, css):
    (path,) = (path for path in panel.iter("path") if path.get("class") == css)
    return path.get("d", "")


def places(panel: ET.Element, css, x, y):
    """(n, 2) values of the points of a path."""
    drawn = points(path_of(panel, css))
    return np.stack([x(drawn[:, 0]), y(drawn[:, 1])], axis=1)


both_screens = pytest.mark.parametrize("screen", ["wide", "narrow"])


@both_screens
def test_the_map_shows_every_place(page, flown, screen):
    drawing = page.drawings["map", screen]
    x = scale(drawing, "x")
    y = scale(drawing, "y")
    for css, columns, rows in (
        ("line track", flown.track, [0, 1, 2, 3]),
        ("dots small", flown.exposures, [0, 1]),
        ("line suspect", flown.exposures, [2]),
        ("line unusable", flown.exposures, [3]),
    ):
        expected = np.stack([columns["lon_deg"][rows], columns["lat_deg"][rows]], axis=1)
        assert places(drawing, css, x, y) == pytest.approx(expected, abs=2e-4)
    for css, name in (("area c1 s1", "belly"), ("area c2 s2", "tail")):
        corners = flown.footprints[name][0]
        assert places(drawing, css, x, y) == pytest.approx(corners, abs=2e-4)
    # North is up, the scale is the same along both axes, and the bar is as long as it says.
    east_m = 111_200.0 * (x(1.0) - x(0.0)) * np.cos(np.radians(47.415))
    north_m = 111_200.0 * (y(0.0) - y(1.0))
    assert east_m == pytest.approx(north_m, rel=0.02)
    bar_px = numbers(path_of(drawing, "scale"))[3]
    (label,) = (text for text in texts_in(drawing) if re.fullmatch(r"[\d.]+ k?m", text))
    metres = numbers(label)[0] * (1000.0 if "km" in label else 1.0)
    assert bar_px * east_m == pytest.approx(metres, rel=0.03)


def minutes(time):
    hours, minutes_of_hour = time.split(":")
    return 60.0 * float(hours) + float(minutes_of_hour)


@both_screens
def test_heights_against_time(page, flown, screen):
    drawing = page.drawings["height", screen]
    y = scale(drawing, "y")
    x = scale(drawing, "x", minutes)
    track = places(drawing, "line track", x, y)
    assert track[:, 0] == pytest.approx([570.0, 575.0, 580.0, 585.0], abs=0.05)
    assert track[:, 1] == pytest.approx(flown.track["h_msl_m"], abs=10.0)
    exposures = places(drawing, "dots small", x, y)
    assert exposures[:, 0] == pytest.approx([571.0, 576.0], abs=0.05)
    ground = places(drawing, "dots small ground", x, y)
    assert ground[:, 1] == pytest.approx([501.0, 512.0, 523.0], abs=10.0)
    table = page.tables["Height against time"][0]
    assert [table[1], *table[4:6]] == rows_of("""
        b1      | 2025-06-12 09:31:00 | 3401.0 | 501.0 | 2900.0
        t2      | 2025-06-12 09:46:00 | 3434.0 | –     | –
        (track) | 2025-06-12 09:30:00 | 450.0  |       |
    """)
    assert len(table) == 9


BARS = yaml.safe_load("""
- [belly, image, 0, 0.5, [3, 0, 17]]
- [belly, ground, 0, 0.1, [11, 29]]
- [tail, image, 0, 0.2, [5, 31]]
- [tail, ground, 0, 0.1, [2, 37]]
- [ground, height, 350, 100.0, [7, 41, 19]]
""")


@both_screens
def test_every_bar(page, screen):
    panels = page.drawings["size", screen].findall(".//g")
    panels += page.drawings["ground", screen].findall(".//g")
    for panel, (name, quantity, first, step, counts) in zip(panels, BARS, strict=True):
        labels = texts_in(panel, class_="label")
        assert any(name in label and quantity in label for label in labels)
        (bars,) = (p for p in panel.iter("path") if (p.get("class") or "").startswith("bar"))
        x = scale(panel, "x")
        y = scale(panel, "y")
        drawn = np.zeros(len(counts))
        for bar in re.findall(r"M(\S+) \S+V(\S+)H(\S+)V", bars.get("d", "")):
            left, top, right = map(float, bar)
            assert x(right) - x(left) == pytest.approx(step, rel=0.05)
            drawn[round((float(x(left)) - first) / step)] = y(top)
        assert drawn == pytest.approx(counts, abs=0.5)


@both_screens
def test_every_arrow_and_the_nadir_point(page, screen):
    belly, tail = page.drawings["field", screen].findall(".//g")
    x = scale(belly, "x")
    y = scale(belly, "y")
    drawn = arrows(path_of(belly, "arrow c1"))
    assert x(drawn[:, 0]) == pytest.approx([100.0, 1500.0], abs=6.0)
    assert y(drawn[:, 1]) == pytest.approx([100.0, 1900.0], abs=6.0)  # y of images points down
    assert drawn[0, 3] / drawn[0, 2] == pytest.approx(4.0 / 3.0, rel=0.02)
    assert drawn[0, 3] > 0.0 > drawn[1, 3]
    assert y(100.0) < y(200.0)
    # The arrow for reference has the scale of the others: 5.5 px is the longest.
    ((_, _, length_px, _),) = arrows(path_of(belly, "arrow reference"))
    (label,) = (text for text in texts_in(belly) if "correction of" in text)
    longest_px = np.hypot(*drawn[0, 2:])
    assert length_px / longest_px == pytest.approx(numbers(label)[0] / 5.5, rel=0.03)
    (mark,) = belly.iter("circle")
    assert x(float(mark.get("cx", ""))) == pytest.approx(1407.0, abs=6.0)
    assert y(float(mark.get("cy", ""))) == pytest.approx(1011.0, abs=6.0)
    assert "nadir point, 4,567 px outside" in texts_in(tail)
    ((_, _, to_the_left, down),) = arrows(path_of(tail, "arrow nadir"))
    assert to_the_left < -20.0
    assert abs(down) < 1.0


@both_screens
def test_every_curve_of_the_air(page, screen):
    panels = page.drawings["air", screen].findall(".//g")
    for panel, (label, ours, sigma, standard) in zip(panels, AIR_AT_2000_M, strict=True):
        assert texts_in(panel, class_="label")[0] == label
        x = scale(panel, "x")
        y = scale(panel, "y")
        pixel = float(abs(x(1.0) - x(0.0)))
        lines = {
            ours: places(panel, "line adjusted", x, y),
            standard: places(panel, "line standard", x, y),
        }
        edges = places(panel, "area band", x, y)
        lines[ours - sigma] = edges[: len(edges) // 2]
        for value, line in lines.items():
            assert np.interp(2000.0, line[:, 1], line[:, 0]) == pytest.approx(value, abs=pixel)
    x = scale(panels[0], "x")
    y = scale(panels[0], "y")
    used = places(panels[0], "dots small sample", x, y)
    unused = places(panels[0], "dots small notused", x, y)
    assert used[:, 0] == pytest.approx([10.0], abs=0.2)
    assert unused[:, 0] == pytest.approx([6.85, 1.85], abs=0.2)
    assert unused[:, 1] == pytest.approx([1500.0, 2000.0], abs=30.0)


def test_the_table_of_the_air(page):
    table = page.tables["The air"][0]
    head, used, unused = rows_of("""
        curve             | h [m]  | T [°C] | p [hPa] | e [hPa] | N | N against standard [%]
        HYGR[0]           | 1000.0 | 10.000 |         |         |   |
        HYGR[0], not used | 1500.0 | 6.850  |         |         |   |
    """)
    assert table[0] == head
    assert used in table
    assert unused in table
    standard = next(row for row in table if row[0] == "us1962")
    h_m = float(table[1][1])
    t_c = 15.0 - 0.0065 * h_m
    p_hpa = 1013.25 - 0.08 * h_m
    row = [h_m, t_c, p_hpa, -0.001 * h_m, 280.0 - 0.02 * h_m, 0.0]
    assert [float(cell) for cell in standard[1:]] == pytest.approx(row, abs=0.01)


# label, median [px], 95 % [px]
ROWS_OF_BUDGET = yaml.safe_load("""
- [the shift itself, 1.01, 1.02]
- ["sigma: air outside", 0.011, 0.022]
- ["sigma: station", 0.023, 0.046]
- ["sigma: all parts", 0.031, 0.062]
- [the shift itself, 2.01, 2.02]
- ["sigma: air outside", 0.0051, 0.0102]
- ["sigma: ground height", 0.0071, 0.0142]
- ["sigma: cabin or lens", 0.0083, 0.0166]
- ["sigma: all parts", 0.0097, 0.0194]
""")


def test_the_budget_is_drawn_in_its_rows(page):
    drawing = page.drawings["budget", "wide"]
    ticks = [t for t in drawing.iter("text") if re.fullmatch(r"[\d.]+", t.text or "")]
    pixels = [float(tick.get("x", "")) for tick in ticks]
    logarithms = np.log10([float(tick.text) for tick in ticks])
    slope, offset = np.polyfit(pixels, logarithms, 1)
    labels = texts_in(drawing, text_anchor="end")
    lines = [p for p in drawing.iter("path") if p.get("class") in ("line shift", "line sigma")]
    for row, label, line in zip(ROWS_OF_BUDGET, labels, lines, strict=True):
        drawn = 10.0 ** (slope * points(line.get("d", ""))[:, 0] + offset)
        assert label == row[0]
        assert drawn == pytest.approx(row[1:], rel=0.02)


def test_the_page_of_twenty_thousand_exposures_is_small(air):
    n = 20_000
    number = np.arange(n)
    names = np.array([f"flight_2025-06-12_block_north_{i:05d}.jpg" for i in number], dtype=object)
    looking_down = np.tile([0.0, 1.0, 0.0, 0.0], (n, 1))
    cameras = np.array(["belly", "tail"], dtype=object)[number % 2]
    stations = replace(
        empty_stations(names, cameras, "ok"),
        time_ns=BEGIN_NS + number * 500_000_000,
        lat_rad=np.radians(47.0 + number // 200 * 1e-3),
        lon_rad=np.radians(179.9 + number % 200 * 1e-3),
        h_msl_m=np.full(n, 3000.0),
        quaternion=looking_down,
    )
    seconds = np.linspace(0.0, 1e4, 100_000)
    lon = np.radians((seconds * 2e-5 + 359.9) % 360.0 - 180.0)
    track = LoggedPath(
        time_ns=BEGIN_NS + (seconds * 1e9).astype(np.int64),
        latitude_rad=np.radians(47.0 + seconds * 1e-5),
        longitude_rad=lon,
        h_msl_m=np.full(seconds.size, 3000.0),
    )
    ground = np.where(number % 3 == 0, 500.0, np.nan)
    camera = Camera(2800, 2000, 4567.0, 4567.0, 1400.0, 1000.0)
    flown = flown_of(
        stations,
        air,
        SAMPLES,
        track,
        cameras={"belly": camera, "tail": camera},
        ground_m=ground,
        radius_m=None,
        terrain=None,
    )
    west, east, *_ = flown.limits_deg
    assert (west, east) == pytest.approx((179.85, 180.15), abs=0.06)  # across the 180th meridian
    text = report_page(manifest_of(whole_manifest()), flown)
    assert len(text.encode()) < 1_500_000
    assert "1500 of 20000 exposures are shown. 250 of 20000 footprints are shown." in text


@pytest.mark.parametrize(
    ("height", "is_drawn", "sentence"),
    [
        ({"dem": "d.tif"}, False, "The relief is not shown: "),
        ({"dem": "d.tif"}, True, "The relief is that of the elevation model"),
        ({"column": "h_g_m"}, False, ""),
        ("intersected", False, ""),
    ],
    ids=str,
)
def test_a_relief_that_is_not_drawn_is_not_left_unsaid(flown, height, is_drawn, sentence):
    manifest = whole_manifest()
    manifest["config"]["ground"]["height"] = height
    relief = (flown.limits_deg, np.zeros((2, 2))) if is_drawn else None
    page = page_of(manifest, replace(flown, relief=relief))
    caption = page.caption("Map of")
    assert ('<image id="relief"' in page.text) == is_drawn
    assert ("relief" in caption) == bool(sentence)
    assert sentence in caption


HOSTILE = "<script>alert(1)</script>\"' onload=x \u202egpj.exe \x1b[31m\x00"


def test_names_of_others_are_harmless(flown):
    manifest = whole_manifest()
    manifest["mission"] = HOSTILE
    manifest["ledger"][0]["what"] = HOSTILE
    manifest["inputs"][0]["name"] = HOSTILE
    manifest["channels"]["temperature"] = HOSTILE
    manifest["observations"]["causes"]["no_ground"] = HOSTILE
    for section in (
        manifest["correction"]["cameras"],
        manifest["flight"]["cameras"],
        manifest["config"]["cameras"],
        manifest["sigma_budget"],
    ):
        section[HOSTILE] = section.pop("belly")
    exposures = flown.exposures | {"image": np.array([HOSTILE] * 4, dtype=object)}
    footprints = {HOSTILE: flown.footprints["belly"], "tail": flown.footprints["tail"]}
    hostile = replace(flown, exposures=exposures, footprints=footprints)
    text = report_page(manifest_of(manifest), hostile)
    assert "<script" not in text
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e\u2066-\u2069]", text)
    assert "&lt;script&gt;" in text
    assert r"\u202egpj.exe" in text
    assert not re.search(r"<[^>]*\sonload=", re.sub(r'"[^"]*"', "", text))


def test_the_same_data_give_the_same_bytes_and_nothing_is_loaded(page, flown):
    assert report_page(manifest_of(whole_manifest()), flown) == page.text
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:" in page.text
    assert not re.search(r'(?:src|href)="(?!#|data:)', page.text)
    assert "url(http" not in page.text
    for words in ("widened", "told", "ln of its decay"):
        assert words not in page.text
