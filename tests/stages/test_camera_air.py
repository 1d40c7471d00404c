"""The air in the lens and the air before it: what is removed, what is said where it is not.

Expected values by hand, with the index of air of the simulator (modified Edlen).
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from tests.conftest import without_plots
from tests.helpers import codes_of, entry_of, one_line
from tests.report.manifests import manifest_of
from tests.stages.corrected_rows import rows_of_camera
from tests.stages.level_cameras import US1976, WARM_HATCH, look, stations
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.effect import Effect
from unbend.refraction.lens_air import TypicalLens, lens_change, sigma_of_change
from unbend.refraction.window import Cabin, Window, refract_at_window
from unbend.report.summary import next_steps, not_included, outcome, verdict
from unbend.simulate.true_air import edlen_index
from unbend.stages.cabin_air import cabin_changes, with_cabin_air, with_errors_of_lenses
from unbend.stages.camera_air import camera_air_records

approx = pytest.approx

LABORATORY = {"pressure_hpa": 1013.25, "temperature_c": 20.0}

# Pressure [Pa] and temperature [K].
LABORATORY_AIR = (101_325.0, 293.15)
AT_6_KM = (47_217.6, 249.187)  # US 1976
IN_CABIN = (70_120.0, 294.26)

F_PX = 20_000.0
LENS = TypicalLens(F_PX)


def n_minus_1(air, wavelength_um=0.55):
    """n - 1 of dry air by the modified Edlen equation."""
    pressure_pa, temperature_k = np.array(air)
    dry_pa = np.array(0.0)
    return float(edlen_index(pressure_pa, temperature_k, dry_pa, wavelength_um)) - 1.0


def change_of_n(before, after, wavelength_um=0.55):
    return n_minus_1(after, wavelength_um) - n_minus_1(before, wavelength_um)


def expected_ppm(air):
    """Twice the change of n since the laboratory, in ppm."""
    return 2.0e6 * change_of_n(LABORATORY_AIR, air)


def warmer(air):
    """The air when it is 10 K warmer."""
    pressure_pa, temperature_k = air
    return pressure_pa, temperature_k + 10.0


# ---------------------------------------------------------------- the typical lens


@pytest.mark.parametrize(
    ("air", "change_mm"),
    [
        (AT_6_KM, -0.036),
        (AT_6_KM, -0.047),
        (IN_CABIN, -0.020),
    ],
)
def test_meiers_lens_lies_within_the_sigma_of_a_typical_one(air, change_mm):
    """A Zeiss lens of 153 mm, calibrated on the ground: Meier's changes."""
    change_px = float(LENS.change_px(*air, IndexModel()))
    sigma_px = float(sigma_of_change(LENS, change_px))
    ppm = change_px / F_PX * 1e6
    assert ppm == approx(expected_ppm(air), abs=0.05)
    assert sigma_px == approx(abs(change_px) / 4.0)
    meier_ppm = change_mm / 153.0 * 1e6
    assert abs(meier_ppm - ppm) < 1.01 * sigma_px / F_PX * 1e6


@pytest.mark.parametrize("air", [LABORATORY_AIR, (84_000.0, 278.0), AT_6_KM])
def test_the_air_of_the_calibration_changes_nothing_whatever_it_was(air):
    lens = TypicalLens(12_000.0, *air)
    assert float(lens_change(lens, *air, IndexModel())) == 0.0
    change_px = float(lens_change(lens, *LABORATORY_AIR, IndexModel()))
    assert change_px == approx(-12e-3 * expected_ppm(air), rel=1e-3)


def test_the_lens_in_the_light_of_its_camera():
    blue = IndexModel(wavelength_m=0.45e-6)
    change_px = float(LENS.change_px(*AT_6_KM, blue))
    change = change_of_n(LABORATORY_AIR, AT_6_KM, 0.45)
    assert change_px == approx(2.0 * F_PX * change, rel=3e-4)


CONSTANT = Cabin("constant", *IN_CABIN)
SUCKED_HATCH = replace(
    WARM_HATCH,
    warmer_k=0.0,
    excess_pa=-700.0,
    sigma_temperature_k=0.0,
)


def errors_behind(windows):
    """What one sigma of cabin and lens changes at an exposure, as in `cabin_changes`.

    The lens has changed by -4.9 px.
    """
    lenses = {"nadir": LENS}
    exposed = with_cabin_air(stations(6000.0), windows, lenses, US1976, Ledger())
    changes = cabin_changes(exposed, lenses, US1976)
    lens_px = np.array([-4.9])
    (errors,) = with_errors_of_lenses(changes, exposed, lenses, windows, lens_px)
    return errors


