"""Stations, their sigmas and UTC against the truth of ArduPilot's simulator.

Truth: where the simulator had the aircraft at each event (`*_truth.csv`, rows SIM and SIM2), and
the GPS week and milliseconds of fixes, whose places are compared with the simulator's own.
"""

from itertools import permutations, product

import numpy as np
import pandas as pd
import pytest

from tests.flight.made_channels import roles_of
from tests.flight.simulator_logs import (
    FLIGHTS,
    errors,
    flight,
    sigmas,
    stations_by,
    unnamed_events,
)
from tests.helpers import NS_PER_S
from unbend.flight.clock import utc_of_gps
from unbend.flight.evidence.log_accuracy import LEAST_TILT_RAD, LEAST_YAW_RAD

pytestmark = pytest.mark.shared("logs")
KINDS = ("BIN", "tlog")
FLOWN = list(product(FLIGHTS, KINDS))
SPEED_M_S = 24.0  # at which errors along the track are compared


@pytest.fixture(scope="module")
def flights():
    flown = {}
    for name, kind in FLOWN:
        flown[name, kind] = flight(name, kind)
    return flown


def stations_of(flown, time_ns, every=1, sigma_s=0.0):
    """Stations at some times, by one in ``every`` of the logged attitudes."""
    channels = flown.log.channels
    roles = roles_of(channels)
    attitude = roles["attitude"]
    is_read = np.arange(len(attitude)) % every == 0
    roles["attitude"] = attitude.rows(is_read)
    stations = stations_by(
        roles,
        channels,
        unnamed_events(time_ns, sigma_s),
        max_gap_s=1.0,
    )
    assert stations.ok.all()
    return stations


def rms(values):
    return np.sqrt(np.mean(values**2))


def assert_honest(error, sigma, quantity):
    """Error over sigma: rms 0.7 to 1.2; the median sigma is at most twice the rms error."""
    assert 0.7 < rms(error / sigma) < 1.2, quantity
    assert np.median(sigma) < 2.0 * rms(error), quantity


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_positions_attitudes_and_their_sigmas(flights, name, kind):
    flown = flights[name, kind]

    stations = stations_of(flown, flown.time_ns)

    error = errors(stations, flown.truth)
    position = np.hstack([error["horizontal"], error["height"]])
    position_m = np.linalg.norm(position, axis=1)
    tilt_deg = np.linalg.norm(error["tilt"], axis=1)
    assert np.percentile(position_m, 95) < 1.5
    assert np.percentile(tilt_deg, 95) < 0.5
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


def throughout(flown, simulated):
    """Errors and sigmas every second in the air, by the simulator's own rows."""
    place = simulated.message("SIM")
    motion = simulated.message("SIM2")
    speed = np.interp(
        place["TimeUS"],
        motion["TimeUS"],
        np.hypot(motion["VN"], motion["VE"]),
    )
    is_fast = speed > 12.0
    is_high = place["Alt"] > place["Alt"][0] + 50.0
    rows = np.flatnonzero(is_fast & is_high)[::10]
    assert rows.size > 1000

    stations = stations_of(flown, place["time_ns"][rows])

    truth = pd.DataFrame()
    for column, name in COLUMNS.items():
        truth[name] = place[column][rows]
    return errors(stations, truth), sigmas(stations)


@pytest.mark.parametrize(("learnt", "tested"), list(permutations(FLIGHTS, 2)))
@pytest.mark.parametrize("kind", KINDS)
def test_what_one_flight_says_of_attitudes_holds_for_the_other(flights, learnt, tested, kind):
    """What no innovation shows is the one empirical part: by one flight, tested on the other."""
    learnt_flight = flights[learnt, "BIN"]
    error, sigma = throughout(learnt_flight, learnt_flight.log)
    tested_error, tested_sigma = throughout(
        flights[tested, kind],
        flights[tested, "BIN"].log,
    )
    for quantity, least_rad in (
        ("tilt", LEAST_TILT_RAD),
        ("yaw", LEAST_YAW_RAD),
    ):
        least_deg = np.degrees(least_rad)
        error_deg = tested_error[quantity]
        sigma_deg = tested_sigma[quantity]
        shown = sigma[quantity] ** 2 - least_deg**2  # by innovations
        unseen = np.mean(error[quantity] ** 2 - shown)
        assert 0.8 * least_deg < np.sqrt(unseen) < 1.25 * least_deg  # the program's is of both
        predicted_deg = np.sqrt(sigma_deg**2 - least_deg**2 + unseen)
        assert_honest(error_deg, predicted_deg, quantity)
        assert_honest(error_deg, sigma_deg, quantity)


@pytest.mark.parametrize(("name", "kind"), FLOWN)
@pytest.mark.parametrize("every", [2, 3])
def test_attitudes_at_5_and_3_hz_know_how_good_they_are(flights, name, kind, every):
    flown = flights[name, kind]
    stations = stations_of(flown, flown.time_ns, every)
    tilt_deg = errors(stations, flown.truth)["tilt"]
    over_sigma = tilt_deg / sigmas(stations)["tilt"]
    assert 0.7 < rms(over_sigma) < 1.2
    assert np.abs(over_sigma).max() < 4.5


