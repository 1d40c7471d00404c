"""The air in the lens and the air before it: what is removed, what is said where it is not.

Expected values by hand, with the index of air of the simulator (modified Edlen).
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.integrate import quad

from tests.report.manifests import manifest_of
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.refractive_index import IndexModel
from unbend.messages import Ledger
from unbend.refraction.lens_air import TypicalLens, lens_change, sigma_of_change
from unbend.refraction.window import Cabin, Window, refract_at_window
from unbend.report.summary import next_steps, not_included, outcome, verdict
from unbend.simulate.true_air import edlen_index
from unbend.stages.cabin_air import cabin_changes, with_cabin_air, with_errors_of_lenses

from .test_exposure_setup import look, stations

LABORATORY = {"pressure_hpa": 1013.25, "temperature_c": 20.0}
US1976 = standard_atmosphere("us1976")

# A Zeiss lens of 153 mm, calibrated on the ground: Meier's changes [mm], at 6 km in US 1976 and in
# a cabin of 701.2 hPa and 21.1 degC.
AT_6_KM = (47_217.6, 249.187)
IN_CABIN = (70_120.0, 294.26)
MEIER_MM = ((*AT_6_KM, -0.036), (*AT_6_KM, -0.047), (*IN_CABIN, -0.020))


def n_minus_1(pressure_pa: float, temperature_k: float, wavelength_um: float = 0.55) -> float:
    """n - 1 of dry air by the modified Edlen equation."""
    pressure = np.array(pressure_pa)
    temperature = np.array(temperature_k)
    return float(edlen_index(pressure, temperature, np.array(0.0), wavelength_um)) - 1.0


def expected_ppm(pressure_pa: float, temperature_k: float, reference=(101_325.0, 293.15)) -> float:
    """Twice the change of n, in ppm."""
    return 2.0e6 * (n_minus_1(pressure_pa, temperature_k) - n_minus_1(*reference))


# ---------------------------------------------------------------- the typical lens


@pytest.mark.parametrize(("pressure_pa", "temperature_k", "change_mm"), MEIER_MM)
def test_meiers_lens_lies_within_the_sigma_of_a_typical_one(pressure_pa, temperature_k, change_mm):
    lens = TypicalLens(20_000.0)
    change = lens.change_px(pressure_pa, temperature_k, IndexModel())
    sigma = float(sigma_of_change(lens, change))
    ppm = float(change) / 20_000.0 * 1e6
    assert ppm == pytest.approx(expected_ppm(pressure_pa, temperature_k), abs=0.05)
    assert sigma == pytest.approx(abs(float(change)) / 4.0)
    meier_ppm = change_mm / 153.0 * 1e6
    assert abs(meier_ppm - ppm) < 1.01 * sigma / 20_000.0 * 1e6
    assert -310.0 < meier_ppm < -130.0


def test_the_air_of_the_calibration_changes_nothing_whatever_it_was():
    for pressure_pa, temperature_k in ((101_325.0, 293.15), (84_000.0, 278.0), AT_6_KM):
        lens = TypicalLens(12_000.0, pressure_pa, temperature_k)
        assert float(lens_change(lens, pressure_pa, temperature_k, IndexModel())) == 0.0
    denser = lens_change(TypicalLens(12_000.0, *AT_6_KM), 101_325.0, 293.15, IndexModel())
    assert float(denser) == pytest.approx(-12e-3 * expected_ppm(*AT_6_KM), rel=1e-3)
    assert math.isnan(lens_change(TypicalLens(12_000.0), math.nan, 280.0, IndexModel()))


def test_the_lens_in_the_light_of_its_camera():
    blue = TypicalLens(20_000.0).change_px(*AT_6_KM, IndexModel(wavelength_m=0.45e-6))
    expected = n_minus_1(*AT_6_KM, 0.45) - n_minus_1(101_325.0, 293.15, 0.45)
    assert float(blue) == pytest.approx(2.0 * 20_000.0 * expected, rel=3e-4)


def test_behind_a_window_the_lens_is_in_the_air_of_the_cabin():
    at = stations(6000.0)
    lens = TypicalLens(20_000.0)
    free, _ = look(at, None, lens)
    behind, _ = look(at, Window(Cabin("constant", *IN_CABIN)), lens)
    opened, _ = look(at, Window(opening(10.0)), lens)
    pressure = float(US1976.pressure(6000.0))
    temperature = float(US1976.temperature(6000.0))
    for found, air in (
        (free, (pressure, temperature)),
        (behind, IN_CABIN),
        (opened, (pressure, temperature + 10.0)),
    ):
        ppm = found.principal_change_px[0] / 20_000.0 * 1e6
        assert ppm == pytest.approx(expected_ppm(*air), abs=0.2)


def test_the_sigma_of_a_typical_lens_and_where_none_is_known():
    """A quarter of the change, alone or with the cabin's; a cabin without a sigma keeps none."""
    at = stations(6000.0)
    lenses = {"nadir": TypicalLens(20_000.0)}
    change = np.array([-4.9])

    def errors(cabin: Cabin | None):
        windows = {} if cabin is None else {"nadir": Window(cabin)}
        filled = with_cabin_air(at, windows, lenses, US1976, Ledger())
        known = cabin_changes(filled, lenses, US1976)
        return with_errors_of_lenses(known, filled, lenses, windows, change)[0]

    assert errors(None) == pytest.approx([0.0, 0.0, 0.0, -4.9 / 4.0])
    assert np.isnan(errors(Cabin("constant", *IN_CABIN))).all()
    known = errors(Cabin("constant", *IN_CABIN, sigma_pressure_pa=300.0, sigma_temperature_k=5.0))
    by_pressure = n_minus_1(70_420.0, 294.26) - n_minus_1(70_120.0, 294.26)
    by_temperature = 0.5 * (n_minus_1(70_120.0, 299.26) - n_minus_1(70_120.0, 289.26))
    assert known[:2] == pytest.approx([by_pressure, by_temperature], rel=3e-3)
    assert known[2] == pytest.approx(2.0 * 20_000.0 * by_pressure, rel=3e-3)
    assert known[3] == pytest.approx(-math.hypot(4.9 / 4.0, 40_000.0 * by_temperature), rel=3e-3)


