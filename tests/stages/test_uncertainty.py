"""Standard deviations from the mission file to the results, and what is said where there are none.

The covariance here is that of the pressure alone: R goes with pressure, so its relative error is
that of the pressure, whatever the ray. What a window makes of it is seen in corrections in air that
has that much more and less of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers import refused, with_code
from tests.stages.block_files import CABIN
from tests.stages.corrected_rows import corrected
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.batch.runs import read_mission
from unbend.stages.uncertainty import station_sigmas

LN_P = 0.004
AIR = ["sigma_air_dx_px", "sigma_air_dy_px"]
STATION = ["sigma_station_dx_px", "sigma_station_dy_px"]
GROUND = ["sigma_ground_dx_px", "sigma_ground_dy_px"]
SIDEWAYS = {"frame": "body", "normal": [0.0, 0.5735764, 0.8191520]}


def pressure_alone(profile, ln_p=LN_P) -> ProfileCovariance:
    size = profile.layers.edge.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[size, size] = ln_p**2
    return ProfileCovariance(profile, 1000.0, matrix)


def with_series(prepared, **changed):
    """The mission in other air."""
    series = replace(prepared.air.series, **changed)
    return replace(prepared, air=replace(prepared.air, series=series))


def with_air(prepared, **changed):
    """The mission whose only profile of the air is changed."""
    (timed,) = prepared.air.series.timed_profiles
    return with_series(prepared, timed_profiles=(replace(timed, **changed),))


def in_doubtful_air(mission):
    """The pressure is known to 0.4 %, and nothing else of the air is in doubt."""
    prepared = read_mission(mission.save())
    covariance = pressure_alone(prepared.air.adjustment.profile)
    return with_air(prepared, own_covariance=covariance, neighbours=None)


def in_unknown_air(mission):
    """Nobody knows how good the air is."""
    return with_air(read_mission(mission.save()), own_covariance=None, neighbours=None)


def without_windows(mission) -> None:
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "the hatch was open"}]
    for camera in mission.config["cameras"].values():
        del camera["window"]


def with_mounts(mission, **sigmas) -> None:
    for mount in mission.config["mount"].values():
        mount |= sigmas


def apply_refraction(mission) -> None:
    mission.config["refraction"] = {"direction": "apply"}
    accepted = {"code": "PLAUSIBLE-APPLY", "reason": "there and back"}
    mission.config.setdefault("accept", []).append(accepted)


def unknown_sigmas(done) -> list[str]:
    return [message.what for message in with_code(done.prepared.ledger, "SIGMA-UNKNOWN")]


def shift(rows, axis, moved="corrected"):
    return rows[f"{axis}_{moved}_px"] - rows[f"{axis}_px"]


def test_sigmas_of_air_station_and_ground(mission):
    with_mounts(mission, sigma_tilt_deg=0.2)
    mission.config["ground"]["sigma_m"] = 5.0
    done = corrected(in_doubtful_air(mission))
    rows = done.rows()
    sigmas = rows[AIR + STATION + GROUND].to_numpy()
    assert np.isfinite(sigmas).all()
    assert (sigmas > 0.0).all()
    np.testing.assert_allclose(rows["sigma_r_c_rad"], LN_P * rows["r_c_rad"], rtol=2e-3)
    scale = done.record["uncertainty"]
    assert scale["profiles"] == 1
    assert "also behind a plane window" in scale["meaning"]
    assert not unknown_sigmas(done)
    meaning = done.table.schema.field("sigma_air_dx_px").metadata[b"meaning"]
    assert b"never add it to the weights" in meaning


def test_the_shift_is_scaled_by_the_air(mission):
    """Without a window the whole shift is refraction, and the air scales it in x and y alike."""
    without_windows(mission)
    done = corrected(in_doubtful_air(mission))
    scale = done.record["uncertainty"]
    np.testing.assert_allclose(scale["scale_sigma"], LN_P, rtol=1e-3)
    np.testing.assert_allclose(scale["variance_share"], 1.0, rtol=1e-3)
    rows = done.rows()
    for axis in "xy":
        signed = shift(rows, axis)
        sigma = rows[f"sigma_air_d{axis}_px"]
        np.testing.assert_allclose(sigma, LN_P * signed.abs(), rtol=5e-3)
        np.testing.assert_allclose(rows[f"d{axis}_ds_px"], signed, rtol=5e-3)
        assert rows[f"d{axis}_dncc_px"].isna().all()


@pytest.mark.parametrize(
    ("nadir", "oblique", "moved"),
    [
        ({"cabin": "log"}, {"cabin": "standard_schedule"}, "corrected"),
        ({"cabin": "log"}, {"cabin": "standard_schedule"}, "displaced"),
        ({"cabin": CABIN}, {"cabin": CABIN} | SIDEWAYS, "corrected"),
        (None, {"cabin": "log"}, "corrected"),
        ({"cabin": {"pressure": "ambient"}}, {"cabin": {"pressure": "ambient"}}, "corrected"),
    ],
    ids=["schedule", "displaced", "constant, and leaning", "none, and logged", "ambient"],
)
def test_behind_a_window_against_rows_in_other_air(mission, nadir, oblique, moved):
    """0.4 % of pressure more and less, in the whole program: the sigma is half the difference."""
    mission.config["accept"] = [{"code": "CABIN-IMPLAUSIBLE", "reason": "it is open for the test"}]
    mission.config["cameras"]["nadir"]["window"] = nadir
    mission.config["cameras"]["oblique"]["window"] = oblique
    if moved == "displaced":
        apply_refraction(mission)
    prepared = read_mission(mission.save())
    profile = prepared.air.adjustment.profile

    def rows_at(ln_p: float):
        pressure = profile.pressure(0.0) * np.exp(ln_p)
        return corrected(with_air(prepared, profile=profile.at_level(0.0, pressure))).rows()

    denser = rows_at(LN_P)
    thinner = rows_at(-LN_P)
    done = corrected(in_doubtful_air(mission))
    rows = done.rows()
    scale = done.record["uncertainty"]
    for axis in "xy":
        signed = (shift(denser, axis, moved) - shift(thinner, axis, moved)) / 2.0
        sigma = signed.abs()
        close = {"rtol": 0.01, "atol": 0.003 * np.median(sigma)}
        np.testing.assert_allclose(rows[f"sigma_air_d{axis}_px"], sigma, **close)
        # Of one uncertain quantity the leading mode is all.
        of_mode = rows[f"d{axis}_ds_px"] * scale["scale_sigma"]
        np.testing.assert_allclose(of_mode, signed, **close)
    np.testing.assert_allclose(scale["variance_share"], 1.0, atol=0.005)


def test_the_air_in_the_cabin_has_its_own_prior(mission):
    """N goes with p / T: 3 hPa and 1 K of the log's sensors, and no mode without a covariance."""
    del mission.config["cameras"]["nadir"]["window"]
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "its hatch was open"}]
    done = corrected(in_unknown_air(mission))
    assert done.record["uncertainty"] is None
    assert list(done.record["cabin_air"]) == ["oblique"]
    prior = done.record["cabin_air"]["oblique"]
    stations = done.stations().query("camera == 'oblique' and status == 'ok'")
    p = stations["cabin_pressure_pa"]
    t = stations["cabin_temperature_k"]
    relative = np.sqrt(np.mean((300.0 / p) ** 2 + (1.0 / t) ** 2))
    np.testing.assert_allclose(prior["n_cc"], (p / t).mean() * 7.88e-7, rtol=0.01)
    np.testing.assert_allclose(prior["sigma_n_cc"], relative * prior["n_cc"], rtol=0.01)
    rows = done.rows()
    behind = rows["camera"] == "oblique"
    for axis in "xy":
        by_cabin = rows[f"d{axis}_dncc_px"]
        assert (by_cabin.notna() == behind).all()
        assert rows[f"d{axis}_ds_px"].isna().all()
        sigma = (by_cabin * prior["sigma_n_cc"]).abs()
        of_cabin = rows[f"sigma_cabin_d{axis}_px"]
        np.testing.assert_allclose(sigma[behind], of_cabin[behind], rtol=0.01)


