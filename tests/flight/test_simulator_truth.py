"""Stations, their sigmas and UTC against the truth of ArduPilot's simulator.

Truth: where the simulator had the aircraft at each event (`*_truth.csv`, rows SIM and SIM2), and
the GPS week and milliseconds of fixes, whose places are compared with the simulator's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import rotation_of
from unbend.flight.channels import Channel
from unbend.flight.clock import utc_of_gps
from unbend.flight.evidence.log_accuracy import LEAST_TILT_RAD, LEAST_YAW_RAD, with_accuracy
from unbend.flight.exposures import Events
from unbend.flight.heights import height_system
from unbend.flight.mount import Mount
from unbend.flight.roles import assign_roles
from unbend.flight.station_builder import build_stations
from unbend.flight.stations import Stations
from unbend.ingest import Log, open_log

LOGS = Path(__file__).parents[3] / "shared" / "logs"
pytestmark = pytest.mark.shared("logs")
FLIGHTS = [path.name.removesuffix("_truth.csv") for path in sorted(LOGS.glob("*_truth.csv"))]
FLOWN = [*product(FLIGHTS, ("BIN", "tlog"))]
"""The flights that are at hand, and the kinds of their logs."""
NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SPEED_M_S = 24.0  # at which errors along the track are compared

Rows = dict[str, np.ndarray]


@dataclass(frozen=True)
class Flight:
    """A log of the simulator, with the truth of its exposures."""

    log: Log
    truth: pd.DataFrame

    @cached_property
    def events(self) -> list[tuple[Channel, pd.DataFrame]]:
        """Each event channel with the truth of its rows."""
        pairs = []
        for channel in self.log.channels:
            if channel.source.message in ("CAM", "CAMERA_FEEDBACK"):
                of_camera = self.truth[self.truth["I"] == int(channel.source.instance)]
                index = channel["event_index"].astype(int)
                pairs.append((channel, of_camera.set_index("Img").loc[index].reset_index()))
        return pairs

    def stations(self, time_ns: np.ndarray, every: int = 1, sigma_s: float = 0.0) -> Stations:
        """Stations at some times, by one in ``every`` of the logged attitudes."""
        roles, _ = assign_roles(self.log.channels, {}, needs_cabin=False)
        heights, _ = height_system(roles, None)
        attitude = roles["attitude"]
        roles["attitude"] = attitude.rows(np.arange(len(attitude)) % every == 0)
        roles, accuracy = with_accuracy(roles, self.log.channels)
        events = Events("cam", np.full(time_ns.size, "", object), time_ns, sigma_s)
        return build_stations(events, roles, Mount(), heights, 1.0, accuracy=accuracy)


@pytest.fixture(scope="module")
def flights() -> dict[tuple[str, str], Flight]:
    opened = {}
    for name, kind in FLOWN:
        truth = pd.read_csv(LOGS / f"{name}_truth.csv")
        log = open_log(LOGS / f"{name}.{kind}")
        opened[name, kind] = Flight(log, truth[truth["row"] == "CAM"])
    return opened


def errors(stations: Stations, truth: pd.DataFrame) -> Rows:
    """(n, k) north and east, height [m], about the level axes and the vertical one [deg]."""
    latitude = np.radians(truth["lat"].to_numpy())
    longitude = np.radians(truth["lng"].to_numpy())
    north_m = (stations.lat_rad - latitude) * 6_367_000.0
    east_m = (stations.lon_rad - longitude) * 6_385_000.0 * np.cos(latitude)
    enu_from_body = rotation_of(stations.aircraft_quaternion).inv()
    angles = truth[["yaw", "pitch", "roll"]].to_numpy()
    ned_from_body = Rotation.from_euler("ZYX", angles, degrees=True)
    turn = ned_from_body.inv() * Rotation.from_matrix(NED_FROM_ENU) * enu_from_body
    turn_deg = turn.as_rotvec(degrees=True)
    return {
        "horizontal": np.stack([north_m, east_m], axis=1),
        "height": (stations.h_msl_m - truth["alt_amsl"].to_numpy())[:, None],
        "tilt": turn_deg[:, :2],
        "yaw": turn_deg[:, 2:],
    }


def sigmas(stations: Stations) -> Rows:
    """(n, 1) of the same."""
    return {
        "horizontal": stations.sigma_horizontal_m[:, None],
        "height": stations.sigma_height_m[:, None],
        "tilt": np.degrees(stations.sigma_tilt_rad)[:, None],
        "yaw": np.degrees(stations.sigma_yaw_rad)[:, None],
    }


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def joined(parts: list[Rows]) -> Rows:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def at_events(flight: Flight, **options: int) -> tuple[Rows, Rows]:
    """Errors and sigmas of all events of a flight."""
    of_errors = []
    of_sigmas = []
    for channel, truth in flight.events:
        stations = flight.stations(channel.time_ns, **options)
        assert stations.ok.all()
        of_errors.append(errors(stations, truth))
        of_sigmas.append(sigmas(stations))
    return joined(of_errors), joined(of_sigmas)


def assert_honest(error: np.ndarray, sigma: np.ndarray, quantity: str) -> None:
    """Error over sigma: rms 0.7 to 1.2; the median sigma is at most twice the rms error."""
    assert 0.7 < rms(error / sigma) < 1.2, quantity
    assert np.median(sigma) < 2.0 * rms(error), quantity


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_positions_attitudes_and_their_sigmas(flights, name, kind):
    error, sigma = at_events(flights[name, kind])
    horizontal_m = np.linalg.norm(error["horizontal"], axis=1)
    position_m = np.hypot(horizontal_m, error["height"][:, 0])
    assert np.percentile(position_m, 95) < 1.5
    assert np.percentile(np.linalg.norm(error["tilt"], axis=1), 95) < 0.5
    for quantity in sigma:
        assert_honest(error[quantity], sigma[quantity], quantity)


COLUMNS = {
    "Lat": "lat",
    "Lng": "lng",
    "Alt": "alt_amsl",
    "Yaw": "yaw",
    "Pitch": "pitch",
    "Roll": "roll",
}


def throughout(flight: Flight, simulated: Log) -> tuple[Rows, Rows]:
    """Errors and sigmas every second in the air, by the simulator's own rows."""
    place = simulated.message("SIM")
    motion = simulated.message("SIM2")
    speed = np.hypot(motion["VN"], motion["VE"])
    is_fast = np.interp(place["TimeUS"], motion["TimeUS"], speed) > 12.0
    is_high = place["Alt"] > place["Alt"][0] + 50.0
    rows = np.flatnonzero(is_fast & is_high)[::10]
    truth = pd.DataFrame({name: place[column][rows] for column, name in COLUMNS.items()})
    stations = flight.stations(place["time_ns"][rows])
    assert len(stations) > 1000
    assert stations.ok.all()
    return errors(stations, truth), sigmas(stations)


