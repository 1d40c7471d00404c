"""Faults of receivers, filters and barometers, put into the channels of a good log.

The filter is a small model of its own: it takes the receiver's error in by steps, rejects what is
beyond its gate, coasts on a biased accelerometer, and resets to the receiver when it has rejected
it for too long. What it logs (position, velocity, tilt, innovation ratio, texts) follows from that.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from unbend.flight.channels import Channel, Source

SECOND = 1_000_000_000
RADIUS_M = 6_371_000.0
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


@dataclass
class Fault:
    """One fault: what, from when to when, how large, and what it does to a place [m]."""

    kind: str
    begin_ns: int
    end_ns: int
    size_m: float
    detail: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        length_s = (self.end_ns - self.begin_ns) / SECOND
        more = "".join(f", {name} {value:.3g}" for name, value in self.detail.items())
        return f"{self.kind} of {self.size_m:.0f} m for {length_s:.0f} s{more}"


def with_columns(channel: Channel, **columns: np.ndarray) -> Channel:
    return replace(channel, columns=dict(channel.columns) | columns)


def displaced(channel: Channel, north: np.ndarray, east: np.ndarray) -> Channel:
    """The channel with its places moved by (n,) metres."""
    lat = channel["lat_rad"]
    lon = channel["lon_rad"]
    return with_columns(
        channel,
        lat_rad=lat + north / RADIUS_M,
        lon_rad=lon + east / RADIUS_M / np.cos(lat),
    )


def raised(
    channel: Channel, by: np.ndarray, names: tuple[str, ...] = ("h_msl_m", "h_home_m")
) -> Channel:
    present = [name for name in names if name in channel.columns]
    return with_columns(channel, **{name: channel[name] + by for name in present})


def second_receiver(first: Channel, rng: np.random.Generator) -> Channel:
    """Another receiver of the flight: noise of its own, an antenna 0.4 m away, 30 ms later."""
    n = len(first)
    walk = np.convolve(rng.normal(0.0, 0.35, (n + 200)), np.ones(200) / 200**0.5, "valid")[:n]
    noise = rng.normal(0.0, 0.08, (3, n)) + walk * rng.choice([-0.5, 0.5], (3, 1))
    other = displaced(first, noise[0] + 0.4, noise[1])
    other = raised(other, noise[2] + 0.1, ("h_msl_m", "h_ellipsoid_m"))
    return replace(
        other, name="GPS[1]", source=Source("GPS", "1"), rank=30, time_ns=first.time_ns + 30_000_000
    )


def filter_errors(
    time_ns: np.ndarray,
    gps_ns: np.ndarray,
    gps_error: np.ndarray,
    fix: np.ndarray,
    rng: np.random.Generator,
    *,
    retry_s: float,
    bias_m_s2: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors of place and velocity (n, 2), innovation ratios and tilt [rad] (n,) of a filter."""
    n = time_ns.size
    place = np.zeros((n, 2))
    speed = np.zeros((n, 2))
    ratio = np.zeros(n)
    tilt = np.zeros(n)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    bias = bias_m_s2 * np.array([np.cos(heading), np.sin(heading)])
    # north + i east: numbers, which are fast
    e_p = 0j
    e_v = 0j
    unaided = 0.0
    shown = 0.0
    nearest = (np.searchsorted(gps_ns, time_ns, side="right") - 1).tolist()
    steps = (np.diff(time_ns) / SECOND).tolist()
    errors = (gps_error @ [1.0, 1j]).tolist()
    pull = complex(*bias)
    last = -1
    for k, dt in enumerate(steps, start=1):
        if unaided > 0.5:  # what an aided filter has estimated away comes back by and by
            e_v += pull * dt
            e_p += e_v * dt
        unaided += dt
        row = nearest[k]
        if row != last and row >= 0:
            last = row
            if fix[row]:
                innovation = errors[row] - e_p
                gate = GATE_M + 0.3 * max(unaided - 1.0, 0.0)
                shown = abs(innovation) / gate
                if shown < 1.0:
                    e_p = e_p + 0.25 * innovation
                    e_v = 0.5 * e_v
                    unaided = 0.0
                elif unaided > retry_s:
                    e_p = errors[row]
                    e_v = 0j
                    unaided = 0.0
        place[k], speed[k], ratio[k] = (e_p.real, e_p.imag), (e_v.real, e_v.imag), shown
        tilt[k] = min(unaided, 10.0) / 10.0 * bias_m_s2 / 9.81
    return place, speed, ratio, tilt


