"""Stations, their sigmas and UTC against the truth of ArduPilot's simulator.

Truth: where the simulator had the aircraft at each event (`*_truth.csv`, rows SIM and SIM2), and
the GPS week and milliseconds of fixes, whose places are compared with the simulator's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

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


@dataclass(frozen=True)
class Flight:
    name: str
    log: Log
    truth: pd.DataFrame

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
        roles, _ = assign_roles(self.log.channels, {}, needs_cabin=False)
        heights, _ = height_system(roles, None)
        thin = roles["attitude"]
        roles["attitude"] = replace(
            thin,
            time_ns=thin.time_ns[::every],
            boot=thin.boot[::every],
            columns={name: values[::every] for name, values in thin.columns.items()},
        )
        roles, accuracy = with_accuracy(roles, self.log.channels)
        names = np.array([str(k) for k in range(time_ns.size)], object)
        events = Events("cam", names, time_ns, sigma_s)
        return build_stations(events, roles, Mount(), heights, 1.0, accuracy=accuracy)


@pytest.fixture(scope="module")
def flights() -> dict[tuple[str, str], Flight]:
    found = {}
    for name in FLIGHTS:
        truth = pd.read_csv(LOGS / f"{name}_truth.csv")
        truth = truth[truth["row"] == "CAM"]
        for kind in ("BIN", "tlog"):
            found[name, kind] = Flight(name, open_log(LOGS / f"{name}.{kind}"), truth)
    return found


def errors(stations: Stations, truth: pd.DataFrame) -> dict[str, np.ndarray]:
    """(n, k) north and east, height [m], about the level axes and the vertical one [deg]."""
    lat = np.radians(truth["lat"].to_numpy())
    north = (stations.lat_rad - lat) * 6_367_000.0
    east = (stations.lon_rad - np.radians(truth["lng"])) * 6_385_000.0 * np.cos(lat)
    enu = Rotation.from_quat(stations.aircraft_quaternion[:, [1, 2, 3, 0]]).inv()
    true = Rotation.from_euler("ZYX", truth[["yaw", "pitch", "roll"]].to_numpy(), degrees=True)
    turn = (true.inv() * Rotation.from_matrix(NED_FROM_ENU) * enu).as_rotvec(degrees=True)
    return {
        "horizontal": np.stack([north, east], axis=1),
        "height": (stations.h_msl_m - truth["alt_amsl"].to_numpy())[:, None],
        "tilt": turn[:, :2],
        "yaw": turn[:, 2:],
    }


def sigmas(stations: Stations) -> dict[str, np.ndarray]:
    return {
        "horizontal": stations.sigma_horizontal_m[:, None],
        "height": stations.sigma_height_m[:, None],
        "tilt": np.degrees(stations.sigma_tilt_rad)[:, None],
        "yaw": np.degrees(stations.sigma_yaw_rad)[:, None],
    }


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def gathered(flight: Flight, **options: int) -> tuple[dict, dict]:
    """Errors and sigmas of all events of a flight."""
    pairs = []
    for channel, truth in flight.events():
        stations = flight.stations(channel.time_ns, **options)
        assert stations.ok.all()
        pairs.append((errors(stations, truth), sigmas(stations)))
    return tuple(
        {name: np.concatenate([pair[k][name] for pair in pairs]) for name in pairs[0][k]}
        for k in (0, 1)
    )


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_positions_attitudes_and_their_sigmas(flights, name, kind) -> None:
    """Error over sigma: rms 0.7 to 1.2; the median sigma is at most twice the rms error."""
    error, sigma = gathered(flights[name, kind])
    position = np.hypot(np.linalg.norm(error["horizontal"], axis=1), error["height"][:, 0])
    assert np.percentile(position, 95) < 1.5
    assert np.percentile(np.linalg.norm(error["tilt"], axis=1), 95) < 0.5
    for what, stated in sigma.items():
        assert 0.7 < rms(error[what] / stated) < 1.2, what
        assert np.median(stated) < 2.0 * rms(error[what]), what


def flown_throughout(flight: Flight, simulated: Log) -> tuple[dict, dict]:
    """Errors and sigmas every second in the air, by the simulator's own rows."""
    sim, moved = (simulated.message(name) for name in ("SIM", "SIM2"))
    speed = np.interp(sim["TimeUS"], moved["TimeUS"], np.hypot(moved["VN"], moved["VE"]))
    rows = np.flatnonzero((speed > 12.0) & (sim["Alt"] > sim["Alt"][0] + 50.0))[::10]
    names = {
        "Lat": "lat",
        "Lng": "lng",
        "Alt": "alt_amsl",
        "Yaw": "yaw",
        "Pitch": "pitch",
        "Roll": "roll",
    }
    truth = pd.DataFrame({name: sim[column][rows] for column, name in names.items()})
    stations = flight.stations(sim["time_ns"][rows])
    assert len(stations) > 1000
    assert stations.ok.all()
    return errors(stations, truth), sigmas(stations)