def test_the_sigma_of_a_typical_lens_and_where_none_is_known():
    """A quarter of the change, alone or with the cabin's; a cabin without a sigma keeps none."""
    assert errors_behind({}) == approx([0.0, 0.0, 0.0, -4.9 / 4.0])
    assert np.isnan(errors_behind({"nadir": Window(CONSTANT)})).all()

    cabin = replace(CONSTANT, sigma_pressure_pa=300.0, sigma_temperature_k=5.0)
    errors = errors_behind({"nadir": Window(cabin)})

    by_pressure = change_of_n(IN_CABIN, (70_420.0, 294.26))
    by_temperature = 0.5 * change_of_n((70_120.0, 289.26), (70_120.0, 299.26))
    lens_px = -math.hypot(4.9 / 4.0, 2.0 * F_PX * by_temperature)
    expected = [by_pressure, by_temperature, 2.0 * F_PX * by_pressure, lens_px]
    assert errors == approx(expected, rel=3e-3)


# ---------------------------------------------------------------- an opening


def outside_at(height_m):
    pressure_pa = US1976.pressure(height_m)
    return float(pressure_pa), float(US1976.temperature(height_m))


def plane_refraction(height_m):
    """R over tan zeta from a height down to the sea, by Gyer's Eq. 24 and Edlen's index."""

    def refractivity(h):
        return n_minus_1(outside_at(h))

    integral, _ = quad(refractivity, 0.0, height_m, epsrel=1e-6)
    return integral / height_m - refractivity(height_m)


@pytest.mark.parametrize(
    ("height_m", "percent"),
    [
        (1000.0, 68.0),
        (3000.0, 22.0),
        (6000.0, 10.0),
        (10_000.0, 5.0),
    ],
)
def test_ten_kelvin_in_an_open_hatch(height_m, percent):
    """68, 22, 10 and 5 % of R at 45 degrees, as the page on lenses says; the ray bends outwards."""
    exposures, ledger = look(stations(height_m), Window(WARM_HATCH))
    _, (r_cc,) = refract_at_window(
        np.sqrt([[0.5, 0.0, 0.5]]),
        exposures.refractivity_cabin,
        exposures.refractivity_outside,
        exposures.window_normal,
    )
    outside = outside_at(height_m)
    expected = change_of_n(outside, warmer(outside))
    assert expected < 0.0
    assert r_cc == approx(expected, rel=3e-3)
    share = -100.0 * r_cc / plane_refraction(height_m)
    assert share == approx(percent, rel=0.03)
    assert len(ledger) == 0


def test_air_under_another_pressure_at_the_skin():
    exposures, _ = look(stations(6000.0), Window(SUCKED_HATCH))
    pressure_pa, temperature_k = outside_at(6000.0)
    inside = (pressure_pa - 700.0, temperature_k)
    expected = change_of_n((pressure_pa, temperature_k), inside)
    change = exposures.refractivity_cabin - exposures.refractivity_outside
    assert change == approx([expected], rel=2e-3)


# ---------------------------------------------------------------- its size, in the manifest


def test_the_sizes_of_an_unknown_lens():
    """Of the middle height above the ground, the farthest corner, and R at 45 degrees."""
    section = SimpleNamespace(calibration="in_flight_corrected")
    mission = SimpleNamespace(cameras={"nadir": section}, lenses={}, windows={})
    camera = Camera(10_000, 8_000, 5_000.0, 5_000.0, 3_000.0, 6_000.0)
    flown = SimpleNamespace(height_above_ground_m=[1000.0, 20_000.0, 40_000.0])
    at_75_deg = Effect(75.0, 6000.0, 0.0, 9e-4, 9e-4)
    at_45_deg = Effect(45.0, 6000.0, 0.0, 1e-4, 1e-4)

    records = camera_air_records(
        mission,
        stations(6000.0),
        constant_series(TimedProfile(None, US1976), exposures=1),
        cameras={"nadir": camera},
        flown={"nadir": flown},
        effects=(at_75_deg, at_45_deg),
    )

    shorter_ppm = -expected_ppm(AT_6_KM)
    record = records["nadir"]
    assert record.lens_ppm == approx(-shorter_ppm, abs=0.2)
    assert record.lens_sigma_ppm == approx(shorter_ppm / 4.0, abs=0.1)
    assert record.lens_height_m == approx(shorter_ppm * 0.02, abs=0.005)
    edge_px = shorter_ppm * 1e-6 * math.hypot(7_000.0, 6_000.0)
    assert record.lens_edge_px == approx(edge_px, abs=0.003)
    _, temperature_k = AT_6_KM
    share = n_minus_1(AT_6_KM) / temperature_k / 1e-4
    assert record.kelvin_share == approx(share, rel=0.005)
    assert record.calibrated_in_flight
    assert not record.lens_removed


