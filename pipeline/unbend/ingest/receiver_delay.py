"""The delay of a GNSS receiver: an autopilot stamps a fix 80 to 220 ms after its epoch.

The UTC of a log is fitted to these stamps. Before this module corrects it, all times but those of
the fixes are too early by the delay. The positions of the autopilot's filter already allow for the
delay: they are corrected like all other channels.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.interpolation import interpolate
from unbend.geodesy import principal_radii, wrapped
from unbend.ingest import messages
from unbend.ingest.flight_log import Contents
from unbend.ingest.message_tables import Table
from unbend.ingest.utc_evidence import UNCHECKED_SIGMA_S, ClockAssessment
from unbend.messages import Ledger, Message
from unbend.units import Array

_RECEIVERS = ("GPS", "GPS2", "GPS_RAW_INT", "GPS2_RAW", "sensor_gps", "vehicle_gps_position")
_FUSED = ("POS", "GLOBAL_POSITION_INT", "vehicle_global_position")

# The settings of the delay [ms]: ArduPilot's since 4.6 and before, PX4's.
_SETTINGS_OF_FIRST = ("GPS1_DELAY_MS", "GPS_DELAY_MS", "EKF2_GPS_DELAY")
_SETTINGS_OF_SECOND = ("GPS2_DELAY_MS", "GPS_DELAY_MS2", "EKF2_GPS_DELAY")

# AP_GPS_UBLOX::get_lag: u-blox 7 and later by their hardware, and all others.
_LATER_UBLOX = re.compile(r"u-blox \d+ HW: 0*(7|8|A|19)0000\b")
_DELAY_OF_LATER_S = 0.12
_DELAY_OF_OTHERS_S = 0.22

STATED_SIGMA_S = 0.04  # of the delay by its setting, or by what the driver takes for granted
UNKNOWN_SIGMA_S = 0.15  # without a setting and an estimate nothing is applied; 0.22 s are reached
# A filter that allows for a wrong delay leads or lags by the difference, which the estimate takes
# up: 11 and 21 ms on the logs of ArduPilot's simulator.
_FILTER_SIGMA_S = 0.015
_LARGEST_MEDIAN_SIGMA_S = 0.015  # more means that the rows do not have one common delay
_LARGEST_DELAY_S = 0.5
_LEAST_DELAY_S = 0.005  # receivers need more; positions that are closer are stamped at their epoch
_LEAST_ROWS = 100  # in fast flight; the median of fewer is too uncertain
_LEAST_SPEED_M_S = 2.0  # below, the noise of the fixes exceeds the effect of a delay
_FAST_SHARE = 0.5  # only rows above this share of the 90th percentile of the speed are used
MOST_ROWS = 10_000  # more are thinned evenly

_FIRST_GUESS_S = 0.1  # near the delay of u-blox receivers
_REFINEMENTS = 4  # then the last step is below 0.1 ms
_HALF_BASE_NS = 250_000_000  # [ns] the speed is the mean over twice this time
_CORRELATION_S = 5.0  # correlation time of the differences between filter and receiver
_SIGMA_OF_MAD = 1.4826  # sigma of a normal distribution over its median absolute deviation
_SIGMA_OF_MEDIAN = 1.2533  # sigma of a median over sigma of a mean: sqrt(pi / 2)


@dataclass(frozen=True)
class ReceiverDelay:
    """Stamp minus epoch of a receiver's fixes [s], its sigma [s], and its origin in words."""

    delay_s: float
    sigma_s: float
    origin: str


def with_receiver_delay(contents: Contents, ledger: Ledger) -> Contents:
    """The contents with all times corrected for the delay of the GNSS receivers.

    The UTC of a fix was paired with its late stamp, so that all times of the vehicle are too early
    by the delay of the receiver that gives UTC. Therefore:

    - All channels of its vehicle become later by that delay.
    - The fixes of each receiver become earlier by the receiver's own delay: their epochs.

    Contents without fixes by one of `_RECEIVERS` are returned as they are.
    """
    receivers = [
        channel
        for channel in contents.channels
        if channel.source.message in _RECEIVERS and len(channel)
    ]
    if not receivers:
        return contents
    delays = {channel.name: _delay_of(channel, contents) for channel in receivers}
    utc_receiver = max(receivers, key=len)  # UTC is from the receiver with the most rows
    delay = delays[utc_receiver.name]
    ledger.add(_accuracy_note(utc_receiver, delay, contents.utc_sigma_s))
    later_ns = round(delay.delay_s * 1e9)
    channels = []
    for channel in contents.channels:
        shift_ns = 0
        if channel.source.system == utc_receiver.source.system:
            shift_ns += later_ns
        if channel.name in delays:
            shift_ns -= round(delays[channel.name].delay_s * 1e9)
        channels.append(_shifted(channel, shift_ns))
    return replace(
        contents,
        channels=tuple(channels),
        table=_later_table(contents.table, later_ns),
        utc_sigma_s=float(np.hypot(contents.utc_sigma_s, delay.sigma_s)),
        clocks=tuple(_with_delay(assessment, delay) for assessment in contents.clocks),
    )