def tilted(channel: Channel, angle: np.ndarray, azimuth: float) -> Channel:
    """An attitude turned by (n,) small angles [rad] about a level axis."""
    from scipy.spatial.transform import Rotation

    stored = Rotation.from_quat(np.stack([channel[f"q_{a}"] for a in "xyzw"], axis=1))
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turned = (Rotation.from_rotvec(angle[:, None] * axis) * stored).as_quat(canonical=True)
    return with_columns(channel, **{f"q_{a}": turned[:, k] for k, a in enumerate("xyzw")})


def says(channels: dict[str, Channel], *texts: tuple[int, str]) -> None:
    """Add lines to what the autopilot says."""
    old = channels["MSG"]
    lines = sorted([*zip(old.time_ns.tolist(), old.labels["text"], strict=True), *texts])
    channels["MSG"] = replace(
        old,
        time_ns=np.array([t for t, _ in lines], np.int64),
        boot=np.zeros(len(lines), np.int16),
        labels={"text": tuple(text for _, text in lines)},
    )


def inject(
    good: dict[str, Channel], kind: str, around_ns: int, rng: np.random.Generator
) -> tuple[dict[str, Channel], Fault]:
    """The channels of a log with one fault of a kind that holds an instant."""
    channels = dict(good)
    gps = channels["GPS[0]"]
    pos = channels["POS"]
    health = channels["XKF4[0]"]
    length_s = float(rng.uniform(6.0, 40.0))
    begin = around_ns - round(rng.uniform(0.1, 0.9) * length_s * SECOND)
    fault = Fault(kind, begin, begin + round(length_s * SECOND), float(rng.uniform(20.0, 100.0)))
    if kind == "wind-up":
        return _wound_up(channels, fault, rng), fault
    two = kind in ("swap", "drift") or rng.random() < 0.4
    if two:
        channels["GPS[1]"] = second_receiver(gps, rng)
    inside = (gps.time_ns >= fault.begin_ns) & (gps.time_ns <= fault.end_ns)
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    to = np.array([np.cos(azimuth), np.sin(azimuth)])
    up = np.where(inside, rng.uniform(-0.6, 0.6) * fault.size_m, 0.0)
    if kind == "height glitch":
        up = np.where(inside, rng.choice([-1.0, 1.0]) * fault.size_m, 0.0)
        channels["GPS[0]"] = raised(gps, up, ("h_msl_m", "h_ellipsoid_m"))
        return channels, fault
    amount = np.where(inside, fault.size_m, 0.0)
    if kind == "drift":
        rate = float(rng.uniform(1.0, 3.0))
        fault.detail["m/s"] = rate
        since = gps.time_ns - fault.begin_ns
        until = fault.end_ns - gps.time_ns
        returns = rng.random() < 0.5  # as slowly as it went, or by a step
        seconds = (np.minimum(since, until) if returns else since) / SECOND
        amount = np.where(inside, rate * seconds, 0.0)
        up = 0.3 * amount
        if rng.random() < 0.5:  # the Doppler velocity is led away too
            gps = with_columns(
                gps,
                **{
                    f"v_{name}_m_s": gps[f"v_{name}_m_s"] + np.where(inside, rate * to[k], 0.0)
                    for k, name in enumerate(("north", "east"))
                },
            )
    error = amount[:, None] * to
    fix = np.ones(len(gps), bool)
    bias = float(rng.uniform(0.02, 0.15))
    retry_s = 0.0 if kind == "followed" else float(rng.uniform(7.0, 12.0))
    fused = error
    if kind == "swap":
        # The second receiver is off by a constant for the whole flight; the filter goes over to it.
        fault.size_m = float(rng.uniform(6.0, 40.0))
        offset = fault.size_m * to
        other = displaced(channels["GPS[1]"], *(np.full(len(gps), x) for x in offset))
        channels["GPS[1]"] = other
        fused = np.where(inside[:, None], offset, 0.0)
        error = np.zeros((len(gps), 2))
        up = np.zeros(len(gps))
        retry_s = 0.0
        says(channels, (fault.begin_ns, "EV GPS_PRIMARY_CHANGED"))
    if kind == "no fix":
        fused = np.zeros((len(gps), 2))
        error = np.zeros((len(gps), 2))
        up = np.zeros(len(gps))
        fix = ~inside
    places, speed, ratio, tilt = filter_errors(
        pos.time_ns, gps.time_ns, fused, fix, rng, retry_s=retry_s, bias_m_s2=bias
    )
    if kind == "dead reckoning":  # the autopilot leaves the filter: DCM, which goes by the receiver
        begin_dcm = fault.begin_ns + round(rng.uniform(0.3, 2.0) * SECOND)
        of_dcm = (pos.time_ns > begin_dcm) & (pos.time_ns < fault.end_ns + SECOND)
        row = np.maximum(np.searchsorted(gps.time_ns, pos.time_ns, side="right") - 1, 0)
        places = np.where(of_dcm[:, None], error[row], places)
        says(
            channels, (begin_dcm, "AHRS: DCM active"), (fault.end_ns + SECOND, "AHRS: EKF3 active")
        )
    channels["GPS[0]"] = raised(displaced(gps, *error.T), up, ("h_msl_m", "h_ellipsoid_m"))
    if not fix.all():
        channels["GPS[0]"] = channels["GPS[0]"].rows(fix)
    channels["POS"] = displaced(pos, *places.T)
    for name in ("ATT", "XKF1[0]", "XKQ[0]"):
        at = np.interp(channels[name].time_ns, pos.time_ns, tilt)
        channels[name] = tilted(channels[name], at, azimuth)
    if kind == "dead reckoning":
        att = channels["ATT"]
        dcm = good["AHR2"]
        take = (att.time_ns > begin_dcm) & (att.time_ns < fault.end_ns + SECOND)
        row = np.clip(np.searchsorted(dcm.time_ns, att.time_ns), 0, len(dcm) - 1)
        channels["ATT"] = with_columns(
            att, **{f"q_{a}": np.where(take, dcm[f"q_{a}"][row], att[f"q_{a}"]) for a in "wxyz"}
        )
    lane = channels["XKF1[0]"]
    channels["XKF1[0]"] = with_columns(
        lane,
        **{
            f"v_{name}_m_s": lane[f"v_{name}_m_s"]
            + np.interp(lane.time_ns, pos.time_ns, speed[:, k])
            for k, name in enumerate(("north", "east"))
        },
    )
    shown = np.interp(health.time_ns, pos.time_ns, ratio)
    channels["XKF4[0]"] = with_columns(
        health, innovation_position=np.fmax(health["innovation_position"], np.round(shown, 2))
    )
    fault.detail["bias"] = bias
    fault.detail["receivers"] = 1 + two
    return channels, fault