# ---------------------------------------------------------------- an opening


def opening(warmer_k: float, excess_pa: float = 0.0) -> Cabin:
    return Cabin(
        "opening",
        warmer_k=warmer_k,
        excess_pa=excess_pa,
        sigma_pressure_pa=0.0,
        sigma_temperature_k=0.5 * abs(warmer_k),
    )


def plane_refraction(height_m: float) -> float:
    """R over tan zeta from a height down to the sea, by Gyer's Eq. 24 and Edlen's index."""

    def n(h: float) -> float:
        return n_minus_1(float(US1976.pressure(h)), float(US1976.temperature(h)))

    mean = quad(n, 0.0, height_m, epsrel=1e-6)[0] / height_m
    return mean - n(height_m)


@pytest.mark.parametrize(
    ("height_m", "percent"), [(1000.0, 68.0), (3000.0, 22.0), (6000.0, 10.0), (10_000.0, 5.0)]
)
def test_ten_kelvin_in_an_open_hatch(height_m, percent):
    """68, 22, 10 and 5 % of R at 45 degrees, as the page on lenses says; the ray bends outwards."""
    found, ledger = look(stations(height_m), Window(opening(10.0)))
    ray = np.array([[math.sqrt(0.5), 0.0, math.sqrt(0.5)]])
    _, r_cc = refract_at_window(
        ray, found.refractivity_cabin, found.refractivity_outside, found.window_normal
    )
    pressure = float(US1976.pressure(height_m))
    temperature = float(US1976.temperature(height_m))
    expected = n_minus_1(pressure, temperature + 10.0) - n_minus_1(pressure, temperature)
    assert r_cc[0] == pytest.approx(expected, rel=3e-3)
    assert r_cc[0] < 0.0
    share = -100.0 * r_cc[0] / plane_refraction(height_m)
    assert share == pytest.approx(percent, rel=0.03)
    assert [entry.code for entry in ledger] == []


def test_air_under_another_pressure_at_the_skin():
    found, _ = look(stations(6000.0), Window(opening(0.0, -700.0)))
    pressure = float(US1976.pressure(6000.0))
    temperature = float(US1976.temperature(6000.0))
    expected = n_minus_1(pressure - 700.0, temperature) - n_minus_1(pressure, temperature)
    change = found.refractivity_cabin[0] - found.refractivity_outside[0]
    assert change == pytest.approx(expected, rel=2e-3)


# ---------------------------------------------------------------- the whole program


def ran(mission) -> dict:
    ended = mission.run()
    assert ended.code == 0, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def without_windows(mission):
    """The cameras look out freely, and nothing is said of a cabin."""
    for camera in mission.config["cameras"].values():
        camera.pop("window", None)
    for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
        mission.config["log"]["channels"].pop(role, None)
    mission.config["accept"] = []
    return mission


def air_of_stations(mission) -> tuple[float, float]:
    """Pressure and temperature in the middle of the stations, by their columns."""
    table = mission.stations().to_pandas()
    return float(table["pressure_pa"].median()), float(table["temperature_k"].median())