def _accuracy_note(receiver: Channel, delay: ReceiverDelay, clock_sigma_s: float) -> Message:
    """The note on how accurate UTC is, and on the delay of the receiver.

    ``clock_sigma_s``: of the clock that gives UTC [s]; 0 if that is a receiver, NaN if UTC is
    unknown.
    """
    if clock_sigma_s == 0.0:
        return messages.utc_accuracy(
            receiver=receiver.name,
            fixes=len(receiver),
            sigma_s=delay.sigma_s,
            delay_s=delay.delay_s,
            origin=delay.origin,
        )
    return messages.fix_delay(
        receiver=receiver.name,
        fixes=len(receiver),
        utc_sigma_s=None if math.isnan(clock_sigma_s) else clock_sigma_s,
        delay_s=delay.delay_s,
        origin=delay.origin,
    )


def _with_delay(assessment: ClockAssessment, delay: ReceiverDelay) -> ClockAssessment:
    """The assessment of a clock; if a receiver sets it, with the sigma of the delay added."""
    if assessment.sigma_s is None or assessment.sigma_s >= UNCHECKED_SIGMA_S:
        return assessment  # of unknown accuracy, or of a clock that no receiver sets
    sigma_s = float(np.hypot(assessment.sigma_s, delay.sigma_s))
    return replace(
        assessment, sigma_s=sigma_s, why=f"{assessment.why}; fixes are late, {delay.origin}"
    )


def _shifted(channel: Channel, shift_ns: int) -> Channel:
    """The channel with its times later by a shift [ns]."""
    if not shift_ns:
        return channel
    return replace(channel, time_ns=channel.time_ns + shift_ns)


def _later_table(
    table: Callable[[str, str | None], Table] | None, later_ns: int
) -> Callable[[str, str | None], Table] | None:
    """A function that decodes tables as ``table`` does, with times later by ``later_ns``."""
    if table is None:
        return None

    def later(name: str, instance: str | None) -> Table:
        columns = table(name, instance)
        if "time_ns" in columns:
            columns["time_ns"] = columns["time_ns"] + later_ns
        return columns

    return later


def _delay_of(receiver: Channel, contents: Contents) -> ReceiverDelay:
    """The delay estimated against the filter of the receiver's system, else the stated delay."""
    for channel in contents.channels:
        is_fused = channel.source.message in _FUSED
        if is_fused and channel.source.system == receiver.source.system:
            estimate = estimated_delay(receiver, channel)
            if estimate is not None:
                return estimate
    texts = [text for channel in contents.channels for text in channel.labels.get("text", ())]
    return stated_delay(receiver, contents.parameters, texts)


def stated_delay(
    receiver: Channel, parameters: Mapping[str, float], texts: Iterable[str]
) -> ReceiverDelay:
    """The delay of a receiver by the first setting of the autopilot that states one.

    - A setting above 0: that delay, unless it is longer than `_LARGEST_DELAY_S`.
    - A setting of 0: the delay that the driver assumes for the kind of receiver, which it names in
      the ``texts`` of the log.
    - No setting: 0 s, with `UNKNOWN_SIGMA_S`.
    """
    for name in _settings_of(receiver):
        value_ms = parameters.get(name, float("nan"))  # NaN: the log has no such setting
        if 0.0 < value_ms < _LARGEST_DELAY_S * 1e3:
            return ReceiverDelay(value_ms / 1e3, STATED_SIGMA_S, f"by {name}")
        if value_ms == 0.0:
            is_later_ublox = any(_LATER_UBLOX.search(text) for text in texts)
            delay_s = _DELAY_OF_LATER_S if is_later_ublox else _DELAY_OF_OTHERS_S
            origin = f"by the receiver's driver ({name} is 0)"
            return ReceiverDelay(delay_s, STATED_SIGMA_S, origin)
    origin = "because there is neither a setting nor positions of a filter to compare with"
    return ReceiverDelay(0.0, UNKNOWN_SIGMA_S, origin)


def _settings_of(receiver: Channel) -> Sequence[str]:
    """The names of the settings for a receiver: those of a first or of a second one."""
    is_second = "2" in receiver.source.message or receiver.source.instance not in (None, "0")
    return _SETTINGS_OF_SECOND if is_second else _SETTINGS_OF_FIRST


