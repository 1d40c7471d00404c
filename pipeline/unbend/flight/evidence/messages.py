"""The messages on the evidence of a log: codes, and a function for each message and refusal."""

import math

from unbend.errors import Code, Counted, MissionError
from unbend.messages import Message, fallback, finding, loss, note, warning

SENSOR_RANGE = Code(
    "SENSOR-RANGE",
    means=(
        "Samples are outside what is physically possible, are not numbers, or are heights that "
        "jump away and back."
    ),
    effect="They are not used.",
    remedy="Check the sensor, if there are many.",
)


def samples_out_of_range(
    *, channel: str, column: str, count: int, total: int, limits: str
) -> Message:
    """Samples that cannot be true."""
    return loss(
        SENSOR_RANGE,
        "{count} of {total_samples} of {column} are {limits} and are not used",
        one="1 of {total_samples} of {column} is {limits} and is not used",
        where=channel,
        count=count,
        total_samples=Counted(total, "sample"),
        column=column,
        limits=limits,
    )


def samples_not_a_number(*, channel: str, column: str, count: int, total: int) -> Message:
    """Samples without a value."""
    return samples_out_of_range(
        channel=channel, column=column, count=count, total=total, limits="not a number"
    )


def heights_impossible(
    *, channel: str, column: str, count: int, total: int, first_m: float, first_row: int
) -> Message:
    """Heights out of range, or that jump there and back."""
    return loss(
        SENSOR_RANGE,
        (
            "{count} of {total_values} of {column} are impossible, or jump away and back; the "
            "first is {first_m:.0f} m in row {first_row}; not used"
        ),
        one=(
            "1 of {total_values} of {column} is impossible, or jumps away and back: {first_m:.0f} "
            "m in row {first_row}; not used"
        ),
        where=channel,
        count=count,
        total_values=Counted(total, "value"),
        column=column,
        first_m=first_m,
        first_row=first_row,
    )


SENSOR_JUMP = Code(
    "SENSOR-JUMP",
    means="Samples jump faster than a vehicle or the air can change.",
    effect="They are not used.",
    remedy="Check the sensor, if there are many.",
)


def samples_jump(*, where: str, count: int, total: int, first_s: float) -> Message:
    """Samples that cannot be reached in time from the samples before and after them."""
    return loss(
        SENSOR_JUMP,
        "{count} of {total_samples} jump faster than a vehicle or the air can change, the first "
        "{first_s:.3f} s after the first sample; not used",
        one="1 of {total_samples} jumps faster than a vehicle or the air can change, "
        "{first_s:.3f} s after the first sample; not used",
        where=where,
        count=count,
        total_samples=Counted(total, "sample"),
        first_s=first_s,
    )


SENSOR_CONSTANT = Code(
    "SENSOR-CONSTANT",
    means=(
        "All values of a sensor are equal to the last digit, although the aircraft moved. The "
        "sensor is stuck, or its values were never sent."
    ),
    effect="They are used. If the sensor is stuck, all results from these values are wrong.",
    remedy="Name another channel for the role, or state under `accept` why the values are right.",
)


def sensor_constant(*, channel: str, role: str, what: str, count: int, moved: str) -> Message:
    """A value (``what``, in words) that never changes although the flight moved (``moved``)."""
    return finding(
        SENSOR_CONSTANT,
        "all {samples} of the {role} have {what}, although {moved}",
        where=channel,
        count=count,
        samples=Counted(count, "sample"),
        role=role,
        what=what,
        moved=moved,
    )


SENSOR_NOISE = Code(
    "SENSOR-NOISE",
    means="Samples jump so often that the wrong ones cannot be identified.",
    effect="All are used.",
    remedy="Check the sensor, or name another channel.",
)


