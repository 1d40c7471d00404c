"""A manifest in which every number differs, against the page, the terminal and the figures.

The expected texts are written by hand from the manifest, without the functions of the report.
"""

import io
import re
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from matplotlib.collections import PolyCollection
from rich.console import Console

from tests.helpers import one_line
from unbend.atmosphere.air_samples import AirSamples, SensorSamples, SensorUse
from unbend.atmosphere.estimate.sensors import FAULT_TEXTS
from unbend.atmosphere.estimate.solver import FaultEstimate
from unbend.atmosphere.rejection import Reason
from unbend.refraction.angle import RadialTable
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.report.air_and_rays import (
    print_air,
    print_angle,
    print_paper,
    print_profile,
    print_radial,
)
from unbend.report.command_plots import (
    ADJUSTED,
    MEASURED,
    REJECTED,
    STANDARD,
    profile_figure,
    save_figure,
)
from unbend.report.inspected_log import print_log
from unbend.report.terminal import print_run
from unbend.units import ARCSEC

from .manifests import manifest_of
from .text_tables import lines_of, rows_of

MANIFEST = yaml.safe_load("""
mission: ridge <north> & [red]south
config:
  refraction: {direction: remove, method: spherical}
  cameras:
    belly: {principal_distance: null, window: null}
    tail:
      principal_distance: {dc_dp_px_per_hpa: 0.006}
      window: {shape: plane, in_calibration: none}
correction:
  shift_px: {count: 41, median: 3.01, p95: 3.02, maximum: 3.03}
  shift_ground_m: {count: 42, median: 3.11, p95: 3.12, maximum: 3.13}
  refraction_arcsec: {count: 43, median: 13.1, p95: 13.2, maximum: 13.3}
  window_arcsec: {count: 44, median: 23.1, p95: 23.2, maximum: 23.3}
  cameras:
    belly:
      shift_px: {count: 41, median: 1.01, p95: 1.02, maximum: 1.03}
      shift_ground_m: {count: 42, median: 1.11, p95: 1.12, maximum: 1.13}
      refraction_arcsec: {count: 43, median: 11.1, p95: 11.2, maximum: 11.3}
      window_arcsec: {count: 44, median: 21.1, p95: 21.2, maximum: 21.3}
    tail:
      shift_px: {count: 41, median: 2.01, p95: 2.02, maximum: 2.03}
      shift_ground_m: {count: 42, median: 2.11, p95: 2.12, maximum: 2.13}
      refraction_arcsec: {count: 43, median: 12.1, p95: 12.2, maximum: 12.3}
      window_arcsec: {count: 44, median: 22.1, p95: 22.2, maximum: 22.3}
observations:
  rows: 5021
  status: {ok: 4987, no_station: 0, no_ground: 13, misses_ground: 21}
cabin_sigma_share: {count: 4987, median: 0.0123, p95: 0.014, maximum: 0.019}
stations: {ok: 88, in_gap: 7, unmatched: 0}
uncertainty: {scale_sigma: 0.0032}
profile:
  basis: thermometer
  reason: temperatures of HYGR[0] over 2345 m of height
  standard: us1962
  departure_at_cameras_k: -6.72
  sigma_departure_at_cameras_k: 0.434
  profiles: 11
  windows:
    - {change: -0.0123, sigma: 0.0041}
    - {change: 0.0345, sigma: 0.0052}
    - {change: 0.0011, sigma: 0.0033}
  effect:
    - nadir_angle_deg: 45.0
      h_c_m: 3456.0
      h_g_m: 789.0
      r_c_arcsec: 6.6943
      sigma_arcsec: 0.0223
      standard_arcsec: 6.8637
      factor: 0.97532
      sigma_factor: 0.00331
    - nadir_angle_deg: 75.0
      h_c_m: 3457.0
      h_g_m: 790.0
      r_c_arcsec: 25.0554
      sigma_arcsec: null
      standard_arcsec: 24.6852
      factor: 1.01499
      sigma_factor: null
  sources:
    - source: BARO[0]
      used: true
      quantity: pressure
      readings: 179
      rms_sigma: 0.246
      sigma_inflation: 1.372
      degrees_of_freedom_for_signal: 16.08
    - {source: METAR, used: false, why_not: 61 km away}
    - {source: standard, used: true, why_not: ""}
  samples:
    - sensor: BARO[0]
      quantity: pressure
      samples: 1234
      used: 1203
      rejected: {no value: 27, no height at its time: 4}
  sensors:
    - {what: "thermometer bias [K]", value: -0.498, sigma: 0.453, expected_sigma: 0.617}
channels: {outside_pressure: "BARO[0]", temperature: "<b>HYGR[0]"}
inputs:
  - role: log
    name: a&b.bin
    sha256: 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef
  - role: observations
    name: o.csv
    sha256: fedcba9876543210fedcba9876543210fedcba9876543210fedcba9876543210
ledger:
  - {kind: note, code: AIR-ANCHOR, what: residuals of 0.14 hPa, where: "BARO[0]"}
  - {kind: fallback, code: AIR-FALL, what: no humidity, where: ""}
  - {kind: loss, code: ZZ-LOSS, what: 9 messages of GPS <x>, where: GPS}
  - {kind: warning, code: AA-WARN, what: "8 rows [b]", where: o.csv}
  - {kind: loss, code: AA-LOSS, what: 77 bytes, where: flight.bin}
""")