def true_offset_ns(log):
    """UTC less time since boot, by where the simulator had the aircraft of each fix."""
    fix = log.message("GPS")
    place = log.message("SIM")
    motion = log.message("SIM2")
    milliseconds = fix["GMS"].astype(np.int64)
    is_new = np.diff(milliseconds, prepend=-1) != 0
    is_good = (fix["Status"] >= 3) & (fix["Spd"] > 10.0)
    rows = np.flatnonzero(is_new & is_good)
    boot_us = fix["TimeUS"][rows]

    def simulated(message, column):
        return np.interp(boot_us, message["TimeUS"], message[column])

    degree_m = np.radians(6_376_000.0)
    latitude = np.radians(place["Lat"][0])
    parallel_m = degree_m * np.cos(latitude)
    north_deg = fix["Lat"][rows] - simulated(place, "Lat")
    east_deg = fix["Lng"][rows] - simulated(place, "Lng")
    v_north = simulated(motion, "VN")
    v_east = simulated(motion, "VE")
    square_speed = v_north**2 + v_east**2
    along = north_deg * degree_m * v_north + east_deg * parallel_m * v_east
    late_ns = -NS_PER_S * along / square_speed
    utc_ns = utc_of_gps(
        fix["GWk"][rows],
        milliseconds[rows] / 1e3,
    )
    boot_ns = boot_us.astype(np.int64) * 1000
    offset_ns = utc_ns - boot_ns
    first_ns = int(offset_ns[0])
    difference_ns = offset_ns - first_ns + late_ns
    assert np.std(difference_ns) < 2e6
    return first_ns + round(np.median(difference_ns))


def speed_m_s(flown):
    truth = flown.truth
    return np.hypot(truth["vn"], truth["ve"]).to_numpy()


def along_track_m(flown, time_ns):
    """How far stations at some times are from the truth, as at the usual speed."""
    stations = stations_of(flown, time_ns)
    horizontal = errors(stations, flown.truth)["horizontal"]
    horizontal_m = np.linalg.norm(horizontal, axis=1)
    return horizontal_m * SPEED_M_S / speed_m_s(flown)


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_exposures_in_true_utc_have_true_positions(flights, name, kind):
    """A camera with a GPS clock: within 0.5 m at 24 m/s, and within the sigma of UTC.

    UTC goes with the filter's positions, which are ahead at the true time.
    """
    flown = flights[name, kind]
    offset_ns = true_offset_ns(flights[name, "BIN"].log)
    boot_ns = flown.truth["TimeUS"].to_numpy() * 1000
    true_utc_ns = boot_ns + offset_ns

    at_true_utc_m = along_track_m(flown, true_utc_ns)
    as_logged_m = along_track_m(flown, flown.time_ns)

    assert np.median(at_true_utc_m) < 0.1
    assert np.percentile(at_true_utc_m, 95) < 0.5
    assert 0.2 < np.median(as_logged_m) < 0.55
    late_s = (flown.time_ns - true_utc_ns) / NS_PER_S
    utc_sigma_s = flown.log.utc_sigma_s
    assert abs(np.median(late_s)) < 1.5 * utc_sigma_s
    assert utc_sigma_s < 0.04


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_logs_of_a_flight_agree_about_utc(flights, name):
    dataflash_ns = flights[name, "BIN"].truth["time_ns"]
    telemetry_ns = flights[name, "tlog"].truth["time_ns"]
    apart_ns = dataflash_ns - telemetry_ns  # image by image
    apart_ns = apart_ns.dropna()
    assert len(apart_ns) > 200
    assert apart_ns.abs().max() < 5e6


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_delay_leaves_exposures_and_positions_of_the_filter_together(flights, name):
    """A fix has the time of its epoch, not that of its row."""
    log = flights[name, "BIN"].log
    fixes = log.message("GPS")
    first_boot_ns = int(fixes["TimeUS"][0]) * 1000
    first_offset_ns = fixes["time_ns"][0] - first_boot_ns
    for message in ("CAM", "POS", "ATT"):
        times_ns = [
            channel.time_ns for channel in log.channels if channel.source.message == message
        ]
        boot_us = log.message(message)["TimeUS"].astype(np.int64)
        boot_ns = np.unique(boot_us) * 1000
        utc_ns = np.unique(np.concatenate(times_ns))
        assert set(utc_ns - boot_ns) == {first_offset_ns}
    epochs_ns = log.channel("GPS[0]").time_ns
    assert not np.isin(fixes["time_ns"], epochs_ns).any()


def test_a_sigma_of_the_time_moves_along_the_track_and_the_turn(flights):
    flown = flights["sitl_survey", "BIN"]

    certain = stations_of(flown, flown.time_ns)
    uncertain = stations_of(
        flown,
        flown.time_ns,
        sigma_s=0.1,
    )

    added_m2 = uncertain.sigma_horizontal_m**2 - certain.sigma_horizontal_m**2
    along_m = 0.1 * speed_m_s(flown)
    np.testing.assert_allclose(
        np.sqrt(2.0 * added_m2),
        along_m,
        rtol=0.05,
    )
    added_height_m2 = uncertain.sigma_height_m**2 - certain.sigma_height_m**2
    descent_m_s = np.abs(flown.truth["vd"])
    correlation = np.corrcoef(np.sqrt(added_height_m2), descent_m_s)
    assert correlation[0, 1] > 0.95
    turned = uncertain.sigma_yaw_rad > 1.2 * certain.sigma_yaw_rad
    assert 0 < turned.sum() < turned.size
