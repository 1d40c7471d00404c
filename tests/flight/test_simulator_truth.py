"""Stations, their sigmas and UTC against the truth of ArduPilot's simulator.

Truth: where the simulator had the aircraft at each event (`*_truth.csv`, rows SIM and SIM2), and
the GPS week and milliseconds of fixes, whose places are compared with the simulator's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.flight.channels import Channel
from pipeline.flight.clock import utc_of_gps
from pipeline.flight.evidence.log_accuracy import with_accuracy
from pipeline.flight.exposures import Events
from pipeline.flight.heights import height_system
from pipeline.flight.mount import Mount
from pipeline.flight.roles import assign_roles
from pipeline.flight.station_builder import build_stations
from pipeline.flight.stations import Stations
from pipeline.ingest import Log, open_log

LOGS = Path(__file__).parents[3] / "shared" / "logs"
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")
FLIGHTS = ["sitl_survey", "sitl_belowsea_2cam"]
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
            thin, time_ns=thin.time_ns[::every], boot=thin.boot[::every],
            columns={name: values[::every] for name, values in thin.columns.items()},
        )  # fmt: skip
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


@pytest.mark.parametrize("kind", ["BIN", "tlog"])
@pytest.mark.parametrize("name", FLIGHTS)
def test_positions_attitudes_and_their_sigmas(flights, name, kind) -> None:
    """Error over sigma: rms 0.7 to 1.2; the median sigma is at most twice the rms error."""
    error, sigma = gathered(flights[name, kind])
    position = np.hypot(np.linalg.norm(error["horizontal"], axis=1), error["height"][:, 0])
    assert np.percentile(position, 95) < 1.5
    assert np.percentile(np.linalg.norm(error["tilt"], axis=1), 95) < 0.5
    for what, stated in sigma.items():
        assert 0.7 < rms(error[what] / stated) < 1.2, what
        assert np.median(stated) < 2.0 * rms(error[what]), what


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("kind", ["BIN", "tlog"])
@pytest.mark.parametrize("name", FLIGHTS)
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


@pytest.mark.parametrize("kind", ["BIN", "tlog"])
@pytest.mark.parametrize("name", FLIGHTS)
def test_exposures_in_true_utc_have_true_positions(flights, name, kind) -> None:
    """A camera with a GPS clock: within 0.5 m at 24 m/s, and within the sigma of UTC."""
    flight = flights[name, kind]
    offset_ns, scatter = true_offset_ns(flights[name, "BIN"].log)
    assert scatter < 2e6
    apart, late = [], []
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


@pytest.mark.parametrize("name", FLIGHTS)
def test_both_logs_of_a_flight_agree_about_utc(flights, name) -> None:
    both = [
        {(c.source.instance, i): t for c, _ in flights[name, kind].events()
         for i, t in zip(c["event_index"].tolist(), c.time_ns.tolist(), strict=True)}
        for kind in ("BIN", "tlog")
    ]  # fmt: skip
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
        assert offset[0] == log.message("GPS")["time_ns"][0] - int(
            log.message("GPS")["TimeUS"][0]
        ) * 1000  # fmt: skip
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