VERDICT = (
    "41 of 5,021 observations were corrected by 3.1 m on the ground, 3 px in the image (median; "
    "95 %: 3.1 m, 3 px). Check 2 losses (AA-LOSS, ZZ-LOSS) before use."
)
STEPS = [
    "See the ledger about AA-LOSS, ZZ-LOSS.",
    "Leave out 4,980 rows without new coordinates (13 no_ground, 21 misses_ground); the ledger "
    "names the causes.",
    "Then adjust x_corrected_px, y_corrected_px, or export them: unbend export.",
    "Switch off the refraction correction of the adjustment program: never correct twice.",
]
CORRECTION = rows_of("""
                                             | median | 95 %  | maximum
    shift in the image, belly [px]           | 1.01   | 1.02  | 1.03
    shift in the image, tail [px]            | 2.01   | 2.02  | 2.03
    shift on the ground, belly               | 1.1 m  | 1.1 m | 1.1 m
    shift on the ground, tail                | 2.1 m  | 2.1 m | 2.1 m
    refraction of the air, belly [arcsec]    | 11.1   | 11.2  | 11.3
    refraction of the air, tail [arcsec]     | 12.1   | 12.2  | 12.3
    refraction of the window, belly [arcsec] | 21.1   | 21.2  | 21.3
    refraction of the window, tail [arcsec]  | 22.1   | 22.2  | 22.3
""")
AIR = (
    "Temperatures of HYGR[0] over 2345 m of height. At the height of the cameras, the air differs "
    "by -6.72 ± 0.43 K from us1962. The air changes: R changes by -1.23 ± 0.41 to +3.45 ± 0.52 % "
    "of R of the whole flight; there are 11 profiles."
)
EFFECTS = [
    "refraction R at 45° from 3456 m to 789 m: 6.694 ± 0.022 arcsec, 6.864 in us1962: "
    "-2.47 ± 0.33 %",
    "R at 75° from 3457 m to 790 m: 25.1 arcsec, 24.685 in us1962: +1.5 %",
]
SOURCES = rows_of("""
    source | readings | RMS [sigma] | sigma inflation factor | degrees of freedom for signal
    BARO[0], pressure | 179 | 0.25 | 1.37 | 16.1
""")
SENSORS = rows_of("""
    sensor error         | estimate ± sigma | prior sigma
    thermometer bias [K] | -0.50 ± 0.45     | 0.62
""")
LEDGER = rows_of("""
    loss     | AA-LOSS    | 77 bytes (flight.bin)
    loss     | ZZ-LOSS    | 9 messages of GPS <x>
    warning  | AA-WARN    | 8 rows [b] (o.csv)
    fallback | AIR-FALL   | no humidity
    note     | AIR-ANCHOR | residuals of 0.14 hPa (BARO[0])
""")


@dataclass(frozen=True)
class Column:
    """An atmosphere of straight lines: T, p, e and N at sea level, and their slopes per metre."""

    name: str
    t: float
    p: float
    e: float
    n: float
    bottom_m = -5000.0
    top_m = 50_000.0

    def temperature(self, h):
        return self.t - 0.0065 * h

    def pressure(self, h):
        return self.p - 8.0 * h

    def vapour_pressure(self, h):
        return self.e - 0.1 * h

    def refractivity(self, h):
        return self.n - 2e-8 * h