# ---------------------------------------------------------------- the whole program


@pytest.fixture(scope="module")
def runs(mission_factory, tmp_path_factory):
    """One flight without windows: as it is, with the air of the calibration, with an open hatch.

    The cameras look out freely, and nothing is said of a cabin.
    """
    entries = {
        "bare": {},
        "stated": {"principal_distance": {"reference": LABORATORY}},
        "hatch": {"opening": {"warmer_k": 10.0}},
    }
    missions = {}
    for name, entry in entries.items():
        mission = mission_factory(tmp_path_factory.mktemp(name) / "mission")
        for camera in mission.config["cameras"].values():
            camera["window"] = None
            camera.update(entry)
        channels = mission.config["log"]["channels"]
        for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
            channels.pop(role, None)
        with without_plots():
            mission.run_to_manifest()
        missions[name] = mission
    return missions


@pytest.fixture(scope="module")
def outside(runs):
    """Pressure and temperature in the middle of the stations, by their columns."""
    table = runs["bare"].station_rows()
    return tuple(table[["pressure_pa", "temperature_k"]].median())


def test_the_air_of_the_calibration_is_enough_to_remove_the_air_in_the_lens(runs, outside):
    """A shorter principal distance has moved points inwards; the correction moves them out."""
    bare = rows_of_camera(runs["bare"], "nadir")
    corrected = rows_of_camera(runs["stated"], "nadir")
    change = expected_ppm(outside) * 1e-6
    assert -150e-6 < change < -90e-6
    moved_px = corrected["x_corrected_px"] - bare["x_corrected_px"]
    expected_px = -change * (corrected["x_px"] - 7012.4)
    assert_allclose(moved_px, expected_px, rtol=0.02, atol=0.002)
    sigma_px = np.abs(moved_px) / 4.0
    assert_allclose(corrected["sigma_cabin_dx_px"], sigma_px, rtol=0.03, atol=0.001)
    # The ray is another by as much, and so its refraction, hardly.
    assert_allclose(corrected["r_c_rad"], bare["r_c_rad"], rtol=1e-3)


def test_what_is_taken_for_typical_stands_in_the_ledger_and_nothing_is_left(runs):
    values = runs["stated"].manifest()
    kinds = {entry["code"]: entry["kind"] for entry in values["ledger"]}
    assert kinds["LENS-TYPICAL"] == "fallback"
    assert kinds["LENS-IN-AIR"] == "note"
    assert "LENS-NOT-REMOVED" not in kinds
    manifest = manifest_of(values)
    assert verdict(manifest) == outcome(manifest)
    assert not any("State the air" in step for step in next_steps(manifest))
    left = " ".join(not_included(manifest))
    assert "A quarter of the effect of the air in the lens of nadir" in left


def test_where_the_calibration_says_nothing_the_verdict_has_the_size(runs, outside, unbend):
    mission = runs["bare"]
    values = mission.manifest()
    entry = entry_of(values, "LENS-NOT-REMOVED")
    assert entry["values"]["ppm"] == approx(-expected_ppm(outside), rel=0.02)
    camera = mission.config["cameras"]["nadir"]
    half_diagonal_px = 0.5 * math.hypot(camera["width_px"], camera["height_px"])
    corner_px = 1e-6 * entry["values"]["ppm"] * half_diagonal_px
    assert entry["values"]["corner_px"] == approx(corner_px)
    manifest = manifest_of(values)
    sentence = verdict(manifest).removeprefix(outcome(manifest)).strip()
    assert sentence.startswith("Not corrected for the air in the lens of nadir, oblique: about ")
    assert any("cameras.nadir, cameras.oblique" in step for step in next_steps(manifest))
    checked = unbend("check", mission.file)
    for ended in (checked, mission.run()):
        assert sentence in one_line(ended.text)


def test_every_run_says_what_a_kelvin_before_the_lens_does(runs):
    values = runs["bare"].manifest()
    lens = values["air_at_cameras"]["nadir"]
    assert lens["before_lens"] == "outside"
    text = " ".join(not_included(manifest_of(values)))
    assert f"each additional kelvin is {100.0 * lens['kelvin_share']:.2g} % of" in text


