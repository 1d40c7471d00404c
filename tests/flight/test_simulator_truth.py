"""Stations, their sigmas and UTC against the truth of ArduPilot's simulator.

Truth: where the simulator had the aircraft at each event (`*_truth.csv`, rows SIM and SIM2), and
the GPS week and milliseconds of fixes, whose places are compared with the simulator's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations, product

import numpy as np
import pandas as pd
import pytest

from tests.flight.made_channels import roles_of
from tests.flight.simulator_logs import (
    FLIGHTS,
    Columns,
    Flight,
    errors,
    flight,
    sigmas,
    unnamed_events,
)
from tests.helpers import NS_PER_S
from unbend.flight.clock import utc_of_gps
from unbend.flight.evidence.log_accuracy import LEAST_TILT_RAD, LEAST_YAW_RAD, with_accuracy
from unbend.flight.heights import height_system
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations
from unbend.flight.stations import Stations
from unbend.ingest import Log

pytestmark = pytest.mark.shared("logs")
KINDS = ("BIN", "tlog")
FLOWN = list(product(FLIGHTS, KINDS))
SPEED_M_S = 24.0  # at which errors along the track are compared


@pytest.fixture(scope="module")
def flights() -> dict[tuple[str, str], Flight]:
    return {(name, kind): flight(name, kind) for name, kind in FLOWN}


def stations_of(
    flown: Flight,
    time_ns: np.ndarray,
    every: int = 1,
    sigma_s: float = 0.0,
) -> Stations:
    """Stations at some times, by one in ``every`` of the logged attitudes."""
    roles = roles_of(flown.log.channels)
    heights, _ = height_system(roles, None)
    attitude = roles["attitude"]
    is_read = np.arange(len(attitude)) % every == 0
    roles["attitude"] = attitude.rows(is_read)
    roles, accuracy = with_accuracy(roles, flown.log.channels)
    stations = build_stations(
        unnamed_events(time_ns, sigma_s),
        roles,
        Mount(),
        heights,
        1.0,
        accuracy=accuracy,
    )
    assert stations.ok.all()
    return stations


def rms(values: np.ndarray) -> float:
    return np.sqrt(np.mean(values**2))


def assert_honest(
    error: np.ndarray,
    sigma: np.ndarray,
    quantity: str,
) -> None:
    """Error over sigma: rms 0.7 to 1.2; the median sigma is at most twice the rms error."""
    assert 0.7 < rms(error / sigma) < 1.2, quantity
    assert np.median(sigma) < 2.0 * rms(error), quantity


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_positions_attitudes_and_their_sigmas(flights, name, kind):
    flown = flights[name, kind]

    stations = stations_of(flown, flown.time_ns)

    error = errors(stations, flown.truth)
    position_m = np.hstack([error["horizontal"], error["height"]])
    assert np.percentile(np.linalg.norm(position_m, axis=1), 95) < 1.5
    assert np.percentile(np.linalg.norm(error["tilt"], axis=1), 95) < 0.5
    for quantity, sigma in sigmas(stations).items():
        assert_honest(error[quantity], sigma, quantity)


COLUMNS = {
    "Lat": "lat",
    "Lng": "lng",
    "Alt": "alt_amsl",
    "Yaw": "yaw",
    "Pitch": "pitch",
    "Roll": "roll",
}


def throughout(flown: Flight, simulated: Log) -> tuple[Columns, Columns]:
    """Errors and sigmas every second in the air, by the simulator's own rows."""
    place = simulated.message("SIM")
    motion = simulated.message("SIM2")
    speed = np.hypot(motion["VN"], motion["VE"])
    is_fast = np.interp(place["TimeUS"], motion["TimeUS"], speed) > 12.0
    is_high = place["Alt"] > place["Alt"][0] + 50.0
    rows = np.flatnonzero(is_fast & is_high)[::10]
    assert rows.size > 1000

    stations = stations_of(flown, place["time_ns"][rows])

    truth = pd.DataFrame({name: place[column][rows] for column, name in COLUMNS.items()})
    return errors(stations, truth), sigmas(stations)


@pytest.mark.parametrize(("learnt", "tested"), list(permutations(FLIGHTS, 2)))
@pytest.mark.parametrize("kind", KINDS)
def test_what_one_flight_says_of_attitudes_holds_for_the_other(flights, learnt, tested, kind):
    """What no innovation shows is the one empirical part: by one flight, tested on the other."""
    learnt_flight = flights[learnt, "BIN"]
    error, sigma = throughout(learnt_flight, learnt_flight.log)
    simulated = flights[tested, "BIN"].log
    tested_error, tested_sigma = throughout(flights[tested, kind], simulated)
    for quantity, least_rad in (("tilt", LEAST_TILT_RAD), ("yaw", LEAST_YAW_RAD)):
        least_deg = np.degrees(least_rad)
        shown = sigma[quantity] ** 2 - least_deg**2  # by innovations
        unseen = np.mean(error[quantity] ** 2) - np.mean(shown)
        assert 0.8 * least_deg < np.sqrt(unseen) < 1.25 * least_deg  # the program's is of both
        sigma_deg = tested_sigma[quantity]
        predicted_deg = np.sqrt(sigma_deg**2 - least_deg**2 + unseen)
        assert_honest(tested_error[quantity], predicted_deg, quantity)
        assert_honest(tested_error[quantity], sigma_deg, quantity)


