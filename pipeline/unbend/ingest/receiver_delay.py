"""The delay of a GNSS receiver: an autopilot stamps a fix 80 to 220 ms after its epoch.

UTC comes from these stamps, so until here it is late for everything but the fixes themselves. The
positions of the autopilot's filter already allow for it, and move along the axis of UTC.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.trajectory import interpolate
from unbend.geodesy import principal_radii, wrapped
from unbend.ingest.flight_log import Contents
from unbend.ingest.message_tables import Table
from unbend.messages import Ledger
from unbend.units import Array

_RECEIVERS = ("GPS", "GPS2", "GPS_RAW_INT", "GPS2_RAW", "sensor_gps", "vehicle_gps_position")
_FUSED = ("POS", "GLOBAL_POSITION_INT", "vehicle_global_position")

# The settings of the first and of a second receiver [ms]: ArduPilot's since 4.6 and before, PX4's.
_SETTINGS = (
    ("GPS1_DELAY_MS", "GPS_DELAY_MS", "EKF2_GPS_DELAY"),
    ("GPS2_DELAY_MS", "GPS_DELAY_MS2", "EKF2_GPS_DELAY"),
)
# AP_GPS_UBLOX::get_lag: 0.12 s for u-blox 7 and later by their hardware, 0.22 s for all others.
_LATER_UBLOX = re.compile(r"u-blox \d+ HW: 0*(7|8|A|19)0000\b")
_DELAY_OF_LATER_S, _DELAY_OF_OTHERS_S = 0.12, 0.22

STATED_SIGMA_S = 0.04  # of the delay by its setting, or by what the driver takes for granted
UNKNOWN_SIGMA_S = 0.15  # without a setting and an estimate nothing is applied; 0.22 s are reached
# A filter that allows for a wrong delay leads or lags by the difference, which the estimate takes
# up: 11 and 21 ms on the logs of ArduPilot's simulator.
_FILTER_SIGMA_S = 0.015
_LARGEST_DELAY_S = 0.5
_LEAST_DELAY_S = 0.005  # receivers need more; positions that are closer are stamped at their epoch
_LEAST_ROWS, _LEAST_SPEED_M_S = 100, 2.0
MOST_ROWS = 10_000  # more are thinned evenly


@dataclass(frozen=True)
class ReceiverDelay:
    """Stamp minus epoch of the fixes of a receiver [s], its sigma [s], and where it comes from."""

    delay_s: float
    sigma_s: float
    origin: str


def with_receiver_delay(contents: Contents, ledger: Ledger) -> Contents:
    """The contents with all times in UTC: later by the delay, but for fixes, which get their epoch.

    Logs without a receiver of an autopilot, or stamped in UTC, are returned as they are.
    """
    fixes = [c for c in contents.channels if c.source.message in _RECEIVERS and len(c)]
    if not fixes:
        return contents
    fused = [c for c in contents.channels if c.source.message in _FUSED]
    texts = [text for c in contents.channels for text in c.labels.get("text", ())]
    delays = {}
    for channel in fixes:
        same_system = [c for c in fused if c.source.system == channel.source.system]
        estimates = (estimated_delay(channel, c) for c in same_system)
        known = next((estimate for estimate in estimates if estimate is not None), None)
        delays[channel.name] = known or stated_delay(channel, contents.parameters, texts)
    first = max(fixes, key=len)  # UTC is from the receiver with the most rows
    utc = delays[first.name]
    what = f"UTC is accurate to {utc.sigma_s * 1e3:.0f} ms (1 sigma): fixes are stamped"
    what += f" {utc.delay_s * 1e3:.0f} ms after their epoch, {utc.origin}"
    ledger.note("TIME-FIT", what, where=first.name, count=len(first))
    later_ns = round(utc.delay_s * 1e9)

    def moved(channel: Channel) -> Channel:
        shift_ns = later_ns if channel.source.system == first.source.system else 0
        if channel.name in delays:
            shift_ns -= round(delays[channel.name].delay_s * 1e9)
        return replace(channel, time_ns=channel.time_ns + shift_ns) if shift_ns else channel

    inner = contents.table

    def table(name: str, instance: str | None) -> Table:
        columns = inner(name, instance) if inner else {}
        if "time_ns" in columns:
            columns["time_ns"] = columns["time_ns"] + later_ns
        return columns

    channels = tuple(moved(channel) for channel in contents.channels)
    return replace(contents, channels=channels, table=inner and table, utc_sigma_s=utc.sigma_s)


def stated_delay(
    receiver: Channel, parameters: Mapping[str, float], texts: Iterable[str]
) -> ReceiverDelay:
    """The delay by the autopilot's setting; 0 stands for what the driver of the receiver takes."""
    second = "2" in receiver.source.message or receiver.source.instance not in (None, "0")
    for name in _SETTINGS[second]:
        value = parameters.get(name, float("nan"))
        if 0.0 < value < _LARGEST_DELAY_S * 1e3:
            return ReceiverDelay(value / 1e3, STATED_SIGMA_S, f"by {name}")
        if value == 0.0:
            later = any(_LATER_UBLOX.search(text) for text in texts)
            delay = _DELAY_OF_LATER_S if later else _DELAY_OF_OTHERS_S
            return ReceiverDelay(delay, STATED_SIGMA_S, f"by the receiver's driver ({name} is 0)")
    origin = "for want of a setting or of positions of a filter to compare them with"
    return ReceiverDelay(0.0, UNKNOWN_SIGMA_S, origin)


