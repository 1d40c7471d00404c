"""Files of the simulated flight, as other programs write them, and how far stations are from it."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from unbend.simulate.flight import UNDULATION_M

CAMERAS = ("nadir", "oblique")
NEAR_M = 0.15  # events are 1.6 ms off by the clock of the log, at 70 m/s
GPS_EPOCH = pd.Timestamp("1980-01-06", tz="UTC")
LEAP_S = 18.0
WEEK_S = 604_800
WANDER_RAD = 0.03
METRES_OF_A_DEGREE = 111_195.0

POS_HEAD = """\
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,5:single,ns=# of satellites)
%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) \
age(s) ratio
"""


def gps_time(utc):
    """Weeks, and seconds in the week."""
    since_s = (utc - GPS_EPOCH).dt.total_seconds() + LEAP_S
    week, seconds = divmod(since_s, WEEK_S)
    return week.astype(int), seconds


class Files:
    """Writes files of the true flight beside a mission; returns their sections of its file."""

    def __init__(self, mission, stations, flight):
        self.folder = mission.folder
        self.stations = stations
        self.flight = flight
        self.t = np.arange(1.0, flight.duration_s - 1.0, 0.2)
        first = stations["time_utc"].min()
        self.start = first - pd.Timedelta(seconds=flight.exposure_s.min())

    @property
    def second_exposure_s(self):
        return np.sort(self.flight.exposure_s)[1]

    def near_second_exposure(self, seconds):
        """Which rows of a file lie this near to an exposure of both cameras."""
        return np.abs(self.t - self.second_exposure_s) < seconds

    def utc(self, later_s=0.0):
        elapsed = pd.to_timedelta(self.t + later_s, unit="s")
        return pd.Series(self.start + elapsed)

    def week(self):
        weeks, _ = gps_time(self.utc())
        return int(weeks[0])

    def stations_of(self, camera):
        return self.stations.query("camera == @camera").sort_values("time_utc")

    def pos(self, *, late_s=0.0, quality=1, shift_m=0.0, up_m=0.0):
        """Positions of RTKLIB: some seconds late, some metres to the north and up."""
        state = self.flight.at(self.t)
        time = self.utc(LEAP_S + late_s)
        rows = pd.DataFrame(
            {
                "time": time.dt.strftime("%Y/%m/%d %H:%M:%S.%f"),
                "lat": np.degrees(state.lat_rad) + shift_m / METRES_OF_A_DEGREE,
                "lon": np.degrees(state.lon_rad),
                "height": state.h_msl_m + UNDULATION_M + up_m,
                "quality": quality,
            }
        )
        text = POS_HEAD
        for row in rows.itertuples():
            text += f"{row.time} {row.lat:.9f} {row.lon:.9f} {row.height:.4f} {row.quality}"
            text += " 12 0.0110 0.0070 0.0210 0 0 0 0.0 9.9\n"
        (self.folder / "flight.pos").write_text(text)
        return {"path": "flight.pos", "point": "imu"}

    def sbet(self, *, yaw_deg=0.0):
        """Positions and attitudes of Applanix, with a wander angle."""
        state = self.flight.at(self.t)
        later = self.flight.at(self.t + 0.01)
        before = self.flight.at(self.t - 0.01)
        north = (later.lat_rad - before.lat_rad) / 0.02 * 6.375e6
        radius_m = 6.39e6 * np.cos(state.lat_rad)
        east = (later.lon_rad - before.lon_rad) / 0.02 * radius_m
        velocity = (north - 1j * east) * np.exp(-1j * WANDER_RAD)
        yaw = state.yaw_rad + WANDER_RAD + np.radians(yaw_deg)
        rows = np.zeros((self.t.size, 17), "<f8")
        _, rows[:, 0] = gps_time(self.utc())
        rows[:, 1] = state.lat_rad
        rows[:, 2] = state.lon_rad
        rows[:, 3] = state.h_msl_m + UNDULATION_M
        rows[:, 4] = velocity.real
        rows[:, 5] = velocity.imag
        rows[:, 7] = state.roll_rad
        rows[:, 8] = state.pitch_rad
        rows[:, 9] = (yaw + np.pi) % (2.0 * np.pi) - np.pi
        rows[:, 10] = WANDER_RAD
        rows.tofile(self.folder / "sbet.out")
        return {
            "path": "sbet.out",
            "point": "imu",
            "heights": "ellipsoid",
            "time": {"system": "gpst"},
        }

    def table(self):
        """Positions above the sea, and angles in degrees."""
        state = self.flight.at(self.t)
        return pd.DataFrame(
            {
                "latitude": np.degrees(state.lat_rad),
                "longitude": np.degrees(state.lon_rad),
                "height": state.h_msl_m,
                "roll": np.degrees(state.roll_rad),
                "pitch": np.degrees(state.pitch_rad),
                "yaw": np.degrees(state.yaw_rad) % 360.0,
            }
        )

    def csv(self, table):
        """A table whose rows are those of `table`, or some of them."""
        time = self.utc()[table.index]
        timed = table.assign(time=time.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ"))
        timed.to_csv(
            self.folder / "t.csv",
            index=False,
            float_format="%.9f",
        )
        return {
            "path": "t.csv",
            "point": "imu",
            "heights": "msl",
            "time": {"system": "utc"},
            "columns": {name: name for name in timed.columns},
        }

    def mrk(self, camera, *, offset_mm=(0, 0, 0), rows=slice(None), numbers=None):
        """Exposures of a camera of DJI: some rows of them, with other numbers than their own."""
        exposures = self.stations_of(camera)
        weeks, seconds = gps_time(exposures["time_utc"])
        exposures["week"] = weeks
        exposures["seconds"] = seconds
        exposures["number"] = range(1, len(exposures) + 1)
        written = exposures.iloc[rows].copy()
        if numbers is not None:
            written["number"] = numbers
        offsets_mm = np.broadcast_to(offset_mm, (len(written), 3))
        text = ""
        for row, (north, east, down) in zip(written.itertuples(), offsets_mm, strict=True):
            text += f"{row.number}\t{row.seconds:.6f}\t[{row.week}]\t"
            text += f"{north},N\t{east},E\t{down},V\t"
            text += f"{row.lat_deg:.9f},Lat\t{row.lon_deg:.9f},Lon\t{row.h_ellipsoid_m:.4f},Ellh\t"
            text += "0.012, 0.016, 0.031\t50,Q\n"
        (self.folder / f"{camera}.MRK").write_text(text)


class Errors(NamedTuple):
    """Largest errors of stations that are ok."""

    place_m: float
    height_m: float
    attitude_deg: float


def offsets(stations, true):
    """(n, 3) north, east, up [m] of stations from the true ones."""
    north = (stations.lat_rad - np.radians(true["lat_deg"])) * 6.37e6
    east = (stations.lon_rad - np.radians(true["lon_deg"])) * 4.32e6
    up = stations.h_ellipsoid_m - true["h_ellipsoid_m"]
    return np.stack([north, east, up], axis=1)


def errors(prepared, files):
    stations = prepared.stations
    ok = stations.ok
    assert ok.any()
    true = files.stations.loc[stations.image.tolist()]
    north, east, up = offsets(stations, true)[ok].T
    quaternion = true[["q_w", "q_x", "q_y", "q_z"]].to_numpy()
    cosine = np.sum(quaternion * stations.quaternion, axis=1)[ok]
    half_turn_rad = np.arccos(np.abs(cosine).clip(0.0, 1.0))
    return Errors(
        place_m=np.hypot(north, east).max(),
        height_m=np.abs(up).max(),
        attitude_deg=2.0 * np.degrees(half_turn_rad).max(),
    )


def assert_true(prepared, files):
    """The stations are those of the flight, as well as the clock of the log allows."""
    off = errors(prepared, files)
    assert off.place_m < NEAR_M
    assert off.height_m < 0.05
    assert off.attitude_deg < 0.02
