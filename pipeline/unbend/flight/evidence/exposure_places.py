"""The place, height and attitude that a log has of each exposure, compared with the flight.

The flight is that of the channels from which the stations are made, without lever arms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.flight.channels import Channel
from unbend.flight.evidence import messages
from unbend.flight.evidence.log_accuracy import LogAccuracy
from unbend.flight.evidence.sources import is_receiver, north_east_m
from unbend.flight.evidence.stretches import ATTITUDE, HEIGHT, POSITION, Stretch, in_any_stretch
from unbend.flight.ground_times import HOME_NOT_SET_M
from unbend.flight.interpolation import interpolate
from unbend.flight.mount import is_of_gimbal
from unbend.flight.rotations import down_in_body, down_of
from unbend.flight.trajectory import Track, attitude_at, track_at
from unbend.messages import Message
from unbend.units import NANOSECONDS_PER_SECOND, Array, Integers, Mask

# How much earlier or later than its row a place may be: the interval of a receiver and its delay
# (0.2 s each), or the lag of a shutter behind its trigger (0.16 s were measured).
LATENCY_S = 0.5
# Two values agree if they differ by no more than so many sigmas plus one of the tolerances below.
SIGMAS = 5.0
NOISE_M = 5.0  # for places
HEIGHT_NOISE_M = 10.0  # for heights of one filter, or of one receiver
OTHER_SOURCE_M = 100.0  # for heights of a receiver and of a filter that uses a barometer
TILT_NOISE_DEG = 5.0  # for verticals
UNKNOWN_SIGMA_M = 5.0  # taken for the sigma of a position if the log does not report any

HEIGHTS_OF_FLIGHT = (
    "h_msl_m",
    "h_ellipsoid_m",
    "h_home_m",
)
"""Columns of the flight with which a logged height is compared: its name may be misleading."""

_INSTANTS = 9  # that are tried in the interval in which a logged place may have been taken
_SLOWEST_M_S = 2.0  # slower samples show no shift of time
_OF_AIRCRAFT = {"CAM", "TRIG", "CAMERACAPTURE"}  # events with the attitude of the aircraft


@dataclass(frozen=True, eq=False)
class ExposureEvidence:
    """The events of a log with their own places, and the flight with which they are compared.

    ``channel`` has the (n,) events as logged, ``time_ns`` (n,) the times of the stations [Unix ns].
    ``roles`` are the channels of the stations, ``log_roles`` those that the log alone would give.
    ``lever_arm_m`` is how far the camera may be from the position. Exposures in ``suspect``
    stretches do not count.
    """

    channel: Channel
    time_ns: Integers
    roles: Mapping[str, Channel]
    log_roles: Mapping[str, Channel]
    accuracy: LogAccuracy
    suspect: Sequence[Stretch]
    lever_arm_m: float
    max_gap_s: float

    @property
    def instants(self) -> Integers:
        """(k, n) instants at which the (n,) logged places may have been taken, earliest first.

        They are evenly distributed from `LATENCY_S` and three sigmas before an event to as much
        after it.
        """
        sigma_s = np.nan_to_num(self.channel.get("sigma_time_s"))
        allowed_ns = np.round((LATENCY_S + 3.0 * sigma_s) * NANOSECONDS_PER_SECOND).astype(np.int64)
        earliest = np.minimum(self.channel.time_ns, self.time_ns) - allowed_ns
        latest = np.maximum(self.channel.time_ns, self.time_ns) + allowed_ns
        share = np.linspace(
            0.0,
            1.0,
            _INSTANTS,
        )[:, None]
        return np.asarray(earliest + np.round(share * (latest - earliest)).astype(np.int64))

    def is_trusted(self, quantity: str) -> Mask:
        """(n,) True for exposures outside the suspect stretches of a quantity."""
        stretches = [stretch for stretch in self.suspect if stretch.quantity == quantity]
        return ~in_any_stretch(stretches, self.time_ns)


def exposure_findings(evidence: ExposureEvidence) -> Iterator[Message]:
    """Findings if places, heights or attitudes that the log has of exposures contradict the flight.

    There are none if the numbers of events and of stations differ.
    """
    if len(evidence.channel) == 0 or len(evidence.channel) != evidence.time_ns.size:
        return
    yield from _place_findings(evidence)
    yield from _height_findings(evidence)
    yield from _attitude_findings(evidence)


def _place_findings(evidence: ExposureEvidence) -> Iterator[Message]:
    """A finding if places that the log has of exposures are far from the flight."""
    shots = evidence.channel
    position = evidence.roles.get(POSITION)
    if position is None or not shots.fits_role(POSITION):
        return
    nearest = _nearest_place(evidence, position)
    sigmas = evidence.accuracy.positions(position, evidence.time_ns)
    sigma_m = np.hypot(
        _known_sigma(sigmas.horizontal_m),
        _sigmas_of_log(evidence).horizontal_m,
    )
    limit_m = NOISE_M + SIGMAS * sigma_m
    limit_m += evidence.lever_arm_m
    limit_m += nearest.between_m / 2.0  # the flight may be nearest half-way between two instants
    is_known = np.isfinite(nearest.distance_m) & evidence.is_trusted(POSITION)
    is_off = is_known & (np.nan_to_num(nearest.distance_m) > limit_m)
    if is_off.any():
        yield messages.exposures_elsewhere(
            channel=shots.name,
            count=int(np.count_nonzero(is_off)),
            total=int(np.count_nonzero(is_known)),
            position=position.name,
            off_m=float(nearest.distance_m[is_off].max()),
            limit_m=float(limit_m[is_off].min()),
            shift_s=_shift_of_time(
                evidence,
                position,
                is_off,
                limit_m,
            ),
        )


@dataclass(frozen=True, eq=False)
class _NearestPlaces:
    """How near a flight comes to (n,) logged places, at some instants.

    ``distance_m`` is that at the nearest instant, ``between_m`` how far the flight moves from one
    instant to the next.
    """

    distance_m: Array
    between_m: Array


def _nearest_place(evidence: ExposureEvidence, position: Channel) -> _NearestPlaces:
    """How near the flight (``position``) comes to the logged places, at `evidence.instants`."""
    shots = evidence.channel
    instants = evidence.instants
    seconds = (instants[1] - instants[0]) / NANOSECONDS_PER_SECOND
    distance_m = np.full(len(shots), np.nan)
    between_m = np.zeros(len(shots))
    for time_ns in instants:
        track = track_at(
            position,
            time_ns,
            evidence.max_gap_s,
        )
        offset_m = _offset(shots, track)
        distance_m = np.fmin(distance_m, np.linalg.norm(offset_m, axis=1))
        speed_m_s = np.linalg.norm(track.velocity_m_s, axis=1)
        between_m = np.fmax(between_m, speed_m_s * seconds)
    return _NearestPlaces(distance_m, between_m)


def _offset(shots: Channel, track: Track) -> Array:
    """(n, 2) metres north and east from places of the flight to those of exposures."""
    north = shots["lat_rad"] - track.lat_rad
    east = shots["lon_rad"] - track.lon_rad
    change = np.stack([north, east], axis=1)
    return north_east_m(change, shots["lat_rad"])


def _known_sigma(sigma_m: Array) -> Array:
    """(n,) sigmas [m], with `UNKNOWN_SIGMA_M` where they are unknown."""
    return np.where(
        np.isfinite(sigma_m),
        sigma_m,
        UNKNOWN_SIGMA_M,
    )


@dataclass(frozen=True, eq=False)
class _SigmasOfLog:
    """(n,) sigmas [m] of the places that the log has of exposures."""

    horizontal_m: Array
    height_m: Array


def _sigmas_of_log(evidence: ExposureEvidence) -> _SigmasOfLog:
    """The sigmas of the places that the log has of exposures: those of its own positions."""
    position = evidence.log_roles.get(POSITION)
    if position is None:
        unknown = np.full(evidence.time_ns.shape, UNKNOWN_SIGMA_M)
        return _SigmasOfLog(unknown, unknown)
    sigmas = evidence.accuracy.positions(position, evidence.time_ns)
    return _SigmasOfLog(_known_sigma(sigmas.horizontal_m), _known_sigma(sigmas.height_m))


def _shift_of_time(
    evidence: ExposureEvidence,
    position: Channel,
    is_off: Mask,
    limit_m: Array,
) -> float:
    """The shift [s] of the times of events that explains their logged places; NaN if none does.

    It is positive if the flight is at these places later. ``is_off`` (n,) : the events with a place
    that is farther than ``limit_m`` (n,) from the flight.
    """
    track = track_at(
        position,
        evidence.channel.time_ns,
        evidence.max_gap_s,
    )
    offset_m = _offset(evidence.channel, track)
    square_speed = np.sum(track.velocity_m_s**2, axis=1)
    usable = is_off & np.isfinite(offset_m).all(axis=1) & (square_speed > _SLOWEST_M_S**2)
    if not usable.any():
        return float("nan")
    along = np.sum(offset_m * track.velocity_m_s, axis=1)[usable] / square_speed[usable]
    shift_s = float(np.median(along))
    unexplained = offset_m[usable] - shift_s * track.velocity_m_s[usable]
    if np.median(np.linalg.norm(unexplained, axis=1)) > np.median(limit_m[usable]):
        return float("nan")
    return shift_s


def _height_findings(evidence: ExposureEvidence) -> Iterator[Message]:
    """A finding if heights that the log has of exposures are far from all heights of the flight.

    * ``h_msl_m`` of an event is taken for that of the filter. It is compared with the filter's
      heights, with a tolerance of `HEIGHT_NOISE_M`; if no filter gives the position, with the
      heights of the log, with a tolerance of `OTHER_SOURCE_M`.
    * ``h_gnss_m`` is the receiver's: it is compared with the receiver (`HEIGHT_NOISE_M`).
    * ``h_ellipsoid_m`` may be of either: it is compared with the receiver (`OTHER_SOURCE_M`).
    """
    position = evidence.log_roles.get(POSITION)
    height = evidence.log_roles.get(HEIGHT)
    if position is not None and not is_receiver(position):
        yield from _heights_beside(
            evidence,
            "h_msl_m",
            position,
            HEIGHT_NOISE_M,
        )
    elif height is not None:  # no filter gives the position
        yield from _heights_beside(
            evidence,
            "h_msl_m",
            height,
            OTHER_SOURCE_M,
        )
    if height is not None and is_receiver(height):
        yield from _heights_beside(
            evidence,
            "h_gnss_m",
            height,
            HEIGHT_NOISE_M,
        )
        yield from _heights_beside(
            evidence,
            "h_ellipsoid_m",
            height,
            OTHER_SOURCE_M,
        )


def _heights_beside(
    evidence: ExposureEvidence,
    column: str,
    other: Channel,
    tolerance_m: float,
) -> Iterator[Message]:
    """A finding if heights of exposures in a column are far from all heights of another channel.

    The other channel's heights above the sea, the ellipsoid and the take-off count. Heights may
    differ by ``tolerance_m`` in addition to their sigmas.
    """
    shots = evidence.channel
    if column not in shots.columns:
        return
    apart_m = _nearest_height(
        evidence,
        column,
        other,
    )
    sigmas = evidence.accuracy.positions(other, evidence.time_ns)
    sigma_m = np.hypot(
        _known_sigma(sigmas.height_m),
        _sigmas_of_log(evidence).height_m,
    )
    limit_m = tolerance_m + SIGMAS * sigma_m
    is_known = np.isfinite(apart_m) & evidence.is_trusted(HEIGHT)
    is_off = is_known & (np.nan_to_num(apart_m) > limit_m)
    if is_off.any():
        yield messages.exposures_at_other_heights(
            channel=shots.name,
            column=column,
            count=int(np.count_nonzero(is_off)),
            total=int(np.count_nonzero(is_known)),
            height=other.name,
            off_m=float(apart_m[is_off].max()),
            limit_m=float(limit_m[is_off].min()),
        )


def _nearest_height(
    evidence: ExposureEvidence,
    column: str,
    other: Channel,
) -> Array:
    """(n,) metres from heights of exposures to the nearest height of another channel.

    It is the nearest at all `evidence.instants` and above all `HEIGHTS_OF_FLIGHT`. NaN where the
    other channel has none, and where that of the exposure is unknown:

    * it is 0;
    * it is equal to the height above home, because home is not set, and the other channel has no
      heights above home with which it could be compared.
    """
    shots = evidence.channel
    is_logged = shots[column] != 0.0
    if "h_home_m" not in other.columns:
        is_logged &= ~(np.abs(shots[column] - shots.get("h_home_m")) < HOME_NOT_SET_M)
    logged_m = np.where(
        is_logged,
        shots[column],
        np.nan,
    )
    compared = _with_heights_above_home(other)
    gap_s = compared.gap_limit_s(evidence.max_gap_s)
    apart_m = np.full(len(shots), np.nan)
    for time_ns in evidence.instants:
        for surface in HEIGHTS_OF_FLIGHT:
            of_flight_m = interpolate(
                compared,
                surface,
                time_ns,
                gap_s,
            )
            apart_m = np.fmin(apart_m, np.abs(logged_m - of_flight_m))
    return apart_m


def _with_heights_above_home(channel: Channel) -> Channel:
    """Add heights above the take-off (``h_home_m``) to a channel without them.

    Its first known height is taken for the take-off: cameras log heights above it, receivers do
    not. A channel without any known height is returned unchanged.
    """
    column = channel.height_column
    if column is None or "h_home_m" in channel.columns:
        return channel
    known_m = channel[column][np.isfinite(channel[column])]
    if known_m.size == 0:
        return channel
    above_begin_m = channel[column] - known_m[0]
    return replace(channel, columns=dict(channel.columns) | {"h_home_m": above_begin_m})


def _attitude_findings(evidence: ExposureEvidence) -> Iterator[Message]:
    """A finding if the vertical that the log has of exposures differs from that of the flight.

    Only events with the attitude of the aircraft are compared, and not with themselves.
    """
    shots = evidence.channel
    attitude = evidence.log_roles.get(ATTITUDE)
    if attitude is None or is_of_gimbal(attitude.source.message):
        return
    if shots.source.kind not in _OF_AIRCRAFT:
        return
    if not shots.fits_role(ATTITUDE) or attitude.name == shots.name:
        return
    logged_down = down_in_body(shots)
    tilt_deg = np.full(len(shots), np.nan)
    for time_ns in evidence.instants:
        quaternion = attitude_at(attitude, time_ns, evidence.max_gap_s).quaternion
        down = down_of(quaternion)
        cosine = np.clip(
            np.sum(logged_down * down, axis=0),
            -1.0,
            1.0,
        )
        tilt_deg = np.fmin(tilt_deg, np.degrees(np.arccos(cosine)))
    sigma_rad = evidence.accuracy.attitude(
        attitude,
        evidence.time_ns,
        shots.get("lat_rad"),
    ).tilt_rad
    limit_deg = TILT_NOISE_DEG + SIGMAS * np.degrees(np.nan_to_num(sigma_rad))
    is_known = np.isfinite(tilt_deg) & evidence.is_trusted(ATTITUDE)
    is_off = is_known & (np.nan_to_num(tilt_deg) > limit_deg)
    if is_off.any():
        yield messages.exposures_tilted_otherwise(
            channel=shots.name,
            count=int(np.count_nonzero(is_off)),
            total=int(np.count_nonzero(is_known)),
            attitude=attitude.name,
            off_deg=float(tilt_deg[is_off].max()),
            limit_deg=float(limit_deg[is_off].min()),
        )