@pytest.mark.parametrize(
    ("learnt", "tested", "kind"),
    [(*pair, kind) for pair in permutations(FLIGHTS, 2) for kind in ("BIN", "tlog")],
)
def test_what_one_flight_says_of_attitudes_holds_for_the_other(flights, learnt, tested, kind):
    """What no innovation shows is the one empirical part: by one flight, tested on the other."""
    error, sigma = throughout(flights[learnt, "BIN"], flights[learnt, "BIN"].log)
    tested_error, tested_sigma = throughout(flights[tested, kind], flights[tested, "BIN"].log)
    for quantity, least_rad in (("tilt", LEAST_TILT_RAD), ("yaw", LEAST_YAW_RAD)):
        least_deg = np.degrees(least_rad)
        shown = sigma[quantity] ** 2 - least_deg**2  # by innovations
        unseen = np.mean(error[quantity] ** 2) - np.mean(shown)
        assert 0.8 * least_deg < np.sqrt(unseen) < 1.25 * least_deg  # the program's is of both
        stated = tested_sigma[quantity]
        predicted = np.sqrt(stated**2 - least_deg**2 + unseen)
        assert_honest(tested_error[quantity], predicted, quantity)
        assert_honest(tested_error[quantity], stated, quantity)


@pytest.mark.parametrize(("name", "kind"), FLOWN)
@pytest.mark.parametrize("every", [2, 3])
def test_attitudes_at_5_and_3_hz_know_how_good_they_are(flights, name, kind, every):
    error, sigma = at_events(flights[name, kind], every=every)
    over_sigma = error["tilt"] / sigma["tilt"]
    assert 0.7 < rms(over_sigma) < 1.2
    assert np.abs(over_sigma).max() < 4.5


def true_offset_ns(log: Log) -> int:
    """UTC less time since boot, by where the simulator had the aircraft of each fix."""
    fix = log.message("GPS")
    place = log.message("SIM")
    motion = log.message("SIM2")
    is_new = np.append(True, np.diff(fix["GMS"].astype(np.int64)) != 0)
    rows = np.flatnonzero(is_new & (fix["Status"] >= 3) & (fix["Spd"] > 10.0))
    boot_us = fix["TimeUS"][rows]
    degree_m = np.radians(6_376_000.0)
    scales_m = {"Lat": degree_m, "Lng": degree_m * np.cos(np.radians(place["Lat"][0]))}
    along = np.zeros(rows.size)
    square_speed = np.zeros(rows.size)
    for axis, velocity in (("Lat", "VN"), ("Lng", "VE")):
        simulated = np.interp(boot_us, place["TimeUS"], place[axis])
        speed = np.interp(boot_us, motion["TimeUS"], motion[velocity])
        along += (fix[axis][rows] - simulated) * scales_m[axis] * speed
        square_speed += speed**2
    late_ns = -1e9 * along / square_speed
    utc_ns = utc_of_gps(fix["GWk"][rows], fix["GMS"][rows] / 1e3)
    offset_ns = utc_ns - boot_us.astype(np.int64) * 1000
    difference_ns = offset_ns - offset_ns[0] + late_ns
    assert np.std(difference_ns) < 2e6
    return int(offset_ns[0]) + round(np.median(difference_ns))


