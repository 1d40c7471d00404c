"""Logs of ArduPilot's simulator in ../shared/logs, with the truth of their exposures."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import rotation_of
from tests.logs import REAL
from unbend.flight.channels import Channel
from unbend.flight.evidence.log_accuracy import with_accuracy
from unbend.flight.exposures import Events
from unbend.flight.heights import height_system
from unbend.flight.mount import Mount
from unbend.flight.station_builder import build_stations
from unbend.ingest import Log, open_log
from unbend.simulate import optics

FLIGHTS = [path.name.removesuffix("_truth.csv") for path in sorted(REAL.glob("*_truth.csv"))]
"""The flights that are at hand."""

NED_FROM_ENU = Rotation.from_matrix(optics.NED_FROM_ENU)


@dataclass(frozen=True)
class Flight:
    """A log, and a row for each exposure in the order of time.

    A row has the time that the log gives the exposure (time_ns), and where the simulator had the
    aircraft: degrees, metres and metres a second.
    """

    log: Log
    truth: pd.DataFrame

    @property
    def time_ns(self):
        return self.truth["time_ns"].to_numpy()


def flight(name, kind="BIN"):
    """The log of a kind, BIN or tlog, of a flight."""
    log = open_log(REAL / f"{name}.{kind}")
    rows = pd.read_csv(REAL / f"{name}_truth.csv")
    events = rows[rows["row"] == "CAM"]
    events = events.set_index(["I", "Img"], drop=False)
    parts = []
    for channel in log.channels:
        if channel.source.message not in ("CAM", "CAMERA_FEEDBACK"):
            continue
        camera = int(channel.source.instance)
        images = [(camera, int(index)) for index in channel["event_index"]]
        exposures = events.loc[images]
        parts.append(exposures.assign(time_ns=channel.time_ns))
    truth = pd.concat(parts)
    return Flight(log, truth.sort_values("time_ns"))


def unnamed_events(time_ns, sigma_s=0.0):
    """Exposures at these times, of no image."""
    images = np.full(time_ns.size, "", object)
    return Events("cam", images, time_ns, sigma_s)


def stations_by(
    roles: Mapping[str, Channel],
    channels,
    events,
    max_gap_s,
):
    """The stations of events by these channels in their roles, with what the log says of errors."""
    heights, _ = height_system(roles, None)
    accurate, accuracy = with_accuracy(roles, channels)
    return build_stations(
        events,
        accurate,
        Mount(),
        heights,
        max_gap_s,
        accuracy=accuracy,
    )


def errors(stations, truth):
    """(n, k) north and east, height [m], about the level axes and the vertical one [deg]."""
    latitude = np.radians(truth["lat"].to_numpy())
    longitude = np.radians(truth["lng"].to_numpy())
    parallel_m = 6_385_000.0 * np.cos(latitude)
    north_m = (stations.lat_rad - latitude) * 6_367_000.0
    east_m = (stations.lon_rad - longitude) * parallel_m
    height_m = stations.h_msl_m - truth["alt_amsl"].to_numpy()
    quaternion = np.nan_to_num(stations.aircraft_quaternion, nan=0.5)
    enu_from_body = rotation_of(quaternion).inv()
    angles_deg = truth[["yaw", "pitch", "roll"]].to_numpy()
    ned_from_body = Rotation.from_euler(
        "ZYX",
        angles_deg,
        degrees=True,
    )
    turn = ned_from_body.inv() * NED_FROM_ENU * enu_from_body
    turn_deg = turn.as_rotvec(degrees=True)
    return {
        "horizontal": np.stack([north_m, east_m], axis=1),
        "height": height_m[:, None],
        "tilt": turn_deg[:, :2],
        "yaw": turn_deg[:, 2:],
    }


def sigmas(stations):
    """(n, 1) of the same."""
    return {
        "horizontal": stations.sigma_horizontal_m[:, None],
        "height": stations.sigma_height_m[:, None],
        "tilt": np.degrees(stations.sigma_tilt_rad)[:, None],
        "yaw": np.degrees(stations.sigma_yaw_rad)[:, None],
    }
