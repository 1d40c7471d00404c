"""Standard deviations from the mission file to the results, and what is said where there are none.

The covariance here is that of the pressure alone: R goes with pressure, so its relative error is
that of the pressure, whatever the ray. What a window makes of it is seen in runs whose air has that
much more and less of it.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere.covariance import ProfileCovariance
from unbend.batch.runs import read_mission
from unbend.flight.trajectory import _Curve
from unbend.stages import story as stages
from unbend.stages.uncertainty import station_sigmas

pytestmark = pytest.mark.usefixtures("plain_report")

LN_P = 0.004
COLUMNS = {
    kind: [f"sigma_{kind}_dx_px", f"sigma_{kind}_dy_px"] for kind in ("air", "station", "ground")
}


def with_covariance(monkeypatch, covariance_of):
    """Runs whose air, all of it, has this covariance."""
    original = stages.adjusted_profiles

    def adjusted_profiles(*given):
        air = original(*given)
        covariance = covariance_of(air.adjustment.profile)
        airs = tuple(
            replace(timed, own_covariance=covariance, neighbours=None)
            for timed in air.series.timed_profiles
        )
        adjustment = replace(air.adjustment, covariance=covariance)
        return replace(air, adjustment=adjustment, series=replace(air.series, timed_profiles=airs))

    monkeypatch.setattr(stages, "adjusted_profiles", adjusted_profiles)


def pressure_alone(profile) -> ProfileCovariance:
    size = profile.layers.edge.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[size, size] = LN_P**2
    return ProfileCovariance(profile, 1000.0, matrix)


@pytest.fixture
def pressure_in_doubt(monkeypatch):
    """Runs know their pressure to 0.4 %, and nothing else of the air is in doubt."""

    with_covariance(monkeypatch, pressure_alone)


@pytest.fixture
def nothing_in_doubt(monkeypatch):
    """Runs of which nobody knows how good their air is."""
    with_covariance(monkeypatch, lambda profile: None)


@pytest.fixture
def steady_between_samples(monkeypatch):
    """Attitudes and positions between the samples of the log are as well known as at them."""
    monkeypatch.setattr(
        _Curve, "sigma", lambda curve, place, **_: np.zeros((place.fraction.size, 3))
    )


def ran(mission, exit_code: int = 0) -> dict:
    ended = mission.run("--force")
    assert ended.code == exit_code, ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def unknown(manifest: dict) -> list[str]:
    return [e["what"] for e in manifest["ledger"] if e["code"] == "SIGMA-UNKNOWN"]


def without_windows(mission) -> None:
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "the hatch was open"}]
    for camera in mission.config["cameras"].values():
        del camera["window"]


def with_tilt(mission, tilt=0.2) -> None:
    for mount in mission.config["mount"].values():
        mount["sigma_tilt_deg"] = tilt


def good(mission):
    table = mission.results().to_pandas()
    return table[table["status"] == "ok"]


@pytest.mark.usefixtures("pressure_in_doubt")
def test_all_three(mission):
    with_tilt(mission)
    mission.config["ground"]["sigma_m"] = 5.0
    manifest = ran(mission)
    table = good(mission)
    for names in COLUMNS.values():
        assert np.isfinite(table[names].to_numpy()).all()
        assert (table[names].to_numpy() > 0.0).all()
    np.testing.assert_allclose(table["sigma_r_c_rad"], LN_P * table["r_c_rad"], rtol=2e-3)
    scale = manifest["uncertainty"]
    assert scale["profiles"] == 1
    assert "also behind a plane window" in scale["meaning"]
    assert not unknown(manifest)
    meaning = mission.results().schema.field("sigma_air_dx_px").metadata[b"meaning"]
    assert b"never add it to the weights" in meaning


@pytest.mark.usefixtures("pressure_in_doubt")
def test_the_shift_is_scaled_by_the_air(mission):
    """Without a window the whole shift is refraction, and the air scales it in x and y alike."""
    without_windows(mission)
    scale = ran(mission)["uncertainty"]
    np.testing.assert_allclose(scale["scale_sigma"], LN_P, rtol=1e-3)
    np.testing.assert_allclose(scale["variance_share"], 1.0, rtol=1e-3)
    table = good(mission)
    for axis in "xy":
        shift = (table[f"{axis}_corrected_px"] - table[f"{axis}_px"]).abs()
        np.testing.assert_allclose(table[f"sigma_air_d{axis}_px"], LN_P * shift, rtol=5e-3)
        signed = table[f"{axis}_corrected_px"] - table[f"{axis}_px"]
        np.testing.assert_allclose(table[f"d{axis}_ds_px"], signed, rtol=5e-3)
        assert table[f"d{axis}_dncc_px"].isna().all()


CABIN = {"pressure_hpa": 820.0, "temperature_c": 22.0, "relative_humidity": 0.2}
# Windows of the nadir and of the oblique camera, which looks out of the side.
WINDOWS = {
    "logged, and a schedule": ({"cabin": "log"}, {"cabin": "standard_schedule"}),
    "constant, and leaning": (
        {"cabin": CABIN},
        {"cabin": CABIN, "frame": "body", "normal": [0.0, 0.5735764, 0.8191520]},
    ),
    "none, and logged": (None, {"cabin": "log"}),
    "ambient": ({"cabin": {"pressure": "ambient"}}, {"cabin": {"pressure": "ambient"}}),
}


@pytest.mark.parametrize("windows", WINDOWS.values(), ids=WINDOWS)
def test_behind_a_window_against_runs_in_other_air(mission, monkeypatch, windows):
    """0.4 % of pressure more and less, in the whole program: the sigma is half the difference."""
    mission.config["accept"] = [{"code": "CABIN-IMPLAUSIBLE", "reason": "it is open for the test"}]
    for camera, window in zip(mission.config["cameras"].values(), windows, strict=True):
        if window is None:
            del camera["window"]
        else:
            camera["window"] = window
    original = stages.adjusted_profiles

    def shifts(ln_p: float):
        with monkeypatch.context() as patch:

            def adjusted_profiles(*given):
                air = original(*given)
                profile = air.adjustment.profile
                denser = profile.at_level(0.0, profile.pressure(0.0) * np.exp(ln_p))
                airs = tuple(replace(one, profile=denser) for one in air.series.timed_profiles)
                return replace(air, series=replace(air.series, timed_profiles=airs))

            patch.setattr(stages, "adjusted_profiles", adjusted_profiles)
            ran(mission)
        table = good(mission)
        return np.stack([table[f"{a}_corrected_px"] - table[f"{a}_px"] for a in "xy"])

    signed = (shifts(LN_P) - shifts(-LN_P)) / 2.0
    expected = np.abs(signed)
    with_covariance(monkeypatch, pressure_alone)
    manifest = ran(mission)
    table = good(mission)
    scale = manifest["uncertainty"]
    for axis, of_axis, with_sign in zip("xy", expected, signed, strict=True):
        close = {"rtol": 0.01, "atol": 0.003 * np.median(of_axis)}
        np.testing.assert_allclose(table[f"sigma_air_d{axis}_px"], of_axis, **close)
        # Of one uncertain quantity the leading mode is all.
        of_mode = table[f"d{axis}_ds_px"] * scale["scale_sigma"]
        np.testing.assert_allclose(of_mode, with_sign, **close)
    np.testing.assert_allclose(scale["variance_share"], 1.0, atol=0.005)


@pytest.mark.usefixtures("nothing_in_doubt")
def test_the_air_in_the_cabin_has_its_own_prior(mission):
    """N goes with p / T: 3 hPa and 1 K of the log's sensors, and no mode without a covariance."""
    first, second = mission.config["cameras"]
    del mission.config["cameras"][first]["window"]
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "its hatch was open"}]
    manifest = ran(mission)
    assert manifest["uncertainty"] is None
    (of_camera,) = manifest["cabin_air"].items()
    assert of_camera[0] == second
    stations = mission.stations().to_pandas().query("camera == @second and status == 'ok'")
    p = stations["cabin_pressure_pa"]
    t = stations["cabin_temperature_k"]
    relative = np.sqrt(np.mean((300.0 / p) ** 2 + (1.0 / t) ** 2))
    prior = of_camera[1]
    np.testing.assert_allclose(prior["n_cc"], (p / t).mean() * 7.88e-7, rtol=0.01)
    np.testing.assert_allclose(prior["sigma_n_cc"], relative * prior["n_cc"], rtol=0.01)
    table = good(mission).merge(mission.stations().to_pandas()[["image", "camera"]], on="image")
    behind = (table["camera"] == second).to_numpy()
    for axis in "xy":
        assert (table[f"d{axis}_dncc_px"].notna().to_numpy() == behind).all()
        assert table[f"d{axis}_ds_px"].isna().all()
        cabin = (table[f"d{axis}_dncc_px"] * prior["sigma_n_cc"]).abs()[behind]
        np.testing.assert_allclose(cabin, table[f"sigma_cabin_d{axis}_px"][behind], rtol=0.01)