def test_several_profiles_have_one_parameter(mission):
    """Each moves along its own mode to the same side: here by its own uncertainty of pressure."""
    without_windows(mission)
    prepared = in_doubtful_air(mission)
    (loose,) = prepared.air.series.timed_profiles
    tight = replace(loose, own_covariance=pressure_alone(loose.profile, LN_P / 3.0))
    number = np.arange(len(prepared.stations)) % 2
    done = corrected(with_series(prepared, timed_profiles=(loose, tight), profile_number=number))
    scale = done.record["uncertainty"]
    assert scale["profiles"] == 2
    rms = LN_P * np.sqrt((1.0 + 1.0 / 9.0) / 2.0)
    np.testing.assert_allclose(scale["scale_sigma"], rms, rtol=1e-3)
    np.testing.assert_allclose(scale["variance_share"], 1.0, atol=0.005)
    rows = done.rows()
    number_of_image = dict(zip(done.stations()["image"], number, strict=True))
    sigma = rows["image"].map(number_of_image).map({0: LN_P, 1: LN_P / 3.0})
    assert sigma.nunique() == 2
    for axis in "xy":
        of_mode = rows[f"d{axis}_ds_px"] * scale["scale_sigma"]
        np.testing.assert_allclose(of_mode, sigma * shift(rows, axis), rtol=5e-3)


