"""Standard deviations from the mission file to the results, and what is said where there are none.

The covariance here is that of the pressure alone: R goes with pressure, so its relative error is
that of the pressure, whatever the ray. What a window makes of it is seen in corrections in air that
has that much more and less of it.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import refused, with_code
from tests.stages.block_files import CABIN
from tests.stages.corrected_rows import corrected, pressure_alone, shift
from tests.stages.other_logs import read_folder
from unbend.flight.stations import STATION_OK, empty_stations
from unbend.refraction.uncertainty.sigmas import (
    FOLLOWING,
    OPEN,
    SCHEDULED,
    SEALED,
)
from unbend.refraction.window import Cabin, Window
from unbend.stages.uncertainty import has_any_sigma, kinds_of_windows, station_sigmas

LN_P = 0.004
AIR = ["sigma_air_dx_px", "sigma_air_dy_px"]
STATION = ["sigma_station_dx_px", "sigma_station_dy_px"]
GROUND = ["sigma_ground_dx_px", "sigma_ground_dy_px"]
CABIN_AIR = ["sigma_cabin_dx_px", "sigma_cabin_dy_px"]
BY_SCALE = ["dx_ds_px", "dy_ds_px"]
BY_CABIN = ["dx_dncc_px", "dy_dncc_px"]


def with_series(prepared, **changed):
    """The mission in other air."""
    series = replace(prepared.air.series, **changed)
    air = replace(prepared.air, series=series)
    return replace(prepared, air=air)


def with_air(prepared, **changed):
    """The mission whose only profile of the air is changed."""
    (timed,) = prepared.air.series.timed_profiles
    other = replace(timed, **changed)
    return with_series(prepared, timed_profiles=(other,))


def in_doubtful_air(mission):
    """The pressure is known to 0.4 %, and nothing else of the air is in doubt."""
    prepared = read_folder(mission)
    covariance = pressure_alone(prepared.air.adjustment.profile, LN_P)
    return with_air(prepared, own_covariance=covariance, neighbours=None)


def in_unknown_air(mission):
    """The mission corrected in air of which nobody knows how good it is."""
    prepared = read_folder(mission)
    unknown = with_air(prepared, own_covariance=None, neighbours=None)
    return corrected(unknown)


def accept(mission, code):
    acceptance = {"code": code, "reason": "for the test"}
    mission.config.setdefault("accept", []).append(acceptance)


def without_windows(mission, *cameras):
    accept(mission, "PLAUSIBLE-WINDOW")
    for camera in cameras or ("nadir", "oblique"):
        del mission.config["cameras"][camera]["window"]


def with_mounts(mission, **sigmas):
    for mount in mission.config["mount"].values():
        mount |= sigmas


def unknown_sigmas(done):
    messages = with_code(done.prepared.ledger, "SIGMA-UNKNOWN")
    return [message.what for message in messages]


def assert_near(values, expected, *, rtol, share):
    """Each value is near the expected one, or differs by a share of the median of its column."""
    size = np.abs(expected)
    tolerance = rtol * size + share * np.median(size, axis=0)
    assert (np.abs(values - expected) <= tolerance).all(axis=None)


def is_null(columns):
    return columns.isna().all(axis=None)


# ---- the air, behind windows and without


def test_sigmas_of_air_station_and_ground(mission):
    with_mounts(mission, sigma_tilt_deg=0.2)
    mission.config["ground"]["sigma_m"] = 5.0

    done = corrected(in_doubtful_air(mission))

    rows = done.rows()
    sigmas = rows[AIR + STATION + GROUND].to_numpy()
    assert np.isfinite(sigmas).all()
    assert (sigmas > 0.0).all()
    sigma_r_c = LN_P * rows["r_c_rad"]
    assert_allclose(rows["sigma_r_c_rad"], sigma_r_c, rtol=2e-3)
    scale = done.record["uncertainty"]
    assert scale["profiles"] == 1
    assert "also behind a plane window" in scale["meaning"]
    assert not unknown_sigmas(done)
    field = done.table.schema.field("sigma_air_dx_px")
    assert b"never add it to the weights" in field.metadata[b"meaning"]


LOGGED = {"cabin": "log"}
SCHEDULE = {"cabin": "standard_schedule"}
LEANING = {
    "cabin": CABIN,
    "frame": "body",
    "normal": [0.0, 0.5735764, 0.8191520],
}


@pytest.mark.parametrize(
    ("nadir", "oblique", "moved"),
    [
        (LOGGED, SCHEDULE, "corrected"),
        (LOGGED, SCHEDULE, "displaced"),
        (None, LEANING, "corrected"),
    ],
    ids=[
        "logged, and a schedule",
        "displaced",
        "none, and leaning",
    ],
)
def test_behind_a_window_against_rows_in_other_air(mission, nadir, oblique, moved):
    """0.4 % of pressure more and less, in the whole program: the sigma is half the difference."""
    accept(mission, "CABIN-IMPLAUSIBLE")
    mission.config["cameras"]["nadir"]["window"] = nadir
    mission.config["cameras"]["oblique"]["window"] = oblique
    if moved == "displaced":
        mission.config["refraction"] = {"direction": "apply"}
        accept(mission, "PLAUSIBLE-APPLY")
    with_mounts(mission, sigma_tilt_deg=0.2)
    prepared = read_folder(mission)
    profile = prepared.air.adjustment.profile

    def shift_at(ln_p):
        pressure = profile.pressure(0.0) * np.exp(ln_p)
        air = profile.at_level(0.0, pressure)
        done = corrected(with_air(prepared, profile=air))
        return shift(done.rows(), moved)

    denser = shift_at(LN_P)
    thinner = shift_at(-LN_P)
    change = (denser - thinner) / 2.0
    done = corrected(in_doubtful_air(mission))

    rows = done.rows()
    assert_near(rows[AIR], np.abs(change), rtol=0.01, share=0.003)
    assert_allclose(rows["sigma_r_c_rad"], LN_P * rows["r_c_rad"], rtol=2e-3)
    assert (rows[STATION] > 0.0).all(axis=None)
    # Of one uncertain quantity the leading mode is all.
    scale = done.record["uncertainty"]
    of_mode = rows[BY_SCALE] * scale["scale_sigma"]
    assert_near(of_mode, change, rtol=0.01, share=0.003)
    assert_allclose(scale["variance_share"], 1.0, atol=0.005)


def test_the_air_in_the_cabin_has_its_own_prior(mission):
    """N goes with p / T: 3 hPa and 1 K of the log's sensors, and no mode without a covariance."""
    without_windows(mission, "nadir")

    done = in_unknown_air(mission)

    assert done.record["uncertainty"] is None
    assert list(done.record["cabin_air"]) == ["oblique"]
    prior = done.record["cabin_air"]["oblique"]
    stations = done.stations().query("camera == 'oblique' and status == 'ok'")
    p = stations["cabin_pressure_pa"]
    t = stations["cabin_temperature_k"]
    n_cc = (p / t).mean() * 7.88e-7
    relative = np.sqrt(np.mean((300.0 / p) ** 2 + (1.0 / t) ** 2))
    sigma_n_cc = relative * prior["n_cc"]
    assert_allclose(prior["n_cc"], n_cc, rtol=0.01)
    assert_allclose(prior["sigma_n_cc"], sigma_n_cc, rtol=0.01)
    rows = done.rows()
    is_behind = rows["camera"] == "oblique"
    behind = rows[is_behind]
    assert behind[BY_CABIN].notna().all(axis=None)
    assert is_null(rows[~is_behind][BY_CABIN])
    assert is_null(rows[BY_SCALE])
    sigma = np.abs(behind[BY_CABIN] * prior["sigma_n_cc"])
    assert_allclose(sigma, behind[CABIN_AIR], rtol=0.01)