def _wound_up(
    channels: dict[str, Channel], fault: Fault, rng: np.random.Generator
) -> dict[str, Channel]:
    """A barometer whose pressure creeps away and back, and the filter's height with it."""
    ramp_s = float(rng.uniform(20.0, 120.0))
    fault.begin_ns -= round(ramp_s * SECOND)
    fault.end_ns += round(ramp_s * SECOND)
    fault.size_m = float(rng.uniform(15.0, 60.0)) * rng.choice([-1.0, 1.0])
    corners = fault.begin_ns + np.array([0.0, ramp_s, 0.0, 0.0]) * SECOND
    corners[2:] = fault.end_ns - np.array([ramp_s, 0.0]) * SECOND

    def climb(time_ns: np.ndarray) -> np.ndarray:
        return np.interp(time_ns, corners, fault.size_m * np.array([0.0, 1.0, 1.0, 0.0]))

    both = rng.random() < 0.4  # on one static line
    fault.detail["barometers"] = 1 + both
    for name in ("BARO[0]", "BARO[1]")[: 1 + both]:
        baro = channels[name]
        scale = np.exp(-climb(baro.time_ns) / 8000.0)
        channels[name] = with_columns(baro, pressure_pa=baro["pressure_pa"] * scale)
    pos = channels["POS"]
    lane = channels["XKF1[0]"]
    channels["POS"] = raised(pos, climb(pos.time_ns))
    channels["XKF1[0]"] = raised(lane, climb(lane.time_ns), ("up_m",))
    return channels
