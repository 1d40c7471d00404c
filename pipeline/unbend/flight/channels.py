"""The contents of a log as columns in SI units: the only thing that leaves `ingest`."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere.rejection import Reason, Reasons, RemovedSamples, with_reason
from unbend.units import Array, Mask

TimeArray = NDArray[np.int64]

ROLE_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "position": ("lat_rad", "lon_rad"),
    "height": ("lat_rad", "lon_rad"),
    "attitude": ("q_w", "q_x", "q_y", "q_z"),
    "aircraft_attitude": ("q_w", "q_x", "q_y", "q_z"),
    "pressure": ("pressure_pa",),
    "temperature": ("temperature_k",),
    "humidity": ("relative_humidity",),
    "airspeed": ("airspeed_m_s",),
    "cabin_pressure": ("pressure_pa",),
    "cabin_temperature": ("temperature_k",),
    "cabin_humidity": ("relative_humidity",),
    "events": ("event_index",),
}
"""Roles that a channel can play, and the columns that it needs for each."""

_INTERVALS_OF_A_GAP = 3.0  # median intervals: a channel that misses two samples has a gap

# Columns that show the state of the autopilot and its filter, and measure neither flight nor air.
_HEALTH_COLUMNS = {
    "innovation_velocity",
    "innovation_position",
    "innovation_height",
    "innovation_compass",
    "filter_flags",
    "filter_timeouts",
    "filter_faults",
    "vibration_m_s2",
    "clipping",
    "landed",
    "landed_state",
    "flying",
    "home_h_msl_m",
    "rate_x_rad_s",
    "rate_y_rad_s",
    "rate_z_rad_s",
}


def plain_name(message: str) -> str:
    """The name of a message in capitals, without underscores and path: PX4 writes it in two ways.

    >>> plain_name("px4_msgs/GimbalV1"), plain_name("gimbal_v1")
    ('GIMBALV1', 'GIMBALV1')
    """
    return message.rpartition("/")[2].replace("_", "").upper()


@dataclass(frozen=True)
class Source:
    """The sender of the messages of a channel. ``None`` where the format has no such notion."""

    message: str
    instance: str | None = None
    system: int | None = None
    component: int | None = None

    @property
    def kind(self) -> str:
        """The `plain_name` of the message, which is the same in all formats.

        >>> Source("px4_msgs/CameraCapture").kind, Source("camera_capture").kind
        ('CAMERACAPTURE', 'CAMERACAPTURE')
        """
        return plain_name(self.message)


@dataclass(frozen=True, eq=False)
class Channel:
    """One series of measurements from one source.

    name : the word the config takes, for example ``BARO[1]`` or ``/cabin/pressure``.
    time_ns : (n,) UTC, Unix nanoseconds, strictly increasing.
    columns : (n,) arrays by name, SI and radians, NaN where unknown.
    source : the sender.
    boot : (n,) which power-up of the vehicle each sample belongs to, from 0.
    roles : the roles it may take without being named in the config, best first.
    rank : the smaller, the sooner it is chosen among candidates for a role.
    labels : strings that belong to the samples, such as image names.
    logged_units : by column, the unit of the log that was converted; SI where a column has none.
    rejected : by column, (n,) the reason why an impossible value was replaced by NaN; 0 elsewhere.
        Counted in the ledger when the log was read.
    removed : samples that were taken out of the channel, and why.

    Columns in use: lat_rad, lon_rad, h_msl_m, h_gnss_m (above sea level, by the receiver alone),
    h_ellipsoid_m, h_home_m, east_m, north_m, up_m (local); v_north_m_s, v_east_m_s, v_down_m_s;
    q_w, q_x, q_y, q_z (v_ned = R(q) v_body, body forward, right, down); rate_x_rad_s, rate_y_rad_s,
    rate_z_rad_s (about the body's forward, right and down axis); pressure_pa, board_temperature_k,
    temperature_k, relative_humidity (0-1), airspeed_m_s; event_index, sigma_time_s (of an event
    whose time is not logged exactly), roll_rad, pitch_rad, yaw_rad; yaw_in_body_rad (of a gimbal);
    value (of a named value, in the mission file's unit); feedback (1 of a shutter's pulse, 0 of a
    trigger's command); landed, flying (1 or 0), landed_state (MAV_LANDED_STATE), home_h_msl_m.

    Of a receiver: fix (GPS_FIX_TYPE of MAVLink: 3 is 3D, 6 RTK fixed), satellites, hdop, sigma_h_m
    (of one horizontal axis), sigma_v_m, sigma_speed_m_s; gps_week (may count modulo 1024) and
    gps_week_s, the epoch of the row in GPS time. Of a filter: innovation_velocity,
    innovation_position, innovation_height, innovation_compass (largest innovation over the gate:
    above 1 it is rejected); filter_flags (bits 0 to 9 are MAVLink's EKF_STATUS_FLAGS in all
    formats, 10 never healthy, 15 GPS glitch, 18 dead reckoning); filter_timeouts and filter_faults
    (bits of ArduPilot's XKF4.TS and FS); vibration_m_s2 (of the worst axis), clipping (count since
    boot). The texts of an autopilot are a channel without columns: the label ``text`` of a row has
    all lines of its time.
    """

    name: str
    time_ns: TimeArray
    columns: Mapping[str, Array]
    source: Source
    boot: NDArray[np.int16] = field(default_factory=lambda: np.empty(0, np.int16))
    roles: tuple[str, ...] = ()
    rank: int = 50
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    logged_units: Mapping[str, str] = field(default_factory=dict)
    rejected: Mapping[str, Reasons] = field(default_factory=dict)
    removed: RemovedSamples = field(default_factory=RemovedSamples)

    def __post_init__(self) -> None:
        n = self.time_ns.shape[0]
        if self.time_ns.dtype != np.int64 or self.time_ns.ndim != 1:
            raise TypeError(f"channel {self.name}: time_ns must be a vector of int64")
        if n > 1 and not bool(np.all(self.time_ns[1:] > self.time_ns[:-1])):
            raise ValueError(f"channel {self.name}: time_ns must increase strictly")
        if self.boot.shape[0] == 0 and n:
            object.__setattr__(self, "boot", np.zeros(n, np.int16))
        for arrays in (self.columns, self.rejected):
            for name, values in arrays.items():
                if values.shape != (n,):
                    raise ValueError(f"channel {self.name}: {name} is {values.shape}, not ({n},)")

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def __repr__(self) -> str:
        """Name, size and rate of the channel, and its columns."""
        columns = ", ".join(sorted(self.columns))
        return f"<Channel {self.name}: {len(self)} samples, {self.rate_hz:.3g} Hz; {columns}>"

    def __getitem__(self, column: str) -> Array:
        return self.columns[column]

    @property
    def is_evidence(self) -> bool:
        """Whether the channel only shows how good others are: health of a filter, texts."""
        return not self.roles and self.columns.keys() <= _HEALTH_COLUMNS

    def get(self, column: str) -> Array:
        """(n,) values of a column; all NaN if the channel does not have it."""
        return self.columns.get(column, np.full(len(self), np.nan))

    def fits_role(self, role: str) -> bool:
        """Whether the channel has all columns that a role needs (`ROLE_COLUMNS`)."""
        return all(column in self.columns for column in ROLE_COLUMNS[role])

    @property
    def height_column(self) -> str | None:
        """The name of the column of heights: above sea level if any is known, else ellipsoidal.

        None if the channel has neither.
        """
        if np.isfinite(self.columns.get("h_msl_m", np.nan)).any():
            return "h_msl_m"
        if "h_ellipsoid_m" in self.columns:
            return "h_ellipsoid_m"
        return None

    @property
    def rate_hz(self) -> float:
        """Median sampling rate [1/s]; 0 with fewer than two samples."""
        if len(self) < 2:
            return 0.0
        return 1.0 / self._median_interval_s

    def gap_limit_s(self, max_gap_s: float = 1.0) -> float:
        """The longest interval between two samples that does not count as a gap [s].

        That is ``max_gap_s``, or three median intervals of the channel if those are longer.
        """
        if len(self) < 2:
            return max_gap_s
        return max(max_gap_s, _INTERVALS_OF_A_GAP * self._median_interval_s)

    @cached_property
    def _median_interval_s(self) -> float:
        """The median interval between samples [s], of a channel with two samples or more."""
        return float(np.median(np.diff(self.time_ns))) * 1e-9

    def rows(self, keep: Mask) -> "Channel":
        """The channel with only the samples for which ``keep`` (n,) is True."""
        return replace(
            self,
            time_ns=self.time_ns[keep],
            boot=self.boot[keep],
            columns={name: values[keep] for name, values in self.columns.items()},
            labels={name: tuple(compress(texts, keep)) for name, texts in self.labels.items()},
            rejected={name: reasons[keep] for name, reasons in self.rejected.items()},
        )

    def without(self, reasons: Reasons) -> "Channel":
        """The channel without the samples that are not to be used; those go to ``removed``.

        ``reasons`` : (n,) `Reason` of each sample; samples of `Reason.USED` stay.
        """
        is_removed = reasons != Reason.USED
        if not is_removed.any():
            return self
        removed = self.removed.and_also(self.time_ns[is_removed], reasons[is_removed])
        return replace(self.rows(~is_removed), removed=removed)

    def with_impossible(self, column: str, is_impossible: Mask, reason: Reason) -> "Channel":
        """The channel with the impossible values of a column replaced by NaN.

        ``rejected`` gets the reason for them; a value that has a reason keeps it.
        """
        values = np.where(is_impossible, np.nan, self.columns[column])
        earlier_reasons = self.rejected.get(column, np.zeros(len(self), np.uint8))
        reasons = with_reason(earlier_reasons, is_impossible, reason)
        return replace(
            self,
            columns=dict(self.columns) | {column: values},
            rejected=dict(self.rejected) | {column: reasons},
        )

    def to_pandas(self) -> Any:
        """The channel as a pandas DataFrame, indexed by time.

        The index is UTC; in boots without UTC it is the time since boot, counted from 1970.
        """
        import pandas as pd

        index = pd.DatetimeIndex(pd.to_datetime(self.time_ns, utc=True), name="time_utc")
        return pd.DataFrame(dict(self.columns) | dict(self.labels), index=index)