@pytest.mark.parametrize(("name", "kind"), FLOWN)
@pytest.mark.parametrize("every", [2, 3])
def test_attitudes_at_5_and_3_hz_know_how_good_they_are(flights, name, kind, every):
    flown = flights[name, kind]
    stations = stations_of(flown, flown.time_ns, every)
    over_sigma = errors(stations, flown.truth)["tilt"] / sigmas(stations)["tilt"]
    assert 0.7 < rms(over_sigma) < 1.2
    assert np.abs(over_sigma).max() < 4.5


def true_offset_ns(log: Log) -> int:
    """UTC less time since boot, by where the simulator had the aircraft of each fix."""
    fix = log.message("GPS")
    place = log.message("SIM")
    motion = log.message("SIM2")
    is_new = np.diff(fix["GMS"].astype(np.int64), prepend=-1) != 0
    is_good = (fix["Status"] >= 3) & (fix["Spd"] > 10.0)
    rows = np.flatnonzero(is_new & is_good)
    boot_us = fix["TimeUS"][rows]

    def simulated(message: Mapping[str, np.ndarray], column: str) -> np.ndarray:
        return np.interp(boot_us, message["TimeUS"], message[column])

    degree_m = np.radians(6_376_000.0)
    parallel_m = degree_m * np.cos(np.radians(place["Lat"][0]))
    north_m = (fix["Lat"][rows] - simulated(place, "Lat")) * degree_m
    east_m = (fix["Lng"][rows] - simulated(place, "Lng")) * parallel_m
    v_north = simulated(motion, "VN")
    v_east = simulated(motion, "VE")
    ahead_s = (north_m * v_north + east_m * v_east) / (v_north**2 + v_east**2)
    late_ns = -NS_PER_S * ahead_s
    utc_ns = utc_of_gps(fix["GWk"][rows], fix["GMS"][rows] / 1e3)
    offset_ns = utc_ns - boot_us.astype(np.int64) * 1000
    difference_ns = offset_ns - offset_ns[0] + late_ns
    assert np.std(difference_ns) < 2e6
    return int(offset_ns[0]) + round(np.median(difference_ns))


def speed_m_s(flown: Flight) -> np.ndarray:
    return np.hypot(flown.truth["vn"], flown.truth["ve"]).to_numpy()


def along_track_m(flown: Flight, time_ns: np.ndarray) -> np.ndarray:
    """How far stations at some times are from the truth, as at the usual speed."""
    stations = stations_of(flown, time_ns)
    horizontal_m = errors(stations, flown.truth)["horizontal"]
    return np.linalg.norm(horizontal_m, axis=1) * SPEED_M_S / speed_m_s(flown)


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_exposures_in_true_utc_have_true_positions(flights, name, kind):
    """A camera with a GPS clock: within 0.5 m at 24 m/s, and within the sigma of UTC.

    UTC goes with the filter's positions, which are ahead at the true time.
    """
    flown = flights[name, kind]
    boot_ns = flown.truth["TimeUS"].to_numpy() * 1000
    true_utc_ns = boot_ns + true_offset_ns(flights[name, "BIN"].log)

    at_true_utc_m = along_track_m(flown, true_utc_ns)
    as_logged_m = along_track_m(flown, flown.time_ns)

    assert np.median(at_true_utc_m) < 0.1
    assert np.percentile(at_true_utc_m, 95) < 0.5
    assert 0.2 < np.median(as_logged_m) < 0.55
    late_s = (flown.time_ns - true_utc_ns) / NS_PER_S
    assert abs(np.median(late_s)) < 1.5 * flown.log.utc_sigma_s
    assert flown.log.utc_sigma_s < 0.04


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_logs_of_a_flight_agree_about_utc(flights, name):
    dataflash_ns = flights[name, "BIN"].truth["time_ns"]
    telemetry_ns = flights[name, "tlog"].truth["time_ns"]
    apart_ns = (dataflash_ns - telemetry_ns).dropna()  # image by image
    assert len(apart_ns) > 200
    assert apart_ns.abs().max() < 5e6


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_delay_leaves_exposures_and_positions_of_the_filter_together(flights, name):
    """A fix has the time of its epoch, not that of its row."""
    log = flights[name, "BIN"].log
    fixes = log.message("GPS")
    first_offset_ns = fixes["time_ns"][0] - int(fixes["TimeUS"][0]) * 1000
    for message in ("CAM", "POS", "ATT"):
        times_ns = [
            channel.time_ns for channel in log.channels if channel.source.message == message
        ]
        boot_us = np.unique(log.message(message)["TimeUS"].astype(np.int64))
        offset_ns = np.unique(np.concatenate(times_ns)) - boot_us * 1000
        assert set(offset_ns) == {first_offset_ns}
    assert not np.isin(fixes["time_ns"], log.channel("GPS[0]").time_ns).any()


def test_a_sigma_of_the_time_moves_along_the_track_and_the_turn(flights):
    flown = flights["sitl_survey", "BIN"]

    certain = stations_of(flown, flown.time_ns)
    uncertain = stations_of(flown, flown.time_ns, sigma_s=0.1)

    added_m2 = uncertain.sigma_horizontal_m**2 - certain.sigma_horizontal_m**2
    along_m = 0.1 * speed_m_s(flown)
    np.testing.assert_allclose(np.sqrt(2.0 * added_m2), along_m, rtol=0.05)
    added_height_m = np.sqrt(uncertain.sigma_height_m**2 - certain.sigma_height_m**2)
    assert np.corrcoef(added_height_m, np.abs(flown.truth["vd"]))[0, 1] > 0.95
    turned = uncertain.sigma_yaw_rad > 1.2 * certain.sigma_yaw_rad
    assert 0 < turned.sum() < turned.size
