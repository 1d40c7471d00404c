"""Standard deviations from the mission file to the results, and what is said where there are none.

The covariance here is that of the pressure alone: R goes with pressure, so its relative error is
that of the pressure, whatever the ray. What a window makes of it is seen in corrections in air that
has that much more and less of it.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers import refused, with_code
from tests.stages.block_files import CABIN
from tests.stages.corrected_rows import corrected
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.batch.runs import read_mission
from unbend.flight.stations import STATION_OK, empty_stations
from unbend.refraction.uncertainty.sigmas import FOLLOWING, OPEN, SCHEDULED, SEALED
from unbend.stages.uncertainty import has_any_sigma, kinds_of_windows, station_sigmas

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
        (None, {"cabin": CABIN} | SIDEWAYS, "corrected"),
    ],
    ids=["logged, and a schedule", "displaced", "none, and leaning"],
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


def test_the_sigma_of_the_ground_against_points_that_are_higher_and_lower(mission):
    mission.config["ground"]["sigma_m"] = 7.0
    prepared = in_unknown_air(mission)
    rows = corrected(prepared).rows()
    moved = {}
    for by_m in (7.0, -7.0):
        table = mission.measurements()
        column = table.schema.get_field_index("h_g_m")
        height_m = table["h_g_m"].to_numpy() + by_m
        mission.observe(table.set_column(column, "h_g_m", [height_m]), f"{by_m}.parquet")
        moved[by_m] = corrected(in_unknown_air(mission)).rows()
    for axis in "xy":
        half = (shift(moved[7.0], axis) - shift(moved[-7.0], axis)).abs() / 2.0
        sigma = rows[f"sigma_ground_d{axis}_px"]
        np.testing.assert_allclose(sigma, half, rtol=0.02, atol=0.01 * half.median())


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
    # The yaw turns about the vertical of the aircraft, to the left of the oblique camera's axis.
    leaning = np.sqrt(0.5)
    vertical = np.where(nadir[:, None], [0.0, 0.0, 1.0], [-leaning, 0.0, leaning])
    np.testing.assert_allclose(sigmas.yaw_axis, vertical, atol=1e-12)


PLANE = SimpleNamespace(shape="plane", cabin=SimpleNamespace(source="log"), is_opening=False)


def cabin_by(source: str) -> SimpleNamespace:
    return SimpleNamespace(**vars(PLANE) | {"cabin": SimpleNamespace(source=source)})


@pytest.mark.parametrize(
    ("window", "kinds"),
    [
        (PLANE, [SEALED, SEALED]),
        (cabin_by("ambient"), [SCHEDULED, SCHEDULED]),
        (cabin_by("standard_schedule"), [SCHEDULED, SEALED]),
        (SimpleNamespace(**vars(PLANE) | {"is_opening": True}), [FOLLOWING, FOLLOWING]),
        (SimpleNamespace(**vars(PLANE) | {"shape": "spherical"}), [OPEN, OPEN]),
        (SimpleNamespace(**vars(PLANE) | {"cabin": None}), [OPEN, OPEN]),
    ],
    ids=["sealed", "ambient", "schedule", "opening", "dome", "no cabin"],
)
def test_the_kind_of_a_window_at_850_and_at_600_hectopascal(window, kinds):
    """The camera without a window has the kind of none."""
    camera = np.array(["nadir", "nadir", "wing"], object)
    stations = empty_stations(camera, camera, STATION_OK)
    air = SimpleNamespace(pressure=lambda height_m: np.array([85e3, 60e3, 85e3]))
    mission = SimpleNamespace(windows={"nadir": window})
    assert kinds_of_windows(mission, stations, air).tolist() == [*kinds, OPEN]


@pytest.mark.parametrize(
    ("changed", "is_known"),
    [
        ({}, False),
        ({"tilt_rad": [0.001, np.nan]}, True),
        ({"tilt_rad": [np.nan, 0.001]}, False),  # of a station that is not ok
        ({"sigma_m": 5.0}, True),
        ({"sigma_column": "sigma_h"}, True),
        ({"cabin": [[np.nan, 1.0]]}, True),
        ({"kinds": [OPEN, SEALED]}, True),
    ],
)
def test_one_sigma_is_enough_to_compute_with(changed, is_known):
    nothing = {"tilt_rad": [np.nan, np.nan], "sigma_m": None, "sigma_column": None}
    nothing |= {"cabin": [[np.nan, np.nan]], "kinds": [OPEN, OPEN]}
    known = SimpleNamespace(**nothing | changed)
    stations = SimpleNamespace(ok=np.array([True, False]))
    mission = SimpleNamespace(ground=known)
    sigmas = SimpleNamespace(tilt_rad=np.array(known.tilt_rad), cabin=np.array(known.cabin))
    assert has_any_sigma(mission, stations, sigmas, np.array(known.kinds)) == is_known


def test_stations_that_know_nothing_of_their_attitude_have_the_sigmas_of_the_mount(mission):
    mission.config["mount"]["oblique"]["sigma_tilt_deg"] = 0.25
    prepared = read_mission(mission.save())
    unknown = np.full(len(prepared.stations), np.nan)
    stations = replace(prepared.stations, sigma_tilt_rad=unknown)
    tilt_rad = station_sigmas(prepared.mission, stations).tilt_rad
    nadir = stations.camera == "nadir"
    assert np.isnan(tilt_rad[nadir]).all()
    assert tilt_rad[~nadir] == pytest.approx(0.004363323129985824)