def samples_are_noise(*, where: str, count: int, total: int) -> Message:
    """A series with so many jumps that the wrong samples cannot be identified."""
    return warning(
        SENSOR_NOISE,
        (
            "{count} of {total_samples} differ from the sample before by more than a vehicle or "
            "the air can change: the wrong ones cannot be identified"
        ),
        where=where,
        count=count,
        total_samples=Counted(total, "sample"),
    )


SENSOR_ODD = Code(
    "SENSOR-ODD",
    means=(
        "The median of a column is outside the range of its quantity. It has another unit, or does "
        "not measure air or aircraft."
    ),
    effect="It is not checked further.",
    remedy="If it is used, state its unit under log.channels.",
)


def median_is_odd(
    *, channel: str, column: str, samples: int, median: float, limits: str
) -> Message:
    """The median of a column is outside what can be true."""
    return warning(
        SENSOR_ODD,
        "the median of {column} is {median:.4g}, {limits}: it has another unit, or does not "
        "measure air or aircraft; its samples are not checked",
        where=channel,
        count=samples,
        column=column,
        median=median,
        limits=limits,
    )


ATTITUDE_ALIGNED = Code(
    "ATTITUDE-ALIGNED",
    means="The attitude jumped and stayed there, as it does when the filter is aligned or reset.",
    effect="The samples of the jump are not used.",
    remedy="Nothing, unless images were taken at this time.",
)


def attitude_aligned(*, where: str, count: int) -> Message:
    """An attitude that jumps and stays: the filter was aligned or reset."""
    return note(
        ATTITUDE_ALIGNED,
        "not used: {count} samples in which the filter was aligned or reset",
        one="not used: 1 sample in which the filter was aligned or reset",
        where=where,
        count=count,
    )


CHANNEL_UNIT = Code(
    "CHANNEL-UNIT",
    means=(
        "The values of a channel look like another unit, or the stated unit is not a unit of its "
        "quantity."
    ),
    effect="The mission is refused.",
    remedy="State the unit: log.channels.<role>: {name: NAME, unit: hPa}.",
)


def unit_looks_wrong(
    *, channel: str, role: str, column: str, median: float, unit: str
) -> MissionError:
    """The median of a column has the size of another unit."""
    return MissionError(
        CHANNEL_UNIT,
        "the median of {column} is {median:.4g}: that looks like {unit}",
        where=f"channel {channel}, role {role}",
        remedy=(
            'state it in the mission file: log.channels.{role}: {{name: "{channel}", unit: {unit}}}'
        ),
        channel=channel,
        role=role,
        column=column,
        median=median,
        unit=unit,
    )


BARO_DRIFT = Code(
    "BARO-DRIFT",
    means=(
        "In a part of the flight, the pressure of the barometer drifts away from the GNSS height."
    ),
    effect="Its pressure is not used there.",
    remedy="Check the barometer: a blocked port or icing causes such a drift.",
)


def barometer_drifts(*, barometer: str, reason: str, when: str) -> Message:
    """A barometer drifts from the height of a receiver that is right; its pressure is removed."""
    return warning(
        BARO_DRIFT,
        "{reason}: its pressure is not used from {when}",
        where=barometer,
        reason=reason,
        when=when,
    )


def spare_barometer_drifts(*, barometer: str, reason: str, when: str) -> Message:
    """A barometer drifts from the height of a receiver that is right; no station uses it."""
    return note(
        BARO_DRIFT,
        "{reason} from {when}; no station uses this barometer",
        where=barometer,
        reason=reason,
        when=when,
    )


STATIONS_STAND_IN = Code(
    "STATIONS-STAND-IN",
    means="In a part of the flight, another source replaces a source that is wrong.",
    effect="Its values are used there.",
    remedy="Nothing; see the reason.",
)


def another_source_stands_in(
    *, count: int, when: str, first: str, quantity: str, source: str, reason: str
) -> Message:
    """Exposures in a stretch in which another source replaces the position or height."""
    return fallback(
        STATIONS_STAND_IN,
        "{exposures} from {when}, the first {first}: {where} from {source}, because {reason}",
        where=quantity,
        count=count,
        exposures=Counted(count, "exposure"),
        when=when,
        first=first,
        source=source,
        reason=reason,
    )