FLOWN = Column("of this flight", 290.0, 100_000.0, 900.0, 2.9e-4)
STANDARD_AIR = Column("us1962", 288.15, 101_325.0, 0.0, 2.8e-4)
EVENING = Column("evening", 285.0, 99_000.0, 700.0, 2.95e-4)
COVARIANCE = SimpleNamespace(
    sigma_temperature=lambda h: 0.5 + 0.0 * h,
    sigma_log_pressure=lambda h: 0.001 + 0.0 * h,
    sigma_vapour_pressure=lambda h: 60.0 + 0.0 * h,
    sigma_refractivity=lambda h: 1.4e-6 + 0.0 * h,
)


def readings(name, value, h_m) -> SensorSamples:
    return SensorSamples(np.arange(len(value)), np.array(h_m), np.array(value), name=name)


SAMPLES = AirSamples(
    temperature=readings("HYGR[0]", [283.15, 280.0, 275.0], [1000.0, 1500.0, 2000.0]).reject(
        np.array([False, False, True]), Reason.GROUND_SOAK
    ),
    pressure=readings("BARO[0]", [91_000.0, 85_000.0], [1100.0, 1600.0]),
    humidity=readings("HYGR[1]", [0.5, 1.7], [1200.0, 1900.0]),
)


@pytest.fixture(scope="module")
def air():
    adjustment = SimpleNamespace(
        profile=FLOWN,
        standard=STANDARD_AIR,
        covariance=COVARIANCE,
        sources=(),
        faults=(),
        rejected={"temperature": np.array([0, Reason.OUTLIER, Reason.GROUND_SOAK])},
        basis="thermometer",
    )
    return SimpleNamespace(
        adjustment=adjustment,
        effects=[effect_of(row) for row in MANIFEST["profile"]["effect"]],
        windows=(
            SimpleNamespace(air=SimpleNamespace(profile=EVENING), why_not=""),
            SimpleNamespace(air=None, why_not="too few readings"),
        ),
        series=SimpleNamespace(timed_profiles=(1, 2, 3, 4)),
    )


def effect_of(row):
    """An effect that the manifest has as this row; without a sigma the numbers are NaN."""
    numbers = {name: np.nan if value is None else value for name, value in row.items()}
    return SimpleNamespace(
        nadir_deg=numbers["nadir_angle_deg"],
        h_c_m=numbers["h_c_m"],
        h_g_m=numbers["h_g_m"],
        r_c_rad=numbers["r_c_arcsec"] * ARCSEC,
        standard_rad=numbers["standard_arcsec"] * ARCSEC,
        sigma_rad=numbers["sigma_arcsec"] * ARCSEC,
        factor=numbers["factor"],
        sigma_factor=numbers["sigma_factor"],
    )


def changed(**of_profile):
    return MANIFEST | {"profile": MANIFEST["profile"] | of_profile}


def printed(write, *arguments, **options):
    """What is printed at 80 columns, line by line."""
    stream = io.StringIO()
    write(Console(file=stream, width=80, highlight=False), *arguments, **options)
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    assert max(map(len, lines)) <= 80
    return lines


def in_one_line(lines):
    return one_line(" ".join(lines))


def text_of_run(values, *, repeated=False):
    """What is printed of a run, as one line."""
    return in_one_line(printed(print_run, "a", "b", manifest_of(values), repeated=repeated))


def cells(lines):
    """Lines of a table cut at two or more blanks."""
    return [re.split(r"\s{2,}", line.strip()) for line in lines]


def test_every_number_of_the_terminal():
    lines = printed(print_run, "ridge [1]", "out/[b]", manifest_of(MANIFEST), repeated=False)
    text = in_one_line(lines)
    assert lines[0] == "ridge [1]"
    assert VERDICT in text
    heads = [one_line(line) for line in lines]
    first = heads.index("median 95 % maximum") + 1
    assert cells(lines[first : first + 8]) == CORRECTION[1:]
    ledger = " ".join(f"{kind} {code}: {sentence}" for kind, code, sentence in LEDGER[:4])
    assert text.endswith(
        f" {AIR} {EFFECTS[0]} {EFFECTS[1]} Flagged rows: 13 no_ground, 21 misses_ground {ledger} "
        f"next {' '.join(STEPS)} results out/[b] report out/[b]/report.html"
    )
    assert "nothing to do" not in text
    assert "nothing to do" in text_of_run(MANIFEST, repeated=True)


def test_sentences_that_depend_on_the_air():
    standard = changed(basis="standard", reason="atmosphere.use is standard", windows=[])
    sentence = "tail [arcsec] 22.1 22.2 22.3 atmosphere.use is standard. refraction R at 45°"
    assert sentence in text_of_run(standard)