@pytest.fixture(scope="module")
def runs(mission_factory, tmp_path_factory):
    """One flight without windows: as it is, with the air of the calibration, with an open hatch."""
    made = {}
    for name in ("bare", "stated", "hatch"):
        mission = without_windows(mission_factory(tmp_path_factory.mktemp(name) / "mission"))
        for camera in mission.config["cameras"].values():
            if name == "stated":
                camera["principal_distance"] = {"reference": LABORATORY}
            if name == "hatch":
                camera["opening"] = {"warmer_k": 10.0}
        made[name] = mission, ran(mission)
    return made


def shift(mission, other, axis: str) -> np.ndarray:
    """By how much the corrected coordinates of two runs differ."""
    column = f"{axis}_corrected_px"
    return mission.results()[column].to_numpy() - other.results()[column].to_numpy()


def of_camera(mission, camera: str) -> np.ndarray:
    names = mission.stations().to_pandas().set_index("image")["camera"]
    return (mission.results().to_pandas()["image"].map(names) == camera).to_numpy()


@pytest.mark.usefixtures("plain_report")
def test_the_air_of_the_calibration_is_enough_to_remove_the_air_in_the_lens(runs):
    """A shorter principal distance has moved points inwards; the correction moves them out."""
    bare = runs["bare"][0]
    stated = runs["stated"][0]
    expected = expected_ppm(*air_of_stations(bare)) * 1e-6
    assert -150e-6 < expected < -90e-6
    table = stated.results().to_pandas()
    rows = of_camera(stated, "nadir")
    x = table["x_px"].to_numpy()[rows] - 7012.4
    moved = shift(stated, bare, "x")[rows]
    np.testing.assert_allclose(moved, -expected * x, rtol=0.02, atol=0.002)
    sigma = table["sigma_cabin_dx_px"].to_numpy()[rows]
    np.testing.assert_allclose(sigma, np.abs(moved) / 4.0, rtol=0.03, atol=0.001)
    # The ray is another by as much, and so its refraction, hardly.
    np.testing.assert_allclose(table["r_c_rad"], bare.results().to_pandas()["r_c_rad"], rtol=1e-3)


@pytest.mark.usefixtures("plain_report")
def test_what_is_taken_for_typical_stands_in_the_ledger_and_nothing_is_left(runs):
    _, manifest = runs["stated"]
    codes = [(entry["kind"], entry["code"]) for entry in manifest["ledger"]]
    assert ("fallback", "LENS-TYPICAL") in codes
    assert ("note", "LENS-IN-AIR") in codes
    assert "LENS-NOT-REMOVED" not in dict(codes).values()
    whole = manifest_of(manifest)
    assert verdict(whole) == outcome(whole)
    assert not any("principal_distance" in step for step in next_steps(whole))
    assert "as for a typical lens" in " ".join(not_included(whole))


@pytest.mark.usefixtures("plain_report")
def test_where_the_calibration_says_nothing_the_verdict_has_the_size(runs, unbend):
    mission, manifest = runs["bare"]
    ppm = -expected_ppm(*air_of_stations(mission))
    whole = manifest_of(manifest)
    text = verdict(whole)
    assert text.startswith(outcome(whole))
    said = text.removeprefix(outcome(whole)).strip()
    assert said.startswith("Not corrected for the air in the lens of nadir, oblique: about ")
    stated_ppm = float(said.split("about ")[1].split(" ±")[0])
    assert stated_ppm == pytest.approx(ppm, rel=0.02)
    above_m = manifest["flight"]["cameras"]["nadir"]["height_above_ground_m"][1]
    metres = float(said.split("distance, ")[1].split(" of height")[0].split()[0])
    assert metres / (100.0 if " cm of height" in said else 1.0) == pytest.approx(
        ppm * 1e-6 * above_m, rel=0.05
    )
    assert any("cameras.nadir, cameras.oblique" in step for step in next_steps(whole))
    checked = unbend("check", mission.file)
    assert said in " ".join(checked.text.split())
    (left,) = [e for e in manifest["ledger"] if e["code"] == "LENS-NOT-REMOVED"]
    assert left["values"]["ppm"] == pytest.approx(ppm, rel=0.02)
    again = mission.run()
    assert said in " ".join(again.text.split())


@pytest.mark.usefixtures("plain_report")
def test_every_run_says_what_a_kelvin_before_the_lens_does(runs):
    mission, manifest = runs["bare"]
    pressure, temperature = air_of_stations(mission)
    by_kelvin = n_minus_1(pressure, temperature) / temperature
    effect = manifest["profile"]["effect"][0]
    assert effect["nadir_angle_deg"] == 45.0
    share = by_kelvin / math.radians(effect["r_c_arcsec"] / 3600.0)
    record = manifest["air_at_cameras"]["nadir"]
    assert record["before_lens"] == "outside"
    assert record["kelvin_share"] == pytest.approx(share, rel=0.02)
    lines = " ".join(not_included(manifest_of(manifest)))
    assert f"each additional kelvin is {100.0 * record['kelvin_share']:.2g} % of" in lines
    hatch = " ".join(not_included(manifest_of(runs["hatch"][1])))
    assert "each additional kelvin" not in hatch