@dataclass(frozen=True)
class _Motion:
    """Fixes of a receiver and the positions of a filter, both at the times of their stamps."""

    fused: Channel  # the positions of the filter
    time_ns: TimeArray  # (n,) of the fixes
    fixes_rad: Array  # (2, n) latitude and longitude
    m_per_rad: Array  # (2, 1) to north and to east

    def places_rad(self, time_ns: TimeArray) -> Array:
        """(2, n) latitude and longitude of the filter at (n,) other times; NaN in its gaps."""
        limit_s = self.fused.gap_limit_s()
        latitude = interpolate(self.fused, "lat_rad", time_ns, limit_s)
        longitude = interpolate(self.fused, "lon_rad", time_ns, limit_s)
        return np.stack([latitude, longitude])

    def delays_beyond(self, delay_s: float) -> Array:
        """The delay of each fix in fast flight, minus ``delay_s`` [s].

        A fix lags the position of the filter by the speed times the delay; so the delay is
        -(difference . velocity) / speed^2. Empty if there are too few fixes for an estimate.
        """
        epoch_ns = self.time_ns - round(delay_s * 1e9)
        apart_m = wrapped(self.fixes_rad - self.places_rad(epoch_ns)) * self.m_per_rad
        after = self.places_rad(epoch_ns + _HALF_BASE_NS)
        before = self.places_rad(epoch_ns - _HALF_BASE_NS)
        base_s = 2e-9 * _HALF_BASE_NS
        speed_m_s = wrapped(after - before) * self.m_per_rad / base_s
        speed_squared = (speed_m_s**2).sum(axis=0)
        is_known = np.isfinite(speed_squared) & np.isfinite(apart_m).all(axis=0)
        if np.count_nonzero(is_known) < _LEAST_ROWS:
            return np.empty(0)
        high_speed_m_s = float(np.sqrt(np.percentile(speed_squared[is_known], 90.0)))
        least_m_s = max(_LEAST_SPEED_M_S, _FAST_SHARE * high_speed_m_s)
        is_fast = is_known & (speed_squared > least_m_s**2)
        if np.count_nonzero(is_fast) < _LEAST_ROWS:
            return np.empty(0)
        lag_times_speed = -(apart_m * speed_m_s).sum(axis=0)
        return np.asarray(lag_times_speed[is_fast] / speed_squared[is_fast])


def estimated_delay(receiver: Channel, fused: Channel) -> ReceiverDelay | None:
    """Estimate the delay of fixes against the positions of the filter that uses them.

    The estimate is the median over the fixes in fast flight, which lag by the speed times the
    delay. Less than `_LEAST_DELAY_S` is returned as 0: such fixes are stamped at their epochs. None
    if these fixes are few or do not agree, or if their delay is impossible for a receiver.

    Against the positions of the filter the delay was good to 1 ms in two simulator flights. The
    filter itself was 11 and 21 ms ahead of the truth: `_FILTER_SIGMA_S` allows for that.
    """
    step = max(len(receiver) // MOST_ROWS, 1)  # memory has its peak here
    fixes_rad = np.stack([receiver["lat_rad"][::step], receiver["lon_rad"][::step]])
    latitude_rad = float(np.nanmedian(fixes_rad[0]))
    meridian_m, prime_vertical_m = principal_radii(latitude_rad)
    east_m_per_rad = float(prime_vertical_m) * np.cos(latitude_rad)
    motion = _Motion(
        fused=fused,
        time_ns=receiver.time_ns[::step],
        fixes_rad=fixes_rad,
        m_per_rad=np.array([[float(meridian_m)], [east_m_per_rad]]),
    )
    delay_s = _FIRST_GUESS_S
    excess_s = np.empty(0)
    for _ in range(_REFINEMENTS):
        excess_s = motion.delays_beyond(delay_s)
        if not excess_s.size:
            return None
        delay_s += float(np.median(excess_s))
    median_sigma_s = _sigma_of_median(excess_s, receiver.rate_hz / step)
    if median_sigma_s > _LARGEST_MEDIAN_SIGMA_S:
        return None
    if not -_LEAST_DELAY_S < delay_s < _LARGEST_DELAY_S:
        return None
    is_stamped_at_epoch = delay_s <= _LEAST_DELAY_S
    return ReceiverDelay(
        delay_s=0.0 if is_stamped_at_epoch else delay_s,
        sigma_s=float(np.hypot(median_sigma_s, _FILTER_SIGMA_S)),
        origin=f"estimated from {excess_s.size} of them against {fused.name}",
    )


def _sigma_of_median(excess_s: Array, rate_hz: float) -> float:
    """The sigma of the median of delays [s] with errors that are correlated for `_CORRELATION_S`.

    ``rate_hz``: of the rows.
    """
    scatter_s = _SIGMA_OF_MAD * float(np.median(np.abs(excess_s - np.median(excess_s))))
    rows_per_independent = max(_CORRELATION_S * rate_hz, 1.0)
    independent_rows = excess_s.size * (1.0 / rows_per_independent)
    return float(_SIGMA_OF_MEDIAN * scatter_s / np.sqrt(independent_rows))