@pytest.mark.parametrize(
    ("learnt", "tested", "kind"),
    [(*pair, kind) for pair in permutations(FLIGHTS, 2) for kind in ("BIN", "tlog")],
)
def test_what_one_flight_says_of_attitudes_holds_for_the_other(flights, learnt, tested, kind):
    """What no innovation shows is the one empirical part: by one flight, tested on the other."""
    parts = {"tilt": np.degrees(LEAST_TILT_RAD), "yaw": np.degrees(LEAST_YAW_RAD)}
    of_learnt = flown_throughout(flights[learnt, "BIN"], flights[learnt, "BIN"].log)
    of_tested = flown_throughout(flights[tested, kind], flights[tested, "BIN"].log)
    for what, stated in parts.items():
        error = of_learnt[0][what]
        sigma = of_learnt[1][what]
        square = np.mean(error**2) - np.mean(sigma**2 - stated**2)
        assert 0.8 * stated < np.sqrt(square) < 1.25 * stated  # the program's is of both
        error = of_tested[0][what]
        sigma = of_tested[1][what]
        predicted = np.sqrt(sigma**2 - stated**2 + square)
        for stated_sigma in (predicted, sigma):
            assert 0.7 < rms(error / stated_sigma) < 1.2, what
            assert np.median(stated_sigma) < 2.0 * rms(error), what


@pytest.mark.parametrize(
    ("name", "kind", "every"), [(*flown, every) for flown in FLOWN for every in (2, 3)]
)
def test_attitudes_at_5_and_3_hz_know_how_good_they_are(flights, name, kind, every) -> None:
    error, sigma = gathered(flights[name, kind], every=every)
    assert 0.7 < rms(error["tilt"] / sigma["tilt"]) < 1.2
    assert np.max(np.abs(error["tilt"] / sigma["tilt"])) < 4.5


def true_offset_ns(log: Log) -> tuple[float, float]:
    """UTC less time since boot [ns], by where the simulator had the aircraft of each fix.

    Returns it and the scatter of the fixes.
    """
    fix, sim, moved = (log.message(name) for name in ("GPS", "SIM", "SIM2"))
    new = np.append(True, np.diff(fix["GMS"].astype(np.int64)) != 0)
    use = np.flatnonzero(new & (fix["Status"] >= 3) & (fix["Spd"] > 10.0))
    at = fix["TimeUS"][use].astype(np.float64)
    scale = np.array([1.0, np.cos(np.radians(sim["Lat"][0]))]) * np.radians(6_376_000.0)
    apart, speed = np.empty((2, use.size, 2))
    for k, (place, axis) in enumerate((("Lat", "VN"), ("Lng", "VE"))):
        there = np.interp(at, sim["TimeUS"], sim[place])
        apart[:, k] = (fix[place][use] - there) * scale[k]
        speed[:, k] = np.interp(at, moved["TimeUS"], moved[axis])
    late_ns = -1e9 * (apart * speed).sum(axis=1) / (speed**2).sum(axis=1)
    utc = utc_of_gps(fix["GWk"][use], fix["GMS"][use] / 1e3)
    offset = utc - fix["TimeUS"][use].astype(np.int64) * 1000
    difference = (offset - offset[0]) + late_ns
    return int(offset[0]) + float(np.median(difference)), float(np.std(difference))