def test_several_profiles_have_one_parameter(mission, monkeypatch):
    """Each moves along its own mode to the same side: here by its own uncertainty of pressure."""
    original = stages.adjusted_profiles
    second = np.arange(6) % 2

    def adjusted_profiles(*given):
        air = original(*given)
        (timed,) = air.series.timed_profiles
        loose = pressure_alone(timed.profile)
        tight = replace(loose, matrix=loose.matrix / 9.0)
        airs = tuple(replace(timed, own_covariance=one, neighbours=None) for one in (loose, tight))
        return replace(air, series=replace(air.series, timed_profiles=airs, profile_number=second))

    without_windows(mission)
    monkeypatch.setattr(stages, "adjusted_profiles", adjusted_profiles)
    scale = ran(mission)["uncertainty"]
    assert scale["profiles"] == 2
    rms = LN_P * np.sqrt((1.0 + 1.0 / 9.0) / 2.0)
    np.testing.assert_allclose(scale["scale_sigma"], rms, rtol=1e-3)
    np.testing.assert_allclose(scale["variance_share"], 1.0, atol=0.005)
    table = good(mission)
    names = mission.stations()["image"].to_pylist()
    own = pd.Series(np.where(second, LN_P / 3.0, LN_P), index=names)
    sigma = table["image"].map(own)
    assert sigma.nunique() == 2
    for axis in "xy":
        shift = table[f"{axis}_corrected_px"] - table[f"{axis}_px"]
        of_mode = table[f"d{axis}_ds_px"] * scale["scale_sigma"]
        np.testing.assert_allclose(of_mode, sigma * shift, rtol=5e-3)