@pytest.mark.parametrize("unknown", ["departure_at_cameras_k", "sigma_departure_at_cameras_k"])
def test_a_departure_without_its_sigma_is_not_said(unknown):
    assert "At the height of the cameras" not in text_of_run(changed(**{unknown: None}))


@pytest.mark.parametrize(("largest", "is_tiny"), [(0.0499, True), (0.0501, False)])
def test_a_tiny_correction_is_called_tiny(largest, is_tiny):
    small = MANIFEST["correction"] | {"cameras": {}}
    small["shift_px"] = {"count": 9, "median": 0.0004, "p95": 0.003, "maximum": largest}
    small["window_arcsec"] = {"count": 9, "median": 0.0, "p95": 0.0, "maximum": 0.0}
    observations = MANIFEST["observations"] | {"rows": 9}
    run = MANIFEST | {"correction": small, "observations": observations, "ledger": []}
    text = text_of_run(run)
    assert ("too small to measure" in text) == is_tiny
    assert "refraction of the window" not in text


def values(axis, key):
    """The points of the line of an axis that has this label and colour."""
    lines = {f"{line.get_label()} {line.get_color()}": line for line in axis.lines}
    return list(lines[key].get_xdata()), list(lines[key].get_ydata())


def curve(axis, key):
    """A curve at 2000 m."""
    x, y = values(axis, key)
    return float(np.interp(2000.0, y, x))


def band(axis):
    """Both edges of the one-sigma band at 2000 m."""
    (area,) = (part for part in axis.collections if isinstance(part, PolyCollection))
    assert area.get_label() == "one sigma"
    vertices = area.get_paths()[0].vertices
    half = len(vertices) // 2
    edges = []
    for part in (vertices[1:half], vertices[half + 1 : -1]):
        x, y = part[np.argsort(part[:, 1])].T
        edges.append(float(np.interp(2000.0, y, x)))
    return min(edges), max(edges)


# By hand: 290 - 13 - 273.15 °C; 1000 - 160 hPa; 9 - 2 hPa; 290 - 40 ppm.
AIR_AT_2000_M = [  # panel, this flight, its sigma, standard
    ("temperature T [°C]", 3.85, 0.5, 2.0),
    ("pressure p [hPa]", 840.0, 0.84, 853.25),
    ("vapour pressure e [hPa]", 7.0, 0.6, -2.0),
    ("refractivity N = (n − 1) 10⁶", 250.0, 1.4, 240.0),
    ("N against us1962 [%]", 100.0 * (250.0 / 240.0 - 1.0), 1.4 / 2.4, 0.0),
]


def test_every_curve_of_the_air(air):
    figure = profile_figure(air, SAMPLES)
    *panels, words = figure.axes
    for axis, (label, ours, sigma, standard) in zip(panels, AIR_AT_2000_M, strict=True):
        assert axis.get_xlabel() == label
        # Heights of 1000 to 2000 m and 6 % of them, upwards.
        assert axis.get_ylim() == pytest.approx((940.0, 2060.0))
        assert curve(axis, f"of this flight {ADJUSTED}") == pytest.approx(ours)
        assert curve(axis, f"us1962 {STANDARD}") == pytest.approx(standard)
        assert band(axis) == pytest.approx((ours - sigma, ours + sigma))
    t, p, e, n, _ = panels
    assert t.get_ylabel() == n.get_ylabel() == "height above sea level [m]"
    evening = "parts of the flight #93c5fd"
    assert curve(t, evening) == pytest.approx(-1.15)
    assert curve(p, evening) == pytest.approx(830.0)
    # Readings: the second of the temperatures is an outlier, the third was not accepted.
    celsius, heights = values(t, f"HYGR[0], used {MEASURED}")
    assert celsius == pytest.approx([10.0])
    assert heights == [1000.0]
    celsius, heights = values(t, f"HYGR[0], not used {REJECTED}")
    assert celsius == pytest.approx([6.85, 1.85])
    assert heights == [1500.0, 2000.0]
    assert values(p, f"BARO[0], used {MEASURED}") == ([910.0, 850.0], [1100.0, 1600.0])
    # The second reading of 170 % counts as 100 %; the air is at 282.2 and 277.65 K there.
    moist, heights = values(e, f"HYGR[1], used {MEASURED}")
    assert heights == [1200.0, 1900.0]
    assert moist == pytest.approx([0.5 * buck(282.2, 904.0), buck(277.65, 848.0)], rel=5e-3)
    (text,) = words.texts
    assert one_line(text.get_text()) == " ".join(EFFECTS)
    legend = [entry.get_text() for entry in words.get_legend().get_texts()]
    assert legend == lines_of("""
        HYGR[0], used
        HYGR[0], not used
        parts of the flight
        us1962
        one sigma
        of this flight
    """)