def assert_shares(rows, kind, expected) -> None:
    """Sigmas of dx and dy over the shift itself, except where that is nearly across."""
    size = np.hypot(shift(rows, "x"), shift(rows, "y"))
    for axis in "xy":
        along = shift(rows, axis).abs()
        large = along >= 0.2 * size
        assert large.sum() > 20
        share = rows[f"sigma_{kind}_d{axis}_px"] / along
        np.testing.assert_allclose(share[large], expected[large], rtol=0.02)


def test_the_ground_in_numbers(mission):
    """R = tan(zeta) (mean N - N_c) (Gyer 1996, Eq. 24): d mean / dh_g = (mean - N_g) / way."""
    without_windows(mission)
    mission.config["ground"]["sigma_m"] = 7.0
    prepared = in_unknown_air(mission)
    refractivity = prepared.air.adjustment.profile.refractivity
    rows = corrected(prepared).rows()
    excess = rows["r_c_rad"] / np.tan(rows["zeta_c_rad"])
    mean = excess + refractivity(rows["h_msl_m"].to_numpy())
    way = rows["h_msl_m"] - rows["h_g_m"]
    by_ground = (mean - refractivity(rows["h_g_m"].to_numpy())) / way
    assert_shares(rows, "ground", 7.0 * (by_ground / excess).abs())


def test_the_height_of_the_station_in_numbers(mission):
    """d mean / dh_c = (N_c - mean) / way, less N_c', the slope of N in the layer."""
    without_windows(mission)
    prepared = in_unknown_air(mission)
    no_sigma = np.zeros(len(prepared.stations))
    stations = replace(prepared.stations, sigma_tilt_rad=no_sigma, sigma_yaw_rad=no_sigma)
    rows = corrected(replace(prepared, stations=stations)).rows()
    assert rows["sigma_height_m"].gt(0.0).all()
    refractivity = prepared.air.adjustment.profile.refractivity
    height = rows["h_msl_m"].to_numpy()
    slope = refractivity(height + 0.5) - refractivity(height - 0.5)
    excess = rows["r_c_rad"] / np.tan(rows["zeta_c_rad"])
    by_height = -excess / (rows["h_msl_m"] - rows["h_g_m"]) - slope
    assert_shares(rows, "station", rows["sigma_height_m"] * (by_height / excess).abs())


