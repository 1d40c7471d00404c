"""What filter, autopilot and second attitudes say against a flight, as suspect stretches."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.evidence.stretches import ATTITUDE, POSITION, SECOND, Stretch, beside, runs
from unbend.flight.rotations import down_in_body
from unbend.flight.trajectory import interpolate
from unbend.units import Array

# A difference of the verticals of two attitudes that is noise, whatever is usual [deg].
NOISE_TILT_DEG = 1.5
# A filter has recovered when its innovation ratios have been below this for so long.
SETTLED_RATIO, SETTLED_S = 0.7, 3.0

# What bits of filter_flags say.
_FLAGS = {"the filter sees a GPS glitch": 1 << 15, "the filter is dead reckoning": 1 << 18}

# What an autopilot says when its position or attitude is suspect, and when no longer.
_TROUBLE = re.compile(
    r"DCM active|dead.?reckon|GPS glitch|EKF[ _]variance|EKF failsafe|stopped aiding|lane switch"
    r"|primary changed|forced reset|emergency yaw|GPS (signal )?lost|EV GPS_PRIMARY_CHANGED"
    r"|ERR (EKFCHECK|FAILSAFE_EKFINAV|FAILSAFE_GPS|GPS|FAILSAFE_DEADRECKON|EKF_PRIMARY) [1-9]"
    r"|(position|navigation).*(fail|invalid)",
    re.IGNORECASE,
)
_OVER = re.compile(
    r"EKF\d? active|cleared|using GPS|regained|reckoning (ended|stopped)|"
    r"ERR (EKFCHECK|FAILSAFE_EKFINAV|FAILSAFE_GPS|GPS|FAILSAFE_DEADRECKON) 0",
    re.IGNORECASE,
)
_MOMENTARY = re.compile(r"lane switch|primary|forced reset|emergency yaw", re.IGNORECASE)
_OF_ATTITUDE = re.compile(r"DCM|lane|EKF.primary|forced|yaw", re.IGNORECASE)


def filter_evidence(channels: Sequence[Channel]) -> list[Stretch]:
    """What the filter says of itself: innovations, health, clipping accelerometers.

    Innovation ratios above 1 are rejected measurements. Of several lanes the best counts, which is
    the one an autopilot flies by.
    """
    found = []
    kinds = {
        "innovation_position": (POSITION, "the filter rejected the receiver's position"),
        "innovation_velocity": (ATTITUDE, "the filter rejected the receiver's velocity"),
        "innovation_compass": (ATTITUDE, "the filter rejected the compass"),
    }
    for column, (quantity, reason) in kinds.items():
        lanes = [c for c in channels if column in c.columns]
        if not lanes:
            continue
        time_ns, ratio = lanes[0].time_ns, lanes[0][column]
        for lane in lanes[1:]:
            ratio = np.fmin(ratio, interpolate(lane, column, time_ns, lane.gap_limit_s(2.0)))
        for a, b in runs(time_ns, ratio > SETTLED_RATIO, ratio > 1.0, SETTLED_S):
            lasts_s = (time_ns[b] - time_ns[a]) * 1e-9
            worst = float(np.nanmax(ratio[a : b + 1]))
            if worst < 2.0 and lasts_s < (5.0 if column == "innovation_compass" else 0.5):
                continue
            why = f"{reason} (innovation ratio {worst:.3g})"
            found.append(Stretch(*beside(time_ns, a, b), quantity, why))
            if column == "innovation_velocity":
                found.append(replace(found[-1], quantity=POSITION))
    for channel in channels:
        time_ns = channel.time_ns
        if "filter_flags" in channel.columns:
            flags = np.nan_to_num(channel["filter_flags"]).astype(np.int64)
            for why, bit in _FLAGS.items():
                pairs = runs(time_ns, flags & bit > 0, flags & bit > 0, SETTLED_S)
                found += [Stretch(*beside(time_ns, a, b), POSITION, why) for a, b in pairs]
        if "clipping" in channel.columns and len(channel) > 1:
            rate = np.append(0.0, np.diff(channel["clipping"]) / np.diff(time_ns) * SECOND)
            for a, b in runs(time_ns, rate > 50.0, rate > 100.0):
                if time_ns[b] - time_ns[a] > 2 * SECOND:
                    why = f"the accelerometers clip {rate[a : b + 1].max():.0f} times a second"
                    found.append(Stretch(*beside(time_ns, a, b), ATTITUDE, why))
    return found


def message_evidence(channels: Sequence[Channel]) -> list[Stretch]:
    """What the autopilot says of its position and attitude, until it says that this is over.

    A switch from one filter to another counts for 5 s. It takes half a second to say so.
    """
    found = []
    for channel in channels:
        texts = channel.labels.get("text", ())
        for row, text in enumerate(texts):
            for line in filter(_TROUBLE.search, text.splitlines()):
                begin = int(channel.time_ns[row]) - SECOND // 2
                end = begin + 5 * SECOND
                if not _MOMENTARY.search(line):
                    later = range(row + 1, len(texts))
                    over = [k for k in later if _OVER.search(texts[k])]
                    boot = int(channel.time_ns[channel.boot == channel.boot[row]][-1])
                    end = max(end, int(channel.time_ns[over[0]]) if over else boot + 3600 * SECOND)
                stretch = Stretch(begin, end, POSITION, f'the autopilot says "{line.strip()}"')
                found.append(stretch)
                if _OF_ATTITUDE.search(line):
                    found.append(replace(stretch, quantity=ATTITUDE))
    return found


def attitude_evidence(attitude: Channel, channels: Sequence[Channel]) -> list[Stretch]:
    """Where the vertical of an attitude differs from that of another, beyond what is usual.

    What the aircraft turns in 0.2 s does not count: times of telemetry are no better.
    """

    def vertical(c: Channel) -> Channel:
        return replace(c, columns=dict(zip("xyz", down_in_body(c), strict=True)), labels={})

    def down_at(c: Channel, time_ns: TimeArray) -> Array:
        return np.stack([interpolate(c, axis, time_ns, c.gap_limit_s(1.0)) for axis in "xyz"])

    def angle(a: Array, b: Array) -> Array:
        half = np.clip(0.5 * np.linalg.norm(a - b, axis=0), 0.0, 1.0)
        return np.asarray(np.degrees(2.0 * np.arcsin(half)))

    found, mine = [], vertical(attitude)
    for other in channels:
        if other.name == attitude.name or ATTITUDE not in other.roles or len(other) < 2:
            continue
        time_ns, theirs = other.time_ns, down_at(vertical(other), other.time_ns)
        own, late, early = (down_at(mine, time_ns + k * SECOND // 10) for k in (0, 1, -1))
        tilt = angle(own, theirs) - np.nan_to_num(angle(late, early))
        if not np.isfinite(tilt).any():
            continue
        limit = max(NOISE_TILT_DEG, 3.0 * float(np.nanpercentile(tilt, 95.0)))
        for a, b in runs(time_ns, tilt > 0.5 * limit, tilt > limit):
            if np.count_nonzero(tilt[a : b + 1] > limit) > 1:
                worst = float(np.nanmax(angle(own, theirs)[a : b + 1]))
                why = f"{attitude.name} and {other.name} are {worst:.1f} deg apart"
                found.append(Stretch(*beside(time_ns, a, b), ATTITUDE, why))
    return found