def by_ray(mission):
    """Good rows with what belongs to their stations; without windows."""
    stations = mission.stations().to_pandas().drop(columns="status").set_index("image")
    return good(mission).join(stations, on="image")


def refractivity_at(mission, h):
    """N by the rows of profile.parquet: ln N is nearly linear between them."""
    profile = pq.read_table(mission.output / "profile.parquet").to_pandas()
    return np.exp(np.interp(h, profile["h_m"], np.log(profile["refractivity"])))


def shares(rows, kind) -> np.ndarray:
    """(2, n) sigmas of dx and dy over the shift itself; NaN where that is nearly across."""
    shift = np.stack([rows[f"{a}_corrected_px"] - rows[f"{a}_px"] for a in "xy"])
    sigma = np.stack([rows[f"sigma_{kind}_d{a}_px"] for a in "xy"])
    small = np.abs(shift) < 0.2 * np.hypot(*shift)
    return np.where(small, np.nan, sigma / np.abs(shift))


def assert_shares(found, expected, within) -> None:
    for share in found:
        known = np.isfinite(share)
        assert known.sum() > 20
        np.testing.assert_allclose(share[known], np.asarray(expected)[known], rtol=within)


@pytest.mark.usefixtures("nothing_in_doubt")
def test_the_ground_in_numbers(mission):
    """R = tan(zeta) (mean N - N_c) (Gyer 1996, Eq. 24): d mean / dh_g = (mean - N_g) / way."""
    without_windows(mission)
    mission.config["ground"]["sigma_m"] = 7.0
    ran(mission)
    rows = by_ray(mission)
    excess = rows["r_c_rad"] / np.tan(rows["zeta_c_rad"])
    mean = excess + refractivity_at(mission, rows["h_msl_m"])
    way = rows["h_msl_m"] - rows["h_g_m"]
    by_ground = (mean - refractivity_at(mission, rows["h_g_m"])) / way
    assert_shares(shares(rows, "ground"), 7.0 * (by_ground / excess).abs(), 0.02)


@pytest.mark.usefixtures("nothing_in_doubt", "steady_between_samples")
def test_the_height_of_the_station_in_numbers(mission):
    """d mean / dh_c = (N_c - mean) / way, less N_c', the slope of N in the layer."""
    without_windows(mission)
    with_tilt(mission, 0.0)
    ran(mission)
    rows = by_ray(mission)
    assert rows["sigma_height_m"].gt(0.0).all()
    below, above = (refractivity_at(mission, rows["h_msl_m"] + d) for d in (-0.5, 0.5))
    excess = rows["r_c_rad"] / np.tan(rows["zeta_c_rad"])
    way = rows["h_msl_m"] - rows["h_g_m"]
    by_height = -excess / way - (above - below)
    expected = rows["sigma_height_m"] * (by_height / excess).abs()
    assert_shares(shares(rows, "station"), expected, 0.02)