def pinhole_shift(u, v, rotation, k) -> np.ndarray:
    """(2, n) shift over the principal distance where R = k tan(zeta): the chord less the ray."""
    ray = np.stack([u, v, np.ones(u.size)], axis=1) @ rotation
    ray /= -ray[:, 2:]
    # tan(zeta) becomes tan(zeta - R), to first order.
    tan2 = ray[:, 0] ** 2 + ray[:, 1] ** 2
    chord = ray.copy()
    chord[:, :2] *= (1.0 - k * (1.0 + tan2))[:, None]
    x, y, z = (chord @ rotation.T).T
    return np.stack([x / z - u, y / z - v])


def test_the_tilt_in_numbers(mission):
    """The camera turned about its three axes by a degree's part, in a pinhole written here."""
    without_windows(mission)
    with_mounts(mission, sigma_tilt_deg=0.25)
    cameras = mission.config["cameras"]
    for camera in cameras.values():
        del camera["distortion"]
    # Tie points know that the images have a distortion.
    mission.config["accept"].append({"code": "TIES-CALIBRATION", "reason": "a pinhole"})
    rows = corrected(in_unknown_air(mission)).rows()
    sigmas = []
    expected = []
    for _, of_image in rows.groupby("image"):
        first = of_image.iloc[0]
        camera = cameras[first["camera"]]
        u = ((of_image["x_px"] - camera["cx_px"]) / camera["fx_px"]).to_numpy()
        v = ((of_image["y_px"] - camera["cy_px"]) / camera["fy_px"]).to_numpy()
        k = (of_image["r_c_rad"] / np.tan(of_image["zeta_c_rad"])).to_numpy()
        rotation = Rotation.from_quat(first[["q_x", "q_y", "q_z", "q_w"]].to_numpy(float))
        variance = np.zeros((2, u.size))
        for axis in np.eye(3):
            turn = Rotation.from_rotvec(0.25 * axis, degrees=True)
            forth = pinhole_shift(u, v, (turn * rotation).as_matrix(), k)
            back = pinhole_shift(u, v, (turn.inv() * rotation).as_matrix(), k)
            variance += (0.5 * (forth - back)) ** 2
        expected.append(camera["fx_px"] * np.sqrt(variance.T))
        sigmas.append(of_image[STATION].to_numpy())
    wanted = np.concatenate(expected)
    atol = 0.01 * np.median(wanted)
    np.testing.assert_allclose(np.concatenate(sigmas), wanted, rtol=0.02, atol=atol)


def test_nobody_knows_anything(mission):
    """Only the log tells how good its stations are."""
    done = corrected(in_unknown_air(mission))
    rows = done.rows()
    assert rows[["sigma_r_c_rad", *AIR, *GROUND]].isna().all(axis=None)
    assert rows[STATION].notna().any(axis=None)
    assert done.record["uncertainty"] is None
    (text,) = unknown_sigmas(done)
    assert "covariance" in text
    assert "ground.sigma_m" in text
    assert "attitude" not in text


def test_yaw_of_a_level_aircraft_moves_nothing(mission):
    """Its axis is the aircraft's vertical, not the camera's axis, also where that looks aside."""
    with_mounts(mission, sigma_tilt_deg=0.0, sigma_yaw_deg=3.0)
    rows = corrected(in_unknown_air(mission)).rows()
    size = np.hypot(shift(rows, "x"), shift(rows, "y"))
    share = np.linalg.norm(rows[STATION], axis=1) / size
    oblique = np.degrees(rows["zeta_c_rad"]) > 30.0
    # The whole yaw would be 5 % of the shift, about the axis of the oblique camera some 4 %.
    assert share[oblique].median() < 0.01