def test_an_opening_moves_the_points_and_half_of_it_is_its_sigma(runs, outside):
    """n f (1 + tan^2) across: the warm air has moved a point outwards, the correction inwards."""
    bare = rows_of_camera(runs["bare"], "nadir")
    hatch = rows_of_camera(runs["hatch"], "nadir")
    dn = change_of_n(outside, warmer(outside))
    u = (hatch["x_px"] - 7012.4) / F_PX
    v = (hatch["y_px"] - 5291.7) / F_PX
    expected_px = F_PX * dn * u * (1.0 + u * u + v * v)
    moved_px = hatch["x_corrected_px"] - bare["x_corrected_px"]
    assert_allclose(moved_px, expected_px, rtol=0.04, atol=0.002)
    share = hatch["sigma_r_cc_rad"] / -hatch["r_cc_rad"]
    assert_allclose(share, 0.5, rtol=0.06)
    # An error of the air outside is one of the air in the hatch: its sigma stays that of R.
    for column in (
        "sigma_air_dx_px",
        "sigma_air_dy_px",
        "dx_ds_px",
        "sigma_r_c_rad",
        "sigma_station_dx_px",
        "sigma_station_dy_px",
    ):
        expected = bare[column]
        atol = 1e-4 * np.abs(expected).max()
        assert_allclose(hatch[column], expected, rtol=0.02, atol=atol)


def test_an_opening_is_named_as_one(runs):
    values = runs["hatch"].manifest()
    texts = {
        entry["where"]: entry["what"]
        for entry in values["ledger"]
        if entry["code"] == "OPENING-AIR"
    }
    assert "+10 +- 5 K" in texts["cameras.nadir.opening"]
    for code in codes_of(values):
        assert not code.startswith(("WINDOW", "CABIN"))
    assert values["air_at_cameras"]["oblique"]["before_lens"] == "opening"
    manifest = manifest_of(values)
    assert any("cameras.nadir.opening" in step for step in next_steps(manifest))
    assert "each additional kelvin" not in " ".join(not_included(manifest))


@pytest.mark.parametrize("name", ["stated", "hatch"])
def test_exports_of_a_hatch_and_of_a_lens_are_computed_again(runs, obeyed, tmp_path, name):
    out = tmp_path / "lattice.parquet"
    obeyed("export", runs[name].output, "--format", "lattice", "--out", out)


# ---------------------------------------------------------------- what is said, and when

RECORD = {
    "before_lens": "outside",
    "kelvin_share": 0.01,
    "wavelength_m": 5.5e-7,
    "lens_removed": False,
    "lens_ppm": -247.0,
    "lens_sigma_ppm": 61.8,
    "lens_height_m": 1.482,
    "lens_edge_px": 2.1,
    "calibrated_in_flight": False,
}
REMOVED = RECORD | {"lens_removed": True}
IN_FLIGHT = RECORD | {"calibrated_in_flight": True}
SMALLER = RECORD | {"lens_ppm": 90.0}
OF_NO_HEIGHT = RECORD | {"lens_height_m": None}
IN_A = "Not corrected for the air in the lens of a: "
IN_A_AND_B = "Not corrected for the air in the lens of a, b: "
SIZE = "about 247 ± 62 ppm of the principal distance"
HEIGHT = ", 1.5 m of height"
SINCE = ", compared with a calibration at 20 °C and 1013 hPa."
UNLESS = ", unless the calibration was flown at this height."


@pytest.mark.parametrize(
    ("cameras", "sentence"),
    [
        (
            {"a": SMALLER, "b": RECORD, "c": REMOVED},
            IN_A_AND_B + SIZE + HEIGHT + SINCE,
        ),
        ({"a": IN_FLIGHT}, IN_A + SIZE + HEIGHT + UNLESS),
        (
            {"a": IN_FLIGHT, "b": RECORD},
            IN_A_AND_B + SIZE + HEIGHT + SINCE,
        ),
        ({"a": OF_NO_HEIGHT}, IN_A + SIZE + SINCE),
        (
            {"a": RECORD | {"lens_edge_px": 0.05}},
            IN_A + SIZE + HEIGHT + SINCE,
        ),
        ({"a": RECORD | {"lens_edge_px": 0.049}}, ""),
        ({"a": REMOVED}, ""),
        ({}, ""),
    ],
    ids=[
        "largest",
        "calibrated in flight",
        "one calibrated in flight",
        "height unknown",
        "just measurable",
        "too small to be measured",
        "removed",
        "none",
    ],
)
def test_the_sentence_of_the_largest_lens(cameras, sentence):
    manifest = manifest_of_lenses(cameras, corrected=10)
    assert verdict(manifest) == f"{outcome(manifest)} {sentence}".rstrip()


def manifest_of_lenses(cameras, *, corrected):
    shift_px = {"count": corrected, "median": 1.0, "p95": 2.0, "maximum": 3.0}
    return manifest_of(
        {
            "observations": {"rows": 10},
            "correction": {"shift_px": shift_px},
            "air_at_cameras": cameras,
            "config": {"refraction": {"direction": "remove", "method": "spherical"}},
        }
    )


def test_no_word_where_nothing_was_corrected():
    manifest = manifest_of_lenses({"a": RECORD}, corrected=0)
    assert "lens" not in verdict(manifest)