def pinhole_shift(u, v, rotation, k) -> np.ndarray:
    """(2, n) shift over the principal distance where R = k tan(zeta): the chord less the ray."""
    ray = np.stack([u, v, np.ones(u.size)], axis=1) @ rotation
    ray /= -ray[:, 2:]
    # tan(zeta) becomes tan(zeta - R), to first order.
    tan2 = ray[:, 0] ** 2 + ray[:, 1] ** 2
    chord = ray * np.stack([1.0 - k * (1.0 + tan2)] * 2 + [np.ones(u.size)], axis=1)
    x, y, z = (chord @ rotation.T).T
    return np.stack([x / z - u, y / z - v])


@pytest.mark.usefixtures("nothing_in_doubt")
def test_the_tilt_in_numbers(mission):
    """The camera turned about its three axes by a degree's part, in a pinhole written here."""
    without_windows(mission)
    with_tilt(mission, 0.25)
    for camera in mission.config["cameras"].values():
        del camera["distortion"]
    # Tie points know that the images have a distortion.
    mission.config["accept"].append({"code": "TIES-CALIBRATION", "reason": "a pinhole"})
    ran(mission)
    rows = by_ray(mission)
    k = (rows["r_c_rad"] / np.tan(rows["zeta_c_rad"])).to_numpy()
    found = []
    expected = []
    for image in rows["image"].unique():
        mine = (rows["image"] == image).to_numpy()
        one = rows[mine]
        camera = mission.config["cameras"][one["camera"].iloc[0]]
        u = ((one["x_px"] - camera["cx_px"]) / camera["fx_px"]).to_numpy()
        v = ((one["y_px"] - camera["cy_px"]) / camera["fy_px"]).to_numpy()
        q = one[["q_x", "q_y", "q_z", "q_w"]].iloc[0].to_numpy(float)
        rotation = Rotation.from_quat(q).as_matrix()
        variance = np.zeros((2, u.size))
        for axis in np.eye(3):
            turns = (Rotation.from_rotvec(s * np.radians(0.25) * axis) for s in (1.0, -1.0))
            one_way, other = (pinhole_shift(u, v, t.as_matrix() @ rotation, k[mine]) for t in turns)
            variance += (0.5 * (one_way - other)) ** 2
        expected.append(camera["fx_px"] * np.sqrt(variance))
        found.append(one[COLUMNS["station"]].to_numpy().T)
    expected = np.concatenate(expected, axis=1)
    found = np.concatenate(found, axis=1)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.01 * np.median(expected))


@pytest.mark.usefixtures("nothing_in_doubt")
def test_nobody_knows_anything(mission):
    manifest = ran(mission)
    table = mission.results()
    for name in ("sigma_r_c_rad", *COLUMNS["air"], *COLUMNS["station"], *COLUMNS["ground"]):
        known = name in COLUMNS["station"]  # the log tells how good its stations are
        assert (table[name].null_count < table.num_rows) == known
    assert manifest["uncertainty"] is None
    (what,) = unknown(manifest)
    for missing in ("covariance", "ground.sigma_m"):
        assert missing in what
    assert "attitude" not in what


@pytest.mark.usefixtures("nothing_in_doubt")
def test_yaw_of_a_level_aircraft_moves_nothing(mission):
    """Its axis is the aircraft's vertical, not the camera's axis, also where that looks aside."""
    for mount in mission.config["mount"].values():
        mount |= {"sigma_tilt_deg": 0.0, "sigma_yaw_deg": 3.0}
    ran(mission)
    table = good(mission)
    shift = np.hypot(
        table["x_corrected_px"] - table["x_px"], table["y_corrected_px"] - table["y_px"]
    )
    sigma = np.hypot(table["sigma_station_dx_px"], table["sigma_station_dy_px"])
    oblique = np.degrees(table["zeta_c_rad"]) > 30.0
    # The whole yaw would be 5 % of the shift, about the axis of the oblique camera some 4 %.
    assert float((sigma / shift)[oblique].median()) < 0.01