def test_a_column_of_sigmas_of_which_some_are_no_sigmas(mission):
    """Each column is null where its own cause is unknown; a bad sigma is counted."""
    table = mission.measurements()
    sigma = np.full(table.num_rows, 3.0)
    sigma[:3] = np.nan, -1.0, np.inf
    mission.observe(table.append_column("sigma_h", [sigma]))
    mission.config["ground"]["sigma_column"] = "sigma_h"
    done = corrected(in_unknown_air(mission))
    (text,) = unknown_sigmas(done)
    assert "attitude" not in text
    assert "ground" not in text
    (bad,) = with_code(done.prepared.ledger, "OBS-SIGMA")
    assert bad.count == 2
    rows = done.table.to_pandas()
    assert (rows["status"] == "ok").all()
    assert rows["sigma_station_dx_px"].notna().all()
    assert rows["sigma_ground_dx_px"].isna().tolist() == [True] * 3 + [False] * (len(rows) - 3)
    assert rows["sigma_air_dx_px"].isna().all()
    np.testing.assert_array_equal(rows["sigma_h"], sigma)


def test_a_column_that_is_not_there(mission):
    mission.config["ground"]["sigma_column"] = "sigma_h"
    with refused("OBS-COLUMN") as refusal:
        read_mission(mission.save())
    assert "ground.sigma_column" in str(refusal.value)


def test_displaced_observations_move_with_the_air(mission):
    """More air displaces more, to the other side than it corrects."""
    without_windows(mission)
    with_mounts(mission, sigma_tilt_deg=0.2)
    apply_refraction(mission)
    rows = corrected(in_doubtful_air(mission)).rows()
    np.testing.assert_allclose(rows["sigma_r_c_rad"], LN_P * rows["r_c_rad"], rtol=2e-3)
    assert (rows["sigma_station_dx_px"] > 0.0).all()
    for axis in "xy":
        displaced = shift(rows, axis, "displaced")
        np.testing.assert_allclose(rows[f"d{axis}_ds_px"], displaced, rtol=5e-3, atol=1e-4)


def sigmas_of(mission):
    """The sigmas of the stations, and which of these are the nadir camera's."""
    prepared = read_mission(mission.save())
    sigmas = station_sigmas(prepared.mission, prepared.stations)
    return sigmas, prepared, prepared.stations.camera == "nadir"


def part_of(whole, others) -> np.ndarray:
    """The part of a sigma that is independent of the others [deg]."""
    return np.degrees(np.sqrt(whole**2 - others**2))


def test_the_sigmas_of_each_mount_are_in_radians(mission):
    """Beside what the attitude between two samples of the log adds."""
    with_mounts(mission, sigma_tilt_deg=0.0, sigma_yaw_deg=0.0)
    between, _, nadir = sigmas_of(mission)
    mission.config["mount"]["nadir"] |= {"sigma_tilt_deg": 0.5, "sigma_yaw_deg": 2.0}
    del mission.config["mount"]["oblique"]["sigma_yaw_deg"]
    mission.config["mount"]["oblique"]["sigma_tilt_deg"] = 0.25
    sigmas, prepared, _ = sigmas_of(mission)
    tilt = part_of(sigmas.tilt_rad, between.tilt_rad)
    yaw = part_of(sigmas.yaw_rad, between.yaw_rad)
    assert tilt[nadir] == pytest.approx(0.5)
    assert yaw[nadir] == pytest.approx(2.0)
    # By default the yaw is as uncertain as the tilt; heights are those of the log.
    assert yaw[~nadir] == pytest.approx(0.25)
    np.testing.assert_array_equal(sigmas.height_m, prepared.stations.sigma_height_m)


def test_stations_that_know_nothing_of_their_attitude_have_the_sigmas_of_the_mount(mission):
    mission.config["mount"]["oblique"]["sigma_tilt_deg"] = 0.25
    prepared = read_mission(mission.save())
    unknown = np.full(len(prepared.stations), np.nan)
    stations = replace(prepared.stations, sigma_tilt_rad=unknown)
    tilt_rad = station_sigmas(prepared.mission, stations).tilt_rad
    nadir = stations.camera == "nadir"
    assert np.isnan(tilt_rad[nadir]).all()
    assert tilt_rad[~nadir] == pytest.approx(0.004363323129985824)