def along_track_m(flight: Flight, time_ns: np.ndarray, truth: pd.DataFrame) -> np.ndarray:
    """How far stations at some times are from the truth, as at the usual speed."""
    off_m = np.linalg.norm(errors(flight.stations(time_ns), truth)["horizontal"], axis=1)
    return off_m * SPEED_M_S / np.hypot(truth["vn"], truth["ve"]).to_numpy()


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_exposures_in_true_utc_have_true_positions(flights, name, kind):
    """A camera with a GPS clock: within 0.5 m at 24 m/s, and within the sigma of UTC.

    UTC goes with the filter's positions, which are ahead at the true time.
    """
    flight = flights[name, kind]
    offset_ns = true_offset_ns(flights[name, "BIN"].log)
    at_true_utc_m = []
    as_logged_m = []
    late_s = []
    for channel, truth in flight.events:
        true_utc_ns = truth["TimeUS"].to_numpy() * 1000 + offset_ns
        at_true_utc_m.append(along_track_m(flight, true_utc_ns, truth))
        as_logged_m.append(along_track_m(flight, channel.time_ns, truth))
        late_s.append((channel.time_ns - true_utc_ns) * 1e-9)
    off_m = np.concatenate(at_true_utc_m)
    assert np.median(off_m) < 0.1
    assert np.percentile(off_m, 95) < 0.5
    assert 0.2 < np.median(np.concatenate(as_logged_m)) < 0.55
    assert abs(np.median(np.concatenate(late_s))) < 1.5 * flight.log.utc_sigma_s
    assert flight.log.utc_sigma_s < 0.04


def times_of_images(flight: Flight) -> dict[tuple[str, float], int]:
    """The time of each exposure by camera and number [Unix ns]."""
    times = {}
    for channel, _ in flight.events:
        for index, time_ns in zip(channel["event_index"], channel.time_ns, strict=True):
            times[channel.source.instance, index] = time_ns
    return times


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_logs_of_a_flight_agree_about_utc(flights, name):
    dataflash = times_of_images(flights[name, "BIN"])
    telemetry = times_of_images(flights[name, "tlog"])
    apart_ns = [dataflash[image] - telemetry[image] for image in dataflash.keys() & telemetry]
    assert len(apart_ns) > 200
    assert np.abs(apart_ns).max() < 5e6


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_delay_leaves_exposures_and_positions_of_the_filter_together(flights, name):
    """A fix has the time of its epoch, not that of its row."""
    log = flights[name, "BIN"].log
    fixes = log.message("GPS")
    first_offset_ns = fixes["time_ns"][0] - int(fixes["TimeUS"][0]) * 1000
    for message in ("CAM", "POS", "ATT"):
        channels = [channel for channel in log.channels if channel.source.message == message]
        boot_us = np.unique(log.message(message)["TimeUS"].astype(np.int64))
        utc_ns = np.unique(np.concatenate([channel.time_ns for channel in channels]))
        assert set(utc_ns - boot_us * 1000) == {first_offset_ns}
    assert not np.isin(fixes["time_ns"], log.channel("GPS[0]").time_ns).any()


def test_a_sigma_of_the_time_moves_along_the_track_and_the_turn(flights):
    flight = flights["sitl_survey", "BIN"]
    channel, truth = flight.events[0]
    certain = flight.stations(channel.time_ns)
    uncertain = flight.stations(channel.time_ns, sigma_s=0.1)
    added_m2 = uncertain.sigma_horizontal_m**2 - certain.sigma_horizontal_m**2
    speed_m_s = np.hypot(truth["vn"], truth["ve"])
    np.testing.assert_allclose(np.sqrt(2.0 * added_m2), 0.1 * speed_m_s, rtol=0.05)
    added_height_m = np.sqrt(uncertain.sigma_height_m**2 - certain.sigma_height_m**2)
    assert np.corrcoef(added_height_m, np.abs(truth["vd"]))[0, 1] > 0.95
    turned = uncertain.sigma_yaw_rad > 1.2 * certain.sigma_yaw_rad
    assert 0 < turned.sum() < turned.size
