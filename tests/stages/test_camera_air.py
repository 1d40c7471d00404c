"""The air in the lens and the air before it: what is removed, what is said where it is not.

Expected values by hand, with the index of air of the simulator (modified Edlen).
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from tests.conftest import without_plots
from tests.helpers import entry_of
from tests.report.manifests import manifest_of
from tests.stages.level_cameras import US1976, look, stations
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

LABORATORY = {"pressure_hpa": 1013.25, "temperature_c": 20.0}
LABORATORY_AIR = (101_325.0, 293.15)

# A Zeiss lens of 153 mm, calibrated on the ground: Meier's changes [mm], at 6 km in US 1976 and in
# a cabin of 701.2 hPa and 21.1 degC.
AT_6_KM = (47_217.6, 249.187)
IN_CABIN = (70_120.0, 294.26)
MEIER_MM = [(*AT_6_KM, -0.036), (*AT_6_KM, -0.047), (*IN_CABIN, -0.020)]


def n_minus_1(pressure_pa: float, temperature_k: float, wavelength_um: float = 0.55) -> float:
    """n - 1 of dry air by the modified Edlen equation."""
    air = (np.array(pressure_pa), np.array(temperature_k), np.array(0.0))
    return float(edlen_index(*air, wavelength_um)) - 1.0


def expected_ppm(pressure_pa: float, temperature_k: float) -> float:
    """Twice the change of n since the laboratory, in ppm."""
    return 2.0e6 * (n_minus_1(pressure_pa, temperature_k) - n_minus_1(*LABORATORY_AIR))


# ---------------------------------------------------------------- the typical lens


@pytest.mark.parametrize(("pressure_pa", "temperature_k", "change_mm"), MEIER_MM)
def test_meiers_lens_lies_within_the_sigma_of_a_typical_one(pressure_pa, temperature_k, change_mm):
    lens = TypicalLens(20_000.0)
    change_px = float(lens.change_px(pressure_pa, temperature_k, IndexModel()))
    sigma_px = float(sigma_of_change(lens, change_px))
    ppm = change_px / 20_000.0 * 1e6
    assert ppm == pytest.approx(expected_ppm(pressure_pa, temperature_k), abs=0.05)
    assert sigma_px == pytest.approx(abs(change_px) / 4.0)
    meier_ppm = change_mm / 153.0 * 1e6
    assert abs(meier_ppm - ppm) < 1.01 * sigma_px / 20_000.0 * 1e6


@pytest.mark.parametrize("air", [LABORATORY_AIR, (84_000.0, 278.0), AT_6_KM])
def test_the_air_of_the_calibration_changes_nothing_whatever_it_was(air):
    lens = TypicalLens(12_000.0, *air)
    assert float(lens_change(lens, *air, IndexModel())) == 0.0
    change_px = float(lens_change(lens, *LABORATORY_AIR, IndexModel()))
    assert change_px == pytest.approx(-12e-3 * expected_ppm(*air), rel=1e-3)


def test_a_lens_in_unknown_air_is_no_number():
    assert math.isnan(lens_change(TypicalLens(12_000.0), math.nan, 280.0, IndexModel()))


def test_the_lens_in_the_light_of_its_camera():
    blue = TypicalLens(20_000.0).change_px(*AT_6_KM, IndexModel(wavelength_m=0.45e-6))
    change = n_minus_1(*AT_6_KM, 0.45) - n_minus_1(*LABORATORY_AIR, 0.45)
    assert float(blue) == pytest.approx(40_000.0 * change, rel=3e-4)


def opening(warmer_k: float, excess_pa: float = 0.0) -> Cabin:
    return Cabin(
        "opening",
        warmer_k=warmer_k,
        excess_pa=excess_pa,
        sigma_pressure_pa=0.0,
        sigma_temperature_k=0.5 * abs(warmer_k),
    )


@pytest.mark.parametrize(
    ("window", "air"),
    [
        (None, AT_6_KM),
        (Window(Cabin("constant", *IN_CABIN)), IN_CABIN),
        (Window(opening(10.0)), (AT_6_KM[0], AT_6_KM[1] + 10.0)),
    ],
    ids=["free", "cabin", "opening"],
)
def test_the_lens_is_in_the_air_before_it(window, air):
    exposures, _ = look(stations(6000.0), window, TypicalLens(20_000.0))
    ppm = exposures.principal_change_px[0] / 20_000.0 * 1e6
    assert ppm == pytest.approx(expected_ppm(*air), abs=0.2)


def errors_behind(cabin: Cabin | None, change_px: float) -> np.ndarray:
    """What one sigma of cabin and lens changes at an exposure, as in `cabin_changes`."""
    lenses = {"nadir": TypicalLens(20_000.0)}
    windows = {} if cabin is None else {"nadir": Window(cabin)}
    exposed = with_cabin_air(stations(6000.0), windows, lenses, US1976, Ledger())
    changes = cabin_changes(exposed, lenses, US1976)
    return with_errors_of_lenses(changes, exposed, lenses, windows, np.array([change_px]))[0]


def test_the_sigma_of_a_typical_lens_and_where_none_is_known():
    """A quarter of the change, alone or with the cabin's; a cabin without a sigma keeps none."""
    assert errors_behind(None, -4.9) == pytest.approx([0.0, 0.0, 0.0, -4.9 / 4.0])
    assert np.isnan(errors_behind(Cabin("constant", *IN_CABIN), -4.9)).all()
    cabin = Cabin("constant", *IN_CABIN, sigma_pressure_pa=300.0, sigma_temperature_k=5.0)
    by_pressure = n_minus_1(70_420.0, 294.26) - n_minus_1(70_120.0, 294.26)
    by_temperature = 0.5 * (n_minus_1(70_120.0, 299.26) - n_minus_1(70_120.0, 289.26))
    of_lens_px = -math.hypot(4.9 / 4.0, 40_000.0 * by_temperature)
    expected = [by_pressure, by_temperature, 40_000.0 * by_pressure, of_lens_px]
    assert errors_behind(cabin, -4.9) == pytest.approx(expected, rel=3e-3)