STATIONS_SUSPECT = Code(
    "STATIONS-SUSPECT",
    means="In a part of the flight the log contradicts itself, and there is no other source.",
    effect=(
        "These stations are suspect. They have no corrected values unless stations.use_suspect is "
        "true."
    ),
    remedy="See the reason. Give a post-processed trajectory.",
)


def stations_suspect(
    *, count: int, when: str, first: str, quantity: str, off_m: float | None, reason: str
) -> Message:
    """Exposures in a stretch where evidence contradicts a quantity."""
    far = "" if off_m is None else f", up to {off_m:.0f} m off"
    return loss(
        STATIONS_SUSPECT,
        "{exposures} from {when}, the first {first}: {where} is suspect{far}: {reason}",
        where=quantity,
        count=count,
        exposures=Counted(count, "exposure"),
        when=when,
        first=first,
        far=far,
        reason=reason,
    )


EVENTS_ELSEWHERE = Code(
    "EVENTS-ELSEWHERE",
    means=(
        "The log has places, heights or attitudes of exposures, and the stations contradict them."
    ),
    effect="The stations are not changed. The run ends with exit code 3.",
    remedy=(
        "Check the channel of the events, their vehicle, their clock and delay_s. Or accept the "
        "finding with the reason."
    ),
)


def exposures_elsewhere(
    *,
    channel: str,
    count: int,
    total: int,
    position: str,
    off_m: float,
    limit_m: float,
    shift_s: float,
) -> Message:
    """The places that a log has of exposures are far from the flight at that time.

    ``shift_s`` : shift of time that explains them, positive if the flight is there later; NaN if
    none does.
    """
    likely = "likely the events of another vehicle or flight"
    if math.isfinite(shift_s):
        likely = (
            f"these are its places {abs(shift_s):.2f} s {'later' if shift_s > 0 else 'earlier'}"
        )
    return finding(
        EVENTS_ELSEWHERE,
        (
            "for {count} of {exposures}, the log has a place of the exposure that is up to "
            "{off_m:.0f} m from {position} at that time, expected within {limit_m:.0f} m: {likely}"
        ),
        where=channel,
        count=count,
        exposures=Counted(total, "exposure"),
        position=position,
        off_m=off_m,
        limit_m=limit_m,
        likely=likely,
    )


def exposures_at_other_heights(
    *,
    channel: str,
    column: str,
    count: int,
    total: int,
    height: str,
    off_m: float,
    limit_m: float,
) -> Message:
    """The heights that a log has of exposures are far from all heights of the flight."""
    return finding(
        EVENTS_ELSEWHERE,
        (
            "for {count} of {exposures}, the log has a height of the exposure ({column}) that is "
            "up to {off_m:.0f} m from any of {height} at that time, expected within {limit_m:.0f} "
            "m: likely the events of another vehicle or time"
        ),
        where=channel,
        count=count,
        exposures=Counted(total, "exposure"),
        column=column,
        height=height,
        off_m=off_m,
        limit_m=limit_m,
    )


def exposures_tilted_otherwise(
    *, channel: str, count: int, total: int, attitude: str, off_deg: float, limit_deg: float
) -> Message:
    """The verticals that a log has of exposures differ from that of the flight at that time."""
    return finding(
        EVENTS_ELSEWHERE,
        (
            "for {count} of {exposures}, the log has an attitude of the exposure; its vertical is "
            "up to {off_deg:.1f} deg from that of {attitude} at that time, expected within "
            "{limit_deg:.1f} deg: likely the events of another vehicle or time, or a camera on a "
            "gimbal"
        ),
        where=channel,
        count=count,
        exposures=Counted(total, "exposure"),
        attitude=attitude,
        off_deg=off_deg,
        limit_deg=limit_deg,
    )