def buck(t_k, p_hpa):
    """Saturation over water [hPa], Buck 1981 with his enhancement factor."""
    t = t_k - 273.15
    return (1.0007 + 3.46e-6 * p_hpa) * 6.1121 * float(np.exp(17.502 * t / (240.97 + t)))


def test_a_standard_alone_has_one_curve(air):
    adjustment = SimpleNamespace(
        profile=STANDARD_AIR, standard=STANDARD_AIR, covariance=None, rejected={}, basis="standard"
    )
    alone = SimpleNamespace(adjustment=adjustment, effects=[], windows=())
    figure = profile_figure(alone, AirSamples())
    for axis in figure.axes[:5]:
        assert len(axis.lines) == 1
        assert not axis.collections
        assert axis.get_ylim() == (0.0, 10_000.0)


def test_a_plot_is_what_its_name_says(air, tmp_path):
    figure = profile_figure(air, SAMPLES)
    save_figure(figure, tmp_path / "a.PNG")
    save_figure(figure, tmp_path / "a.svg")
    assert (tmp_path / "a.PNG").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.svg").read_text("utf-8").startswith("<?xml")


PROFILE_ROW = yaml.safe_load("""
h_m: 1234.4
temperature_k: 281.237
sigma_temperature_k: 0.314
standard_temperature_k: 280.128
pressure_pa: 87654.0
standard_pressure_pa: 87321.0
vapour_pressure_pa: 812.3
standard_vapour_pressure_pa: 4.56
refractivity: 2.51234e-4
sigma_refractivity: 1.234e-5
standard_refractivity: 2.47891e-4
source: measured
""")


def test_every_cell_of_a_profile():
    unknown = {"sigma_temperature_k": None, "sigma_refractivity": None, "source": "standard"}
    lines = printed(print_profile, [PROFILE_ROW, PROFILE_ROW | unknown], "us[1]")
    rows = [one_line(line) for line in lines[:4]]
    assert rows == lines_of("""
        h T ± std p std e std N ± std source
        [m] [K] [K] [hPa] [hPa] [hPa] [hPa] [ppm] [ppm]
        1234 281.24 0.31 280.13 876.5 873.2 8.12 0.05 251.23 12.3 247.89 measured
        1234 281.24 280.13 876.5 873.2 8.12 0.05 251.23 247.89 standard
    """)
    assert lines[4] == "N is (n-1)e6; std is us[1] at the same height"


def test_every_line_of_the_air(air):
    fault, text = next(iter(FAULT_TEXTS.items()))
    adjustment = SimpleNamespace(
        **vars(air.adjustment)
        | {
            "sources": [SimpleNamespace(sentence=lambda: "BARO[0]: used")],
            "sensor_uses": [SensorUse("pressure", "BARO[0]", 1234, {Reason.NO_VALUE: 31})],
            "faults": [FaultEstimate(fault, -1.2345, 0.678, 1.0)],
        }
    )
    lines = printed(print_air, SimpleNamespace(**vars(air) | {"adjustment": adjustment}))
    assert in_one_line(lines) == (
        f"{EFFECTS[0]} {EFFECTS[1]} BARO[0]: used "
        f"BARO[0], pressure: 1203 of 1234 samples used; not used: 31 (no value) "
        f"{text}: -1.23 ± 0.68 4 profiles, because the air changes"
    )


def test_every_number_of_an_angle():
    angle = {
        "r_c_arcsec": 1.2345678,
        "r_c_urad": 5.9876543,
        "ground_m": 0.3456789,
        "status": "ok",
        "atmosphere": "icao",
        "index": "gyer",
        "method": "plane",
        "radius_m": 6_371_000.0,
        "wavelength_m": 0.589e-6,
    }
    lines = [line.strip() for line in printed(print_angle, angle)]
    assert lines == lines_of("""
        R_c    1.2346 arcsec
        5.9877 microradians
        0.34568 m on the ground
        icao, index gyer at 0.589 um, plane, radius 6371000 m
    """)