# ---------------------------------------------------------------- an opening


def outside_at(height_m: float) -> tuple[float, float]:
    """Pressure [Pa] and temperature [K]."""
    return float(US1976.pressure(height_m)), float(US1976.temperature(height_m))


def plane_refraction(height_m: float) -> float:
    """R over tan zeta from a height down to the sea, by Gyer's Eq. 24 and Edlen's index."""
    integral, _ = quad(lambda h: n_minus_1(*outside_at(h)), 0.0, height_m, epsrel=1e-6)
    return integral / height_m - n_minus_1(*outside_at(height_m))


@pytest.mark.parametrize(
    ("height_m", "percent"), [(1000.0, 68.0), (3000.0, 22.0), (6000.0, 10.0), (10_000.0, 5.0)]
)
def test_ten_kelvin_in_an_open_hatch(height_m, percent):
    """68, 22, 10 and 5 % of R at 45 degrees, as the page on lenses says; the ray bends outwards."""
    exposures, ledger = look(stations(height_m), Window(opening(10.0)))
    _, (r_cc,) = refract_at_window(
        np.array([[math.sqrt(0.5), 0.0, math.sqrt(0.5)]]),
        exposures.refractivity_cabin,
        exposures.refractivity_outside,
        exposures.window_normal,
    )
    pressure, temperature = outside_at(height_m)
    expected = n_minus_1(pressure, temperature + 10.0) - n_minus_1(pressure, temperature)
    assert expected < 0.0
    assert r_cc == pytest.approx(expected, rel=3e-3)
    share = -100.0 * r_cc / plane_refraction(height_m)
    assert share == pytest.approx(percent, rel=0.03)
    assert len(ledger) == 0


def test_air_under_another_pressure_at_the_skin():
    exposures, _ = look(stations(6000.0), Window(opening(0.0, -700.0)))
    pressure, temperature = outside_at(6000.0)
    expected = n_minus_1(pressure - 700.0, temperature) - n_minus_1(pressure, temperature)
    change = exposures.refractivity_cabin - exposures.refractivity_outside
    assert change == pytest.approx([expected], rel=2e-3)


# ---------------------------------------------------------------- its size, in the manifest