def test_several_profiles_have_one_parameter(mission):
    """Each moves along its own mode to the same side: here by its own uncertainty of pressure."""
    without_windows(mission)
    prepared = in_doubtful_air(mission)
    (loose,) = prepared.air.series.timed_profiles
    covariance = pressure_alone(loose.profile, LN_P / 3.0)
    tight = replace(loose, own_covariance=covariance)
    number = np.arange(len(prepared.stations)) % 2
    in_two_airs = with_series(
        prepared,
        timed_profiles=(loose, tight),
        profile_number=number,
    )

    done = corrected(in_two_airs)

    scale = done.record["uncertainty"]
    assert scale["profiles"] == 2
    rms = LN_P * np.sqrt((1.0 + 1.0 / 9.0) / 2.0)
    assert_allclose(scale["scale_sigma"], rms, rtol=1e-3)
    assert_allclose(scale["variance_share"], 1.0, rtol=1e-3)
    rows = done.rows()
    images_of_tight = done.stations()["image"][number == 1]
    is_tight = rows["image"].isin(images_of_tight)
    assert is_tight.nunique() == 2
    sigma = np.where(is_tight, LN_P / 3.0, LN_P)
    of_mode = rows[BY_SCALE] * scale["scale_sigma"]
    # Without a window the whole shift is refraction, and the air scales it in x and y alike.
    expected = shift(rows) * sigma[:, None]
    assert_allclose(of_mode, expected, rtol=5e-3)
    assert_allclose(rows[AIR], np.abs(expected), rtol=5e-3)
    assert is_null(rows[BY_CABIN])
    assert set(rows["r_cc_rad"]) == {0.0}