@pytest.mark.parametrize(("name", "kind"), FLOWN)
def test_exposures_in_true_utc_have_true_positions(flights, name, kind) -> None:
    """A camera with a GPS clock: within 0.5 m at 24 m/s, and within the sigma of UTC."""
    flight = flights[name, kind]
    offset_ns, scatter = true_offset_ns(flights[name, "BIN"].log)
    assert scatter < 2e6
    apart = []
    late = []
    for channel, truth in flight.events():
        true_utc = truth["TimeUS"].to_numpy() * 1000 + round(offset_ns)
        found = errors(flight.stations(true_utc), truth)["horizontal"]
        speed = np.hypot(truth["vn"], truth["ve"]).to_numpy()
        apart.append(np.linalg.norm(found, axis=1) / speed * 24.0)
        late.append((channel.time_ns - true_utc) * 1e-9)
    assert np.median(np.concatenate(apart)) < 0.1
    assert np.percentile(np.concatenate(apart), 95) < 0.5
    assert abs(np.median(np.concatenate(late))) < 1.5 * flight.log.utc_sigma_s
    assert flight.log.utc_sigma_s < 0.04


def delay_by_accelerations(log: Log) -> float:
    """Stamp less epoch of the fixes [s], by accelerations turned by the attitude and integrated.

    Receiver's velocities against them as the stamps go, both less their means over 3 s, which the
    error of the vertical does not reach. Accelerations pass a Butterworth filter of the second
    order, INS_ACCEL_FILTER, which delays them by sqrt(2) / (2 pi f).
    """
    fix, imu, turn = (log.message(name) for name in ("GPS", "IMU", "XKQ"))
    new = np.append(True, np.diff(fix["GMS"].astype(np.int64)) != 0)
    stamps = fix["TimeUS"][new] * 1e-6
    course = np.radians(fix["GCrs"][new])
    speed = fix["Spd"][new].astype(float)
    seen = np.stack([speed * np.cos(course), speed * np.sin(course)])
    attitude = Rotation.from_quat(np.stack([turn[f"Q{k}"] for k in (2, 3, 4, 1)], axis=1))
    known = Slerp(turn["TimeUS"] * 1e-6, attitude)
    at = imu["TimeUS"] * 1e-6
    rows = (imu["I"] == 0) & (at > known.times[0]) & (at < known.times[-1])
    at = at[rows]
    force = np.stack([imu[f"Acc{axis}"][rows] for axis in "XYZ"], axis=1)
    pushed = known(at).apply(force)[:, :2]
    gained = cumulative_trapezoid(pushed, at, axis=0, initial=0.0).T
    width = 2 * round(1.0 / np.median(np.diff(stamps))) + 1

    def quick(values: np.ndarray) -> np.ndarray:
        return values - uniform_filter1d(values, width, axis=1)

    delay = 0.1
    for _ in range(5):
        model, late, early = (
            np.stack([np.interp(stamps - delay + s, at, g) for g in gained])
            for s in (0.0, 0.02, -0.02)
        )
        left = quick(seen - model)
        slope = quick((late - early) / 0.04)
        fast = np.flatnonzero(speed > 8.0)[2 * width : -2 * width]
        delay -= float((left * slope)[:, fast].sum() / np.square(slope[:, fast]).sum())
    cut_off = dict(zip(log.message("PARM")["Name"], log.message("PARM")["Value"], strict=True))
    return delay + 2.0**0.5 / (2.0 * np.pi * float(cut_off["INS_ACCEL_FILTER"]))