def estimated_delay(receiver: Channel, fused: Channel) -> ReceiverDelay | None:
    """The delay of fixes behind the positions of the filter that follows them, both as stamped.

    Fixes lie behind by the speed times the delay: the median of all rows in fast flight; None where
    they are few or do not agree. Accuracy against the truth of two simulator flights: 1 ms for the
    positions of the filter, which themselves lead by 11 and 21 ms.
    """
    limit = fused.gap_limit_s()

    def places(time_ns: TimeArray) -> Array:
        names = ("lat_rad", "lon_rad")
        return np.stack([interpolate(fused, name, time_ns, limit) for name in names])

    every = slice(None, None, max(len(receiver) // MOST_ROWS, 1))  # memory has its peak here
    time_ns = receiver.time_ns[every]
    fixes = np.stack([receiver["lat_rad"][every], receiver["lon_rad"][every]])
    latitude = float(np.nanmedian(fixes[0]))
    meridian, prime_vertical = principal_radii(latitude)
    scale = np.array([[float(meridian)], [float(prime_vertical) * np.cos(latitude)]])
    delay_s, half_ns = 0.1, round(2.5e8)
    for _ in range(4):
        at = time_ns - round(delay_s * 1e9)
        apart = wrapped(fixes - places(at)) * scale
        speed = wrapped(places(at + half_ns) - places(at - half_ns)) * scale / (2e-9 * half_ns)
        square = (speed**2).sum(axis=0)
        known = np.isfinite(square) & np.isfinite(apart).all(axis=0)
        if np.count_nonzero(known) < _LEAST_ROWS:
            return None
        fast = max(_LEAST_SPEED_M_S, 0.5 * float(np.sqrt(np.percentile(square[known], 90.0))))
        known &= square > fast**2
        if np.count_nonzero(known) < _LEAST_ROWS:
            return None
        behind = -(apart * speed).sum(axis=0)[known] / square[known]
        delay_s += float(np.median(behind))
    scatter = 1.4826 * float(np.median(np.abs(behind - np.median(behind))))
    # What is left between filter and receiver lasts some 5 s.
    rate_hz = receiver.rate_hz / every.step
    independent = behind.size * min(1.0, 1.0 / max(5.0 * rate_hz, 1.0))
    sigma_s = 1.2533 * scatter / np.sqrt(independent)
    if sigma_s > _FILTER_SIGMA_S or not -_LEAST_DELAY_S < delay_s < _LARGEST_DELAY_S:
        return None
    what = f"estimated from {behind.size} of them against {fused.name}"
    applied_s = delay_s if delay_s > _LEAST_DELAY_S else 0.0
    return ReceiverDelay(applied_s, float(np.hypot(sigma_s, _FILTER_SIGMA_S)), what)