def test_every_cell_of_a_radial_table():
    table = RadialTable(
        h_c_m=3210.0,
        h_g_m=123.0,
        nadir_angle_rad=np.radians([12.34, 80.0, 89.0]),
        r_c_rad=np.array([1.2344, 2.3453, np.nan]) * ARCSEC,
        shift_ground_m=np.array([0.5671, np.nan, np.nan]),
        radius_px=np.array([4567.81, 5678.92, np.nan]),
        dr_px=np.array([-0.12342, -0.23453, np.nan]),
        status=np.array([0, 0, STATUS_NAMES.index("misses_ground")]),
        k_rad=34.56e-6,
        k_manual_rad=29.87e-6,
        wavelength_m=0.85e-6,
    )
    lines = printed(print_radial, [table])
    assert lines[0] == (
        "camera 3210 m, ground 123 m: R at 45 deg 34.56 urad, the Manual's formula 29.87"
    )
    assert cells(lines[1:5]) == rows_of("""
        nadir angle [deg] | R_c [arcsec] | R_c [urad] | ground [m] | radius [px] | dr [px]
        12.34 | 1.234 | 5.98  | 0.567  | 4567.8  | -0.1234
        80.00 | 2.345 | 11.37 | 5678.9 | -0.2345
        89.00 | misses_ground
    """)
    assert in_one_line(lines[5:]).startswith("No metres on the ground: the straight")
    assert lines[-1] == "Light of 0.85 um."


def test_every_cell_of_a_papers_table():
    row = {
        "table": 3,
        "quantity": "R",
        "unit": "urad",
        "h_c_m": 9000.0,
        "h_g_m": 1500.0,
        "zeta_c_deg": 45.0,
        "printed": 81.6,
        "as_published": 81.5512,
        "exact": 81.71239,
        "difference": None,
    }
    other = row | {"unit": "arcsec", "printed": 7.25}
    lines = printed(print_paper, [row, other], ["a note [b]"])
    assert lines[0].strip() == "Table 3: R [urad]"
    assert cells(lines[1:3]) == rows_of("""
        h_c [km] | h_g [km] | zeta [deg] | printed | as published | exact   | difference
        9        | 1.5      | 45         | 81.6    | 81.5512      | 81.7124
    """)
    assert lines[3].strip() == "Table 3: R [arcsec]"
    assert cells(lines[5:6])[0][3] == "7.25"
    assert lines[-1] == "  a note [b]"


def test_every_number_of_a_log():
    log = yaml.safe_load("""
    format: mcap
    duration_s: 1234.56
    start_utc: "2025-06-12T09:00:01Z"
    end_utc: "2025-06-12T09:20:36Z"
    time_base: UTC of [x]
    flight:
      lat_deg: 47.123
      lon_deg: -8.456
      height_reference: sea level
      lowest_m: 451.2
      highest_m: 3459.6
      take_off_m: 450.4
    roles:
      - role: position
        channel: GPS
        rate_hz: 4.987
        samples: 7
        remark: plausible
        others: [POS, "[b]"]
      - role: humidity
        channel: null
        rate_hz: null
        samples: 7
        remark: none in the log
        others: []
    messages: {A: 1000, B: 2345}
    boots: 2
    bad_bytes: 1
    lost_messages: 1321
    channels:
      - name: BARO[0]
        samples: 6543
        rate_hz: 9.876
        gaps: [{seconds: 1.25}, {seconds: 12.5}]
      - {name: CAM, samples: 12, rate_hz: 0.5, gaps: []}
    vehicles: []
    receivers: []
    clocks: []
    """)
    log["ledger"] = MANIFEST["ledger"]
    lines = printed(print_log, log, "a[1].mcap")
    assert [one_line(line) for line in lines[:7]] == lines_of("""
        a[1].mcap: mcap, 1234.6 s
        place 47.123°, -8.456°
        time 2025-06-12 09:00:01 to 09:20:36 UTC
        clock UTC of [x]
        heights 451 to 3460 m above sea level
        take-off 450 m above sea level, where the log begins
        messages 3,345 of 2 types, 1 bad byte, 1,321 lost, 2 boots
    """)
    assert cells(lines[8:11]) == rows_of("""
        role     | channel | rate [Hz]       | remark
        position | GPS     | 4.99            | plausible; also POS, [b]
        humidity | -       | none in the log
    """)
    assert cells(lines[12:15]) == rows_of("""
        channel | samples | rate [Hz] | gaps | gaps [s]
        BARO[0] | 6,543   | 9.88      | 2    | 13.8
        CAM     | 12      | 0.5
    """)
    ledger = " ".join(f"{kind} {code}: {sentence}" for kind, code, sentence in LEDGER)
    assert in_one_line(lines).endswith(ledger)