# ---- the ground, and sigmas that are missing


def test_the_sigma_of_the_ground_against_points_that_are_higher_and_lower(mission):
    mission.config["ground"]["sigma_m"] = 7.0
    rows = in_unknown_air(mission).rows()
    table = mission.measured_rows()
    observations = mission.folder / "observations.parquet"

    def shift_when_higher(by_m):
        heights_m = table["h_g_m"] + by_m
        table.assign(h_g_m=heights_m).to_parquet(observations, index=False)
        rows = in_unknown_air(mission).rows()
        return shift(rows)

    higher = shift_when_higher(7.0)
    lower = shift_when_higher(-7.0)
    half = np.abs(higher - lower) / 2.0

    assert_near(rows[GROUND], half, rtol=0.02, share=0.01)


def test_nobody_knows_anything(mission):
    """Only the log tells how good its stations are."""
    done = in_unknown_air(mission)

    rows = done.rows()
    assert rows["sigma_r_c_rad"].isna().all()
    assert is_null(rows[AIR + GROUND])
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
    sigma[:3] = [np.nan, -1.0, np.inf]
    mission.observe(table.append_column("sigma_h", [sigma]))
    mission.config["ground"]["sigma_column"] = "sigma_h"

    done = in_unknown_air(mission)

    (unknown,) = unknown_sigmas(done)
    assert "attitude" not in unknown
    assert "ground" not in unknown
    (bad,) = with_code(done.prepared.ledger, "OBS-SIGMA")
    assert bad.count == 2
    rows = done.table.to_pandas()
    assert (rows["status"] == "ok").all()
    assert rows["sigma_station_dx_px"].notna().all()
    by_ground = rows["sigma_ground_dx_px"]
    assert by_ground[:3].isna().all()
    assert by_ground[3:].notna().all()
    assert rows["sigma_air_dx_px"].isna().all()
    assert_array_equal(rows["sigma_h"], sigma)


def test_a_column_that_is_not_there(mission):
    mission.config["ground"]["sigma_column"] = "sigma_h"
    with refused("OBS-COLUMN", says="ground.sigma_column"):
        read_folder(mission)


# ---- stations


def sigmas_of(mission):
    prepared = read_folder(mission)
    stations = prepared.stations
    return station_sigmas(prepared.mission, stations), stations


def added_deg(whole_rad, part_rad):
    """The part of a sigma that is independent of another part."""
    return np.degrees(np.sqrt(whole_rad**2 - part_rad**2))


def test_the_sigmas_of_each_mount_are_in_radians(mission):
    """Beside what the attitude between two samples of the log adds."""
    with_mounts(mission, sigma_tilt_deg=0.0, sigma_yaw_deg=0.0)
    between, _ = sigmas_of(mission)
    nadir = mission.config["mount"]["nadir"]
    nadir["sigma_tilt_deg"] = 0.5
    nadir["sigma_yaw_deg"] = 2.0
    oblique = mission.config["mount"]["oblique"]
    oblique["sigma_tilt_deg"] = 0.25
    del oblique["sigma_yaw_deg"]

    sigmas, stations = sigmas_of(mission)

    tilt = added_deg(sigmas.tilt_rad, between.tilt_rad)
    yaw = added_deg(sigmas.yaw_rad, between.yaw_rad)
    is_nadir = stations.camera == "nadir"
    assert tilt[is_nadir] == pytest.approx(0.5)
    assert yaw[is_nadir] == pytest.approx(2.0)
    # By default the yaw is as uncertain as the tilt; heights are those of the log.
    assert yaw[~is_nadir] == pytest.approx(0.25)
    assert_array_equal(sigmas.height_m, stations.sigma_height_m)
    # The yaw turns about the vertical of the aircraft, to the left of the oblique camera's axis.
    leaning = np.sqrt(0.5)
    vertical = {
        "nadir": [0.0, 0.0, 1.0],
        "oblique": [-leaning, 0.0, leaning],
    }
    axes = [vertical[camera] for camera in stations.camera]
    assert_allclose(sigmas.yaw_axis, axes, atol=1e-12)


