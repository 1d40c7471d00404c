"""Faults of receivers, filters and barometers, put into the channels of a good log.

The filter is a small model of its own: it takes the receiver's error in by steps, rejects what is
beyond its gate, coasts on a biased accelerometer, and resets to the receiver when it has rejected
it for too long. What it logs (position, velocity, tilt, innovation ratio, texts) follows from that.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import EARTH_M, quaternion_columns, rotation_of, with_columns
from tests.helpers import NS_PER_S
from unbend.flight.channels import Source

GATE_M = 4.6  # a receiver 77 m off has ratios of 14 to 20 in ArduPilot's logs
KINDS = (
    "followed",
    "rejected",
    "dead reckoning",
    "no fix",
    "swap",
    "drift",
    "wind-up",
    "height glitch",
)
OF_RECEIVER = ("h_msl_m", "h_ellipsoid_m")
OF_FILTER = ("h_msl_m", "h_home_m")
COMPONENTS = ("q_w", "q_x", "q_y", "q_z")


@dataclass
class Fault:
    """One fault: what, from when to when, how large, and what it does to a place [m]."""

    kind: str
    begin_ns: int
    end_ns: int
    size_m: float

    def __str__(self):
        length_s = (self.end_ns - self.begin_ns) / NS_PER_S
        return f"{self.kind} of {self.size_m:.0f} m for {length_s:.0f} s"

    def holds(self, time_ns):
        """(n,) at which times."""
        return (time_ns >= self.begin_ns) & (time_ns <= self.end_ns)


def displaced(channel, north_east_m):
    """The channel with its places moved by (n, 2) metres."""
    lat = channel["lat_rad"]
    north, east = north_east_m.T / EARTH_M
    lon = channel["lon_rad"] + east / np.cos(lat)
    return with_columns(channel, lat_rad=lat + north, lon_rad=lon)


def added(
    channel,
    amount,
    *names,
):
    """The channel with an amount added to those of the columns that it has."""
    columns = {name: channel[name] + amount for name in names if name in channel.columns}
    return with_columns(channel, **columns)


def second_receiver(first, rng):
    """Another receiver of the flight: noise of its own, an antenna 0.4 m away, 30 ms later."""
    n = len(first)
    walk = np.convolve(rng.normal(0.0, 0.35, n + 199), np.ones(200) / 200**0.5, "valid")
    noise = rng.normal(0.0, 0.08, (3, n)) + walk * rng.choice([-0.5, 0.5], (3, 1))
    other = displaced(first, noise[:2].T + np.array([0.4, 0.0]))
    other = added(other, noise[2] + 0.1, *OF_RECEIVER)
    return replace(
        other,
        name="GPS[1]",
        source=Source("GPS", "1"),
        rank=30,
        time_ns=first.time_ns + 30_000_000,
    )


@dataclass
class FilterErrors:
    """(n,) errors of a filter, of which places and velocities are (n, 2) north and east."""

    place_m: np.ndarray
    velocity_m_s: np.ndarray
    ratio: np.ndarray
    tilt_rad: np.ndarray


@dataclass(frozen=True)
class FilterModel:
    """How a filter behaves that has a receiver with errors (m, 2) [m], and fixes (m,)."""

    gps_ns: np.ndarray
    gps_error_m: np.ndarray
    has_fix: np.ndarray
    retry_s: float  # after which it resets to a receiver that it rejects
    bias_m_s2: float
    heading: float  # of the bias

    def errors(self, time_ns):
        """The errors at some times, one after the other."""
        n = time_ns.size
        made = FilterErrors(
            place_m=np.zeros((n, 2)),
            velocity_m_s=np.zeros((n, 2)),
            ratio=np.zeros(n),
            tilt_rad=np.zeros(n),
        )
        # north + i east: numbers, which are fast
        place = 0j
        velocity = 0j
        pull = self.bias_m_s2 * complex(np.cos(self.heading), np.sin(self.heading))
        errors = (self.gps_error_m @ [1.0, 1j]).tolist()
        newest = (np.searchsorted(self.gps_ns, time_ns, side="right") - 1).tolist()
        steps_s = (np.diff(time_ns) / NS_PER_S).tolist()
        unaided_s = 0.0
        ratio = 0.0
        last = -1
        for row, dt in enumerate(steps_s, start=1):
            if unaided_s > 0.5:  # what an aided filter has estimated away comes back by and by
                velocity += pull * dt
                place += velocity * dt
            unaided_s += dt
            fix = newest[row]
            if fix != last and fix >= 0:
                last = fix
                if self.has_fix[fix]:
                    innovation = errors[fix] - place
                    ratio = abs(innovation) / (GATE_M + 0.3 * max(unaided_s - 1.0, 0.0))
                    if ratio < 1.0:
                        place += 0.25 * innovation
                        velocity *= 0.5
                        unaided_s = 0.0
                    elif unaided_s > self.retry_s:
                        place = errors[fix]
                        velocity = 0j
                        unaided_s = 0.0
            made.place_m[row] = (place.real, place.imag)
            made.velocity_m_s[row] = (velocity.real, velocity.imag)
            made.ratio[row] = ratio
            made.tilt_rad[row] = min(unaided_s, 10.0) / 10.0 * self.bias_m_s2 / 9.81
        return made


def tilted(
    channel,
    angle,
    azimuth,
):
    """An attitude turned by (n,) small angles [rad] about a level axis."""
    stored = rotation_of(np.stack([channel[name] for name in COMPONENTS], axis=1))
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turned = Rotation.from_rotvec(angle[:, None] * axis) * stored
    return with_columns(channel, **quaternion_columns(turned))


def says(channels, *texts: tuple[int, str]):
    """Add lines to what the autopilot says."""
    old = channels["MSG"]
    old_lines = zip(old.time_ns.tolist(), old.labels["text"], strict=True)
    lines = sorted([*old_lines, *texts])
    time_ns, messages = zip(*lines, strict=True)
    channels["MSG"] = replace(
        old,
        time_ns=np.array(time_ns),
        boot=np.zeros(len(lines), np.int16),
        labels={"text": messages},
    )


def inject(
    good,
    kind,
    around_ns,
    rng,
):
    """The channels of a log with one fault of a kind that contains an instant."""
    channels = dict(good)
    length_ns = rng.uniform(6.0, 40.0) * NS_PER_S
    begin_ns = around_ns - round(rng.uniform(0.1, 0.9) * length_ns)
    size_m = rng.uniform(20.0, 100.0)
    fault = Fault(kind, begin_ns, begin_ns + round(length_ns), size_m)
    if kind == "wind-up":
        wind_up(channels, fault, rng)
        return channels, fault
    gps = channels["GPS[0]"]
    has_two = kind in ("swap", "drift") or rng.random() < 0.4
    if has_two:
        channels["GPS[1]"] = second_receiver(gps, rng)
    inside = fault.holds(gps.time_ns)
    if kind == "height glitch":
        up_m = rng.choice([-1.0, 1.0]) * fault.size_m * inside
        channels["GPS[0]"] = added(gps, up_m, *OF_RECEIVER)
        return channels, fault
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    north = np.cos(azimuth)
    east = np.sin(azimuth)
    direction = np.array([north, east])
    amount_m = fault.size_m * inside
    up_m = rng.uniform(-0.6, 0.6) * amount_m
    if kind == "drift":
        speed_m_s = rng.uniform(1.0, 3.0) * inside
        amount_m = speed_m_s * drift_s(fault, gps.time_ns, rng)
        up_m = 0.3 * amount_m
        if rng.random() < 0.5:  # the Doppler velocity is led away too
            gps = added(gps, speed_m_s * north, "v_north_m_s")
            gps = added(gps, speed_m_s * east, "v_east_m_s")
    error_m = amount_m[:, None] * direction
    fused_m = error_m
    if kind in ("swap", "no fix"):
        error_m = np.zeros_like(error_m)
        fused_m = error_m
        up_m = np.zeros(len(gps))
    if kind == "swap":
        # The second receiver is off by a constant for the whole flight; the filter goes over to it.
        fault.size_m = rng.uniform(6.0, 40.0)
        offset_m = fault.size_m * direction
        channels["GPS[1]"] = displaced(channels["GPS[1]"], offset_m[None])
        fused_m = inside[:, None] * offset_m
        says(channels, (fault.begin_ns, "EV GPS_PRIMARY_CHANGED"))
    has_fix = np.ones(len(gps), bool)
    if kind == "no fix":
        has_fix = ~inside
    retry_s = 0.0
    if kind not in ("followed", "swap"):
        retry_s = rng.uniform(7.0, 12.0)
    model = FilterModel(
        gps_ns=gps.time_ns,
        gps_error_m=fused_m,
        has_fix=has_fix,
        retry_s=retry_s,
        bias_m_s2=rng.uniform(0.02, 0.15),
        heading=rng.uniform(0.0, 2.0 * np.pi),
    )
    errors = model.errors(channels["POS"].time_ns)
    log_errors(channels, errors, azimuth)
    if kind == "dead reckoning":
        go_over_to_dcm(channels, fault, errors, model, rng)
    gps = added(displaced(gps, error_m), up_m, *OF_RECEIVER)
    channels["GPS[0]"] = gps.rows(has_fix)
    return channels, fault


def drift_s(
    fault,
    time_ns,
    rng,
):
    """For how long a receiver is led away; it returns as slowly as it went, or by a step."""
    elapsed_ns = time_ns - fault.begin_ns
    if rng.random() < 0.5:
        elapsed_ns = np.minimum(elapsed_ns, fault.end_ns - time_ns)
    return elapsed_ns / NS_PER_S


def log_errors(
    channels,
    errors,
    azimuth,
):
    """Put the errors of a filter into what it logs."""
    pos = channels["POS"]
    channels["POS"] = displaced(pos, errors.place_m)
    for name in ("ATT", "XKF1[0]", "XKQ[0]"):
        angle = np.interp(channels[name].time_ns, pos.time_ns, errors.tilt_rad)
        channels[name] = tilted(channels[name], angle, azimuth)
    lane = channels["XKF1[0]"]
    north_m_s, east_m_s = errors.velocity_m_s.T
    lane = added(lane, np.interp(lane.time_ns, pos.time_ns, north_m_s), "v_north_m_s")
    lane = added(lane, np.interp(lane.time_ns, pos.time_ns, east_m_s), "v_east_m_s")
    channels["XKF1[0]"] = lane
    health = channels["XKF4[0]"]
    ratio = np.round(np.interp(health.time_ns, pos.time_ns, errors.ratio), 2)
    shown = np.fmax(health["innovation_position"], ratio)
    channels["XKF4[0]"] = with_columns(health, innovation_position=shown)


def go_over_to_dcm(
    channels,
    fault,
    errors,
    model,
    rng,
):
    """The autopilot leaves the filter: DCM, which goes by the receiver."""
    begin_ns = fault.begin_ns + round(rng.uniform(0.3, 2.0) * NS_PER_S)
    end_ns = fault.end_ns + NS_PER_S
    time_ns = channels["POS"].time_ns
    of_dcm = (time_ns > begin_ns) & (time_ns < end_ns)
    newest = np.maximum(np.searchsorted(model.gps_ns, time_ns, side="right") - 1, 0)
    apart_m = (model.gps_error_m[newest] - errors.place_m) * of_dcm[:, None]
    channels["POS"] = displaced(channels["POS"], apart_m)
    says(channels, (begin_ns, "AHRS: DCM active"), (end_ns, "AHRS: EKF3 active"))
    att = channels["ATT"]
    dcm = channels["AHR2"]
    of_dcm = (att.time_ns > begin_ns) & (att.time_ns < end_ns)
    row = np.minimum(np.searchsorted(dcm.time_ns, att.time_ns), len(dcm) - 1)
    columns = {name: np.where(of_dcm, dcm[name][row], att[name]) for name in COMPONENTS}
    channels["ATT"] = with_columns(att, **columns)


def wind_up(
    channels,
    fault,
    rng,
):
    """A barometer whose pressure creeps away and back, and the filter's height with it."""
    ramp_ns = round(rng.uniform(20.0, 120.0) * NS_PER_S)
    fault.size_m = rng.uniform(15.0, 60.0) * rng.choice([-1.0, 1.0])
    corners_ns = [
        fault.begin_ns - ramp_ns,
        fault.begin_ns,
        fault.end_ns,
        fault.end_ns + ramp_ns,
    ]
    fault.begin_ns -= ramp_ns
    fault.end_ns += ramp_ns

    def climb_m(channel):
        return np.interp(channel.time_ns, corners_ns, [0.0, fault.size_m, fault.size_m, 0.0])

    names = ["BARO[0]", "BARO[1]"] if rng.random() < 0.4 else ["BARO[0]"]  # on one static line
    for name in names:
        baro = channels[name]
        pressure_pa = baro["pressure_pa"] * np.exp(-climb_m(baro) / 8000.0)
        channels[name] = with_columns(baro, pressure_pa=pressure_pa)
    channels["POS"] = added(channels["POS"], climb_m(channels["POS"]), *OF_FILTER)
    channels["XKF1[0]"] = added(channels["XKF1[0]"], climb_m(channels["XKF1[0]"]), "up_m")