@pytest.mark.parametrize("name", FLIGHTS)
def test_accelerations_give_the_clock_and_the_filters_positions_the_place(flights, name) -> None:
    """Why UTC goes with the filter's positions: an exposure in UTC is then nearer to its place.

    Accelerations find the true delay, which no tlog has rows enough for. The filter leads by what
    it takes the delay too large for; at the true time its positions are that far ahead.
    """
    flight = flights[name, "BIN"]
    stamps = flight.log.message("GPS")
    epoch = utc_of_gps(stamps["GWk"], stamps["GMS"] / 1e3)
    offset_ns, _ = true_offset_ns(flight.log)
    behind = stamps["TimeUS"].astype(np.int64) * 1000 + round(offset_ns) - epoch
    true_delay_s = (
        np.median(behind[np.append(True, np.diff(stamps["GMS"].astype(int)) != 0)]) * 1e-9
    )
    assert delay_by_accelerations(flight.log) == pytest.approx(true_delay_s, abs=0.005)
    ahead = []
    for channel, truth in flight.events():
        found = errors(flight.stations(channel.time_ns), truth)["horizontal"]
        speed = np.hypot(truth["vn"], truth["ve"]).to_numpy()
        ahead.append(np.linalg.norm(found, axis=1) / speed * 24.0)
    assert 0.2 < np.median(np.concatenate(ahead)) < 0.55  # by UTC of the positions: under 0.1


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_logs_of_a_flight_agree_about_utc(flights, name) -> None:
    both = [
        {
            (c.source.instance, i): t
            for c, _ in flights[name, kind].events()
            for i, t in zip(c["event_index"].tolist(), c.time_ns.tolist(), strict=True)
        }
        for kind in ("BIN", "tlog")
    ]
    apart = [both[0][key] - both[1][key] for key in both[0].keys() & both[1].keys()]
    assert len(apart) > 200
    assert np.max(np.abs(apart)) < 5e6


@pytest.mark.parametrize("name", FLIGHTS)
def test_the_delay_leaves_exposures_and_positions_of_the_filter_together(flights, name) -> None:
    log = flights[name, "BIN"].log
    for message in ("CAM", "POS", "ATT"):
        channels = [c for c in log.channels if c.source.message == message]
        stamps = log.message(message)
        boot_us = np.sort(np.unique(stamps["TimeUS"].astype(np.int64)))
        utc = np.sort(np.unique(np.concatenate([c.time_ns for c in channels])))
        offset = np.unique(utc - boot_us * 1000)
        assert offset.size == 1
        assert (
            offset[0]
            == log.message("GPS")["time_ns"][0] - int(log.message("GPS")["TimeUS"][0]) * 1000
        )
    fixes = log.channel("GPS[0]")
    rows = np.isin(log.message("GPS")["time_ns"], fixes.time_ns)
    assert not rows.any()  # a fix has the time of its epoch, not that of its row


def test_a_sigma_of_the_time_moves_along_the_track_and_the_turn(flights) -> None:
    flight = flights["sitl_survey", "BIN"]
    channel, truth = flight.events()[0]
    sure, late = (flight.stations(channel.time_ns, sigma_s=s) for s in (0.0, 0.1))
    added = np.sqrt(2.0 * (late.sigma_horizontal_m**2 - sure.sigma_horizontal_m**2))
    speed = np.hypot(truth["vn"], truth["ve"])
    np.testing.assert_allclose(added, 0.1 * speed, rtol=0.05)
    up = np.sqrt(late.sigma_height_m**2 - sure.sigma_height_m**2)
    assert np.corrcoef(up, np.abs(truth["vd"]))[0, 1] > 0.95
    turned = late.sigma_yaw_rad > 1.2 * sure.sigma_yaw_rad
    assert 0 < turned.sum() < turned.size