@pytest.mark.usefixtures("nothing_in_doubt")
def test_one_camera_and_a_column_of_sigmas(mission):
    """Each column is null where its own cause is unknown; a bad sigma is counted."""
    table = mission.measurements()
    sigma = np.full(table.num_rows, 3.0)
    sigma[:3] = np.nan, -1.0, np.inf
    mission.observe(table.append_column("sigma_h", [sigma]))
    mission.config["ground"]["sigma_column"] = "sigma_h"
    manifest = ran(mission)
    (what,) = unknown(manifest)
    assert "attitude" not in what
    assert "ground" not in what
    (bad,) = [e for e in manifest["ledger"] if e["code"] == "OBS-SIGMA"]
    assert bad["count"] == 2
    out = mission.results().to_pandas()
    ok = (out["status"] == "ok").to_numpy()
    assert (out["sigma_station_dx_px"].notna() == ok).all()
    assert out["sigma_ground_dx_px"][:3].isna().all()
    assert out["sigma_ground_dx_px"][3:][ok[3:]].notna().all()
    assert out["sigma_air_dx_px"].isna().all()
    np.testing.assert_array_equal(out["sigma_h"], sigma)


def test_a_column_that_is_not_there(mission):
    mission.config["ground"]["sigma_column"] = "sigma_h"
    ended = mission.run()
    assert ended.code == 6, ended.text
    assert "OBS-COLUMN" in ended.text
    assert "ground.sigma_column" in ended.text


@pytest.mark.usefixtures("pressure_in_doubt")
def test_displaced_observations_have_them_too(mission):
    with_tilt(mission)
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]
    manifest = ran(mission)
    table = good(mission)
    np.testing.assert_allclose(table["sigma_r_c_rad"], LN_P * table["r_c_rad"], rtol=2e-3)
    assert (table["sigma_station_dx_px"] > 0.0).all()
    assert LN_P < manifest["uncertainty"]["scale_sigma"] < 3.0 * LN_P


@pytest.mark.usefixtures("pressure_in_doubt")
def test_displaced_observations_move_with_the_air(mission):
    """More air displaces more, to the other side than it corrects."""
    without_windows(mission)
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"].append({"code": "PLAUSIBLE-APPLY", "reason": "there and back"})
    ran(mission)
    table = good(mission)
    for axis in "xy":
        shift = table[f"{axis}_displaced_px"] - table[f"{axis}_px"]
        np.testing.assert_allclose(table[f"d{axis}_ds_px"], shift, rtol=5e-3, atol=1e-4)


@pytest.mark.usefixtures("steady_between_samples")
def test_the_sigmas_of_each_mount_in_radians(mission):
    first, second = list(mission.config["cameras"])[:2]
    mission.config["mount"][first] |= {"sigma_tilt_deg": 0.5, "sigma_yaw_deg": 2.0}
    mission.config["mount"][second] |= {"sigma_tilt_deg": 0.25}
    prepared = read_mission(mission.save())
    at = prepared.stations
    camera = prepared.stations.camera
    sigmas = station_sigmas(prepared.mission, at)
    assert sigmas.tilt_rad[camera == first] == pytest.approx(0.008726646259971648)
    assert sigmas.yaw_rad[camera == first] == pytest.approx(0.03490658503988659)
    # By default the yaw is as uncertain as the tilt; heights are those of the log.
    assert sigmas.yaw_rad[camera == second] == pytest.approx(0.004363323129985824)
    np.testing.assert_array_equal(sigmas.height_m, at.sigma_height_m)
    del mission.config["mount"][first]["sigma_yaw_deg"]
    del mission.config["mount"][first]["sigma_tilt_deg"]
    prepared = read_mission(mission.save())
    sigmas = station_sigmas(prepared.mission, prepared.stations)
    ok = prepared.stations.ok & (camera == first)
    # Without innovations of a filter 0.1 and 0.22 deg, and of yaw 0.36 deg and what a compass shows
    # of the tilt: times 2 tan(latitude), the dip of a dipole along the earth's axis.
    dip = 2.0 * np.tan(prepared.stations.lat_rad[ok])
    assert np.degrees(sigmas.tilt_rad[ok]) == pytest.approx(0.24166, abs=1e-5)
    np.testing.assert_allclose(
        np.degrees(sigmas.yaw_rad[ok]), np.hypot(0.36, 0.24166 * dip), atol=1e-4
    )
    # stations that know nothing of their attitude have the mount's sigmas
    unknown_tilt = replace(at, sigma_tilt_rad=np.full(len(at), np.nan))
    sigmas = station_sigmas(prepared.mission, unknown_tilt)
    assert np.isnan(sigmas.tilt_rad[camera == first]).all()
    assert sigmas.tilt_rad[camera == second] == pytest.approx(0.004363323129985824)