def test_stations_that_know_nothing_of_their_attitude_have_the_sigmas_of_the_mount(mission):
    mission.config["mount"]["oblique"]["sigma_tilt_deg"] = 0.25
    prepared = read_folder(mission)
    unknown = np.full(len(prepared.stations), np.nan)
    stations = replace(prepared.stations, sigma_tilt_rad=unknown)

    tilt_rad = station_sigmas(prepared.mission, stations).tilt_rad

    nadir = stations.camera == "nadir"
    assert np.isnan(tilt_rad[nadir]).all()
    assert tilt_rad[~nadir] == pytest.approx(0.004363323129985824)


# ---- which sigmas there are

LOG = Cabin("log")
WITHOUT_AIR = SimpleNamespace(
    shape="plane",
    cabin=None,
    is_opening=False,
)


@pytest.mark.parametrize(
    ("window", "kinds"),
    [
        (Window(LOG), [SEALED, SEALED]),
        (Window(Cabin("ambient")), [SCHEDULED, SCHEDULED]),
        (Window(Cabin("standard_schedule")), [SCHEDULED, SEALED]),
        (Window(Cabin("opening")), [FOLLOWING, FOLLOWING]),
        (Window(LOG, shape="spherical"), [OPEN, OPEN]),
        (WITHOUT_AIR, [OPEN, OPEN]),
    ],
    ids=[
        "sealed",
        "ambient",
        "schedule",
        "opening",
        "dome",
        "no cabin",
    ],
)
def test_the_kind_of_a_window_at_850_and_at_600_hectopascal(window, kinds):
    """The camera without a window has the kind of none."""
    camera = np.array(["nadir", "nadir", "wing"], object)
    stations = empty_stations(camera, camera, STATION_OK)
    pressures_pa = np.array([85e3, 60e3, 85e3])
    air = SimpleNamespace(pressure=lambda height_m: pressures_pa)
    mission = SimpleNamespace(windows={"nadir": window})

    kinds_of_stations = kinds_of_windows(mission, stations, air)

    assert kinds_of_stations.tolist() == [*kinds, OPEN]


NO_SIGMA = {
    "tilt_rad": [np.nan, np.nan],
    "height_m": [np.nan, np.nan],
    "sigma_m": None,
    "sigma_column": None,
    "cabin": [[np.nan, np.nan]],
    "kinds": [OPEN, OPEN],
}


@pytest.mark.parametrize(
    ("changed", "is_known"),
    [
        ({}, False),
        ({"tilt_rad": [0.001, np.nan]}, True),
        ({"tilt_rad": [np.nan, 0.001]}, False),  # of a station that is not ok
        ({"height_m": [0.1, np.nan]}, True),
        ({"sigma_m": 5.0}, True),
        ({"sigma_column": "sigma_h"}, True),
        ({"cabin": [[np.nan, 1.0]]}, True),
        ({"kinds": [OPEN, SEALED]}, True),
    ],
)
def test_one_sigma_is_enough_to_compute_with(changed, is_known):
    values = SimpleNamespace(**NO_SIGMA | changed)
    stations = SimpleNamespace(ok=np.array([True, False]))
    mission = SimpleNamespace(ground=values)
    sigmas = SimpleNamespace(
        tilt_rad=np.array(values.tilt_rad),
        height_m=np.array(values.height_m),
        cabin=np.array(values.cabin),
    )
    kinds = np.array(values.kinds)
    assert has_any_sigma(mission, stations, sigmas, kinds) == is_known