@pytest.mark.usefixtures("plain_report")
def test_an_opening_moves_the_points_and_half_of_it_is_its_sigma(runs):
    """n f (1 + tan^2) across: the warm air has moved a point outwards, the correction inwards."""
    bare = runs["bare"][0]
    hatch = runs["hatch"][0]
    pressure, temperature = air_of_stations(bare)
    dn = n_minus_1(pressure, temperature + 10.0) - n_minus_1(pressure, temperature)
    table = hatch.results().to_pandas()
    rows = of_camera(hatch, "nadir")
    u = (table["x_px"].to_numpy()[rows] - 7012.4) / 20_000.0
    v = (table["y_px"].to_numpy()[rows] - 5291.7) / 20_000.0
    expected = 20_000.0 * dn * u * (1.0 + u * u + v * v)
    moved = shift(hatch, bare, "x")[rows]
    np.testing.assert_allclose(moved, expected, rtol=0.04, atol=0.002)
    share = table["sigma_r_cc_rad"][rows] / -table["r_cc_rad"][rows]
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
        one = table[column].to_numpy()
        other = bare.results().to_pandas()[column].to_numpy()
        np.testing.assert_allclose(one, other, rtol=0.02, atol=1e-4 * np.abs(other).max())


@pytest.mark.usefixtures("plain_report")
def test_an_opening_is_named_as_one(runs):
    _, manifest = runs["hatch"]
    said = {(e["code"], e["where"]): e["what"] for e in manifest["ledger"]}
    assert "+10 +- 5 K" in said["OPENING-AIR", "cameras.nadir.opening"]
    assert not any(code.startswith(("WINDOW", "CABIN")) for code, _ in said)
    assert manifest["air_at_cameras"]["oblique"]["before_lens"] == "opening"
    whole = manifest_of(manifest)
    assert any("cameras.nadir.opening" in step for step in next_steps(whole))


@pytest.mark.usefixtures("plain_report")
def test_exports_of_a_hatch_and_of_a_lens_are_computed_again(runs, unbend, tmp_path):
    for name in ("stated", "hatch"):
        out = tmp_path / f"{name}.parquet"
        ended = unbend("export", runs[name][0].output, "--format", "lattice", "--out", out)
        assert ended.code == 0, ended.text


# ---------------------------------------------------------------- what is said, and when


def lens_record(**changed) -> dict:
    record = {
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
    return record | changed


def verdict_of(cameras: dict[str, dict], corrected: int = 10) -> str:
    shift_px = {"count": corrected, "median": 1.0, "p95": 2.0, "maximum": 3.0}
    return verdict(
        manifest_of(
            {
                "observations": {"rows": 10},
                "correction": {"shift_px": shift_px},
                "air_at_cameras": cameras,
                "config": {"refraction": {"direction": "remove", "method": "spherical"}},
            }
        )
    )


def test_the_sentence_of_the_largest_lens():
    text = verdict_of(
        {"a": lens_record(lens_ppm=-90.0), "b": lens_record(), "c": lens_record(lens_removed=True)}
    )
    assert text.endswith(
        "Not corrected for the air in the lens of a, b: about 247 ± 62 ppm of the principal "
        "distance, 1.5 m of height, since a calibration at 20 °C and 1013 hPa."
    )


def test_a_calibration_in_flight_may_have_been_as_high():
    text = verdict_of({"a": lens_record(calibrated_in_flight=True)})
    assert text.endswith(", unless the calibration was flown at this height.")
    mixed = verdict_of({"a": lens_record(calibrated_in_flight=True), "b": lens_record()})
    assert mixed.endswith(", since a calibration at 20 °C and 1013 hPa.")


@pytest.mark.parametrize(
    "cameras",
    [{}, {"a": lens_record(lens_edge_px=0.049)}, {"a": lens_record(lens_removed=True)}],
    ids=["none", "too small to be measured", "removed"],
)
def test_no_word_where_there_is_nothing_to_say(cameras):
    assert "lens" not in verdict_of(cameras)


def test_no_word_where_nothing_was_corrected():
    assert "lens" not in verdict_of({"a": lens_record()}, corrected=0)


def test_a_height_that_is_not_known_is_not_said():
    text = verdict_of({"a": lens_record(lens_height_m=None)})
    assert "principal distance, since" in text