def test_the_sizes_of_an_unknown_lens():
    """Of the middle height above the ground, the farthest corner, and R at 45 degrees."""
    exposed = stations(6000.0)
    section = SimpleNamespace(calibration="in_flight_corrected")
    mission = SimpleNamespace(cameras={"nadir": section}, lenses={}, windows={})
    flown = SimpleNamespace(height_above_ground_m=[1000.0, 20_000.0, 40_000.0])
    effects = (Effect(75.0, 6000.0, 0.0, 9e-4, 9e-4), Effect(45.0, 6000.0, 0.0, 1e-4, 1e-4))
    records = camera_air_records(
        mission,
        exposed,
        constant_series(TimedProfile(None, US1976), exposures=1),
        cameras={"nadir": Camera(10_000, 8_000, 5_000.0, 5_000.0, 3_000.0, 6_000.0)},
        flown={"nadir": flown},
        effects=effects,
    )
    ppm = expected_ppm(*AT_6_KM)
    record = records["nadir"]
    assert record.lens_ppm == pytest.approx(ppm, abs=0.2)
    assert record.lens_sigma_ppm == pytest.approx(-ppm / 4.0, abs=0.1)
    assert record.lens_height_m == pytest.approx(-ppm * 0.02, abs=0.005)
    corner_px = math.hypot(7_000.0, 6_000.0)
    assert record.lens_edge_px == pytest.approx(-ppm * 1e-6 * corner_px, abs=0.003)
    share = n_minus_1(*AT_6_KM) / AT_6_KM[1] / 1e-4
    assert record.kelvin_share == pytest.approx(share, rel=0.005)
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
    made = {}
    for name, entry in entries.items():
        mission = mission_factory(tmp_path_factory.mktemp(name) / "mission")
        for camera in mission.config["cameras"].values():
            camera.pop("window", None)
            camera.update(entry)
        channels = mission.config["log"]["channels"]
        for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
            channels.pop(role, None)
        mission.config["accept"] = []
        with without_plots():
            mission.run_to_manifest()
        made[name] = mission
    return made


@pytest.fixture(scope="module")
def outside(runs) -> tuple[float, float]:
    """Pressure and temperature in the middle of the stations, by their columns."""
    table = runs["bare"].stations().to_pandas()
    return table["pressure_pa"].median(), table["temperature_k"].median()


def nadir_rows(mission):
    """The corrected observations of the nadir camera."""
    camera_of_image = mission.stations().to_pandas().set_index("image")["camera"]
    table = mission.results().to_pandas()
    return table[table["image"].map(camera_of_image) == "nadir"]


def test_the_air_of_the_calibration_is_enough_to_remove_the_air_in_the_lens(runs, outside):
    """A shorter principal distance has moved points inwards; the correction moves them out."""
    bare = nadir_rows(runs["bare"])
    stated = nadir_rows(runs["stated"])
    change = expected_ppm(*outside) * 1e-6
    assert -150e-6 < change < -90e-6
    moved = stated["x_corrected_px"] - bare["x_corrected_px"]
    expected = -change * (stated["x_px"] - 7012.4)
    np.testing.assert_allclose(moved, expected, rtol=0.02, atol=0.002)
    sigma = stated["sigma_cabin_dx_px"]
    np.testing.assert_allclose(sigma, np.abs(moved) / 4.0, rtol=0.03, atol=0.001)
    # The ray is another by as much, and so its refraction, hardly.
    np.testing.assert_allclose(stated["r_c_rad"], bare["r_c_rad"], rtol=1e-3)


def test_what_is_taken_for_typical_stands_in_the_ledger_and_nothing_is_left(runs):
    values = runs["stated"].manifest()
    kinds = {(entry["kind"], entry["code"]) for entry in values["ledger"]}
    assert ("fallback", "LENS-TYPICAL") in kinds
    assert ("note", "LENS-IN-AIR") in kinds
    assert "LENS-NOT-REMOVED" not in {entry["code"] for entry in values["ledger"]}
    manifest = manifest_of(values)
    assert verdict(manifest) == outcome(manifest)
    assert not any("principal_distance" in step for step in next_steps(manifest))
    assert "as for a typical lens" in " ".join(not_included(manifest))


def test_where_the_calibration_says_nothing_the_verdict_has_the_size(runs, outside, unbend):
    mission = runs["bare"]
    values = mission.manifest()
    ppm = entry_of(values, "LENS-NOT-REMOVED")["values"]["ppm"]
    assert ppm == pytest.approx(-expected_ppm(*outside), rel=0.02)
    manifest = manifest_of(values)
    sentence = verdict(manifest).removeprefix(outcome(manifest)).strip()
    assert sentence.startswith("Not corrected for the air in the lens of nadir, oblique: about ")
    assert any("cameras.nadir, cameras.oblique" in step for step in next_steps(manifest))
    for shown in (unbend("check", mission.file), mission.run()):
        assert sentence in " ".join(shown.text.split())


def test_every_run_says_what_a_kelvin_before_the_lens_does(runs):
    values = runs["bare"].manifest()
    lens = values["air_at_cameras"]["nadir"]
    assert lens["before_lens"] == "outside"
    text = " ".join(not_included(manifest_of(values)))
    assert f"each additional kelvin is {100.0 * lens['kelvin_share']:.2g} % of" in text


def test_an_opening_moves_the_points_and_half_of_it_is_its_sigma(runs, outside):
    """n f (1 + tan^2) across: the warm air has moved a point outwards, the correction inwards."""
    bare = nadir_rows(runs["bare"])
    hatch = nadir_rows(runs["hatch"])
    pressure, temperature = outside
    dn = n_minus_1(pressure, temperature + 10.0) - n_minus_1(pressure, temperature)
    u = (hatch["x_px"] - 7012.4) / 20_000.0
    v = (hatch["y_px"] - 5291.7) / 20_000.0
    expected = 20_000.0 * dn * u * (1.0 + u * u + v * v)
    moved = hatch["x_corrected_px"] - bare["x_corrected_px"]
    np.testing.assert_allclose(moved, expected, rtol=0.04, atol=0.002)
    share = hatch["sigma_r_cc_rad"] / -hatch["r_cc_rad"]
    np.testing.assert_allclose(share, 0.5, rtol=0.06)
    # An error of the air outside is one of the air in the hatch: its sigma stays that of R.
    for column in (
        "sigma_air_dx_px",
        "sigma_air_dy_px",
        "dx_ds_px",
        "sigma_r_c_rad",
        "sigma_station_dx_px",
        "sigma_station_dy_px",
    ):
        largest = np.abs(bare[column]).max()
        np.testing.assert_allclose(hatch[column], bare[column], rtol=0.02, atol=1e-4 * largest)


def test_an_opening_is_named_as_one(runs):
    values = runs["hatch"].manifest()
    texts = {(entry["code"], entry["where"]): entry["what"] for entry in values["ledger"]}
    assert "+10 +- 5 K" in texts["OPENING-AIR", "cameras.nadir.opening"]
    assert not any(code.startswith(("WINDOW", "CABIN")) for code, _ in texts)
    assert values["air_at_cameras"]["oblique"]["before_lens"] == "opening"
    manifest = manifest_of(values)
    assert any("cameras.nadir.opening" in step for step in next_steps(manifest))
    assert "each additional kelvin" not in " ".join(not_included(manifest))


@pytest.mark.parametrize("name", ["stated", "hatch"])
def test_exports_of_a_hatch_and_of_a_lens_are_computed_again(runs, unbend, tmp_path, name):
    out = tmp_path / "lattice.parquet"
    ended = unbend("export", runs[name].output, "--format", "lattice", "--out", out)
    assert ended.code == 0, ended.text


# ---------------------------------------------------------------- what is said, and when

LENS = {
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
REMOVED = LENS | {"lens_removed": True}
IN_FLIGHT = LENS | {"calibrated_in_flight": True}
IN_A = "Not corrected for the air in the lens of a: "
SIZE = "about 247 ± 62 ppm of the principal distance"
SINCE = ", since a calibration at 20 °C and 1013 hPa."


@pytest.mark.parametrize(
    ("cameras", "sentence"),
    [
        (
            {"a": LENS | {"lens_ppm": 90.0}, "b": LENS, "c": REMOVED},
            f"Not corrected for the air in the lens of a, b: {SIZE}, 1.5 m of height{SINCE}",
        ),
        (
            {"a": IN_FLIGHT},
            f"{IN_A}{SIZE}, 1.5 m of height, unless the calibration was flown at this height.",
        ),
        (
            {"a": IN_FLIGHT, "b": LENS},
            f"Not corrected for the air in the lens of a, b: {SIZE}, 1.5 m of height{SINCE}",
        ),
        ({"a": LENS | {"lens_height_m": None}}, f"{IN_A}{SIZE}{SINCE}"),
        ({"a": LENS | {"lens_edge_px": 0.05}}, f"{IN_A}{SIZE}, 1.5 m of height{SINCE}"),
        ({"a": LENS | {"lens_edge_px": 0.049}}, ""),
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


def manifest_of_lenses(cameras: dict, *, corrected: int):
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
    assert "lens" not in verdict(manifest_of_lenses({"a": LENS}, corrected=0))
