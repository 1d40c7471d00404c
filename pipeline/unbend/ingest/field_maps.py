"""Reads data/field_maps.toml, which declares the fields and roles of each message.

A field map assigns fields of a message to columns of a channel, with their units.
"""

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.ingest import messages
from unbend.units import MOST_FLAGS, Array, whole_numbers

_FILE = files("unbend.ingest").joinpath("data/field_maps.toml")
MAPS = tomllib.loads(_FILE.read_text("utf-8"))
# By unit: divisor, factor and offset to SI.
UNITS: Mapping[str, tuple[float, float, float]] = MAPS["units"]
# By kind of flags: the number of a bit in the log, and in the package.
FLAGS: Mapping[str, list[tuple[int, int]]] = MAPS["flags"]
# By unit: the column, and factor and offset to SI.
STATED_UNITS: Mapping[str, tuple[str, float, float]] = MAPS["stated_units"]

# "q_w q_x = q.0 q.1|old [unit] unless MISSING from FLOOR"
_COLUMN = re.compile(
    r"(?P<names>[\w ]+) = (?P<fields>[^\[ ]+(?: [^\[ ]+)*?)(?: \[(?P<unit>.+)\])?"
    r"(?: unless (?P<missing>\S+))?(?: from (?P<floor>\S+))?"
)

# The scaled integers of a log are numbers of these units: 8050 c% is 80.5 percent.
_NUMBERS_OF = {"cdegC": "degC", "%": "percent", "c%": "percent"}

_SAME_FLAGS = 0x3FF  # the lowest ten bits mean the same in all logs


@dataclass(frozen=True)
class FieldColumn:
    """One column of a channel, and the names of its field in all versions, newest first.

    ``missing`` is the value in the log that means unknown; values below ``floor`` mean it too.
    """

    name: str
    fields: tuple[str, ...]
    unit: str = ""
    missing: float | None = None
    floor: float | None = None


@dataclass(frozen=True)
class MessageMap:
    """One message and the channel it becomes."""

    columns: tuple[FieldColumn, ...]
    roles: tuple[str, ...] = ()
    rank: int = 50  # among candidates for a role the smallest is chosen
    id_field: str = ""  # distinguishes instances, where the format has none
    # If all messages have the same id, their channel is named without it.
    omits_only_id: bool = False
    time_field: str = "timestamp"  # the message's own time, where the format has none for all
    position: bool = False  # rows without a fix are dropped
    attitude: bool = False  # Euler angles become quaternions
    text_field: str = ""  # the words of the autopilot; there are no columns then
    # The rank of all instances but the first, because the numbers of instances do not show which
    # thermometer is outside; None if all have the same rank.
    spare_rank: int | None = None

    @property
    def event(self) -> bool:
        """Whether each row is an exposure."""
        return "events" in self.roles

    @property
    def fields(self) -> set[str]:
        """The names of all fields that its columns are made of, in all versions."""
        return {field for column in self.columns for field in column.fields}


def parse_columns(
    lines: Iterable[str],
    groups: Mapping[str, list[str]],
) -> Iterator[FieldColumn]:
    """Parse the lines of ``columns`` in ``data/field_maps.toml``.

    A line "@name" is replaced by the lines of that group. Raises ValueError for an invalid line.

    >>> [*parse_columns(["q_w q_x = q.0 q|old", "@a"], {"a": ["t_k = t [degC] unless 0"]})][1:]
    [FieldColumn(name='q_x', fields=('q', 'old'), unit='', missing=None, floor=None), \
FieldColumn(name='t_k', fields=('t',), unit='degC', missing=0.0, floor=None)]
    """
    for line in lines:
        if line.startswith("@"):
            group = groups[line[1:]]
            yield from parse_columns(group, groups)
            continue
        match = _COLUMN.fullmatch(line)
        if match is None:
            raise ValueError(line)
        names = match["names"].split()
        fields = match["fields"].split()
        for name, field in zip(names, fields, strict=True):
            yield FieldColumn(
                name=name,
                fields=tuple(field.split("|")),
                unit=match["unit"] or "",
                missing=_number_or_none(match["missing"]),
                floor=_number_or_none(match["floor"]),
            )


def _number_or_none(text: str | None) -> float | None:
    """The number in an optional part of a line; None where the line lacks that part."""
    return None if text is None else float(text)


@cache
def message_maps(section: str) -> dict[str, MessageMap]:
    """The messages of a format that become channels: a section of ``data/field_maps.toml``."""
    maps: dict[str, MessageMap] = {}
    for name, field_map in MAPS[section].items():
        options = dict(field_map)
        template = MessageMap(())
        if "like" in options:  # the keys of an earlier message, but its ranks, are the defaults
            earlier_name = options.pop("like")
            template = maps[earlier_name]
            template = replace(template, rank=MessageMap.rank, spare_rank=None)
        if "columns" in options:
            columns = parse_columns(options["columns"], MAPS["groups"])
            options["columns"] = tuple(columns)
        if "roles" in options:
            options["roles"] = tuple(options["roles"])
        maps[name] = replace(template, **options)
    return maps


def to_si(raw: NDArray[Any], spec: FieldColumn) -> Array:
    """Convert logged values to SI; NaN where the value means unknown or is not finite.

    Flags are not converted: their bits get the package's order.

    >>> to_si(np.array([-32768, 2000]), FieldColumn("temperature_k", ("t",), "cdegC", -32768))
    array([   nan, 293.15])
    """
    with np.errstate(invalid="ignore"):  # signalling NaNs
        value: Array = np.array(raw, np.float64)
    unknown = ~np.isfinite(value)
    if spec.missing is not None:
        unknown |= value == spec.missing
    if spec.floor is not None:
        unknown |= value < spec.floor
    if spec.unit in FLAGS:
        logged = np.where(unknown, 0.0, value)
        bits = whole_numbers(logged, 0, MOST_FLAGS)
        flags = _translated_flags(bits, FLAGS[spec.unit])
        return np.where(unknown, np.nan, flags.astype(np.float64))
    divisor, factor, offset = UNITS[spec.unit]
    value[unknown] = np.nan  # before the arithmetic, which warns of signalling NaNs
    value /= divisor  # in place: a column of a long log has hundreds of MB
    value *= factor
    value += offset
    return value


def _translated_flags(
    bits: NDArray[np.int64],
    pairs: list[tuple[int, int]],
) -> NDArray[np.int64]:
    """Flags of a log with their bits in the package's order.

    ``pairs``: the number of a bit in the log, and in the package; bits 0 to 9 are the same in both.
    """
    flags = bits & _SAME_FLAGS
    for logged_bit, package_bit in pairs:
        flags |= (bits >> logged_bit & 1) << package_bit
    return flags


def in_stated_unit(channel: Channel, role: str, unit: str) -> Channel:
    """Convert the column of a role to SI by the unit that the mission file states for it.

    ``unit``: a key of `STATED_UNITS`. It is applied to the column ``value``, which has no unit of
    its own; without one, to the column of the role, first converted back to the unit of the log.
    Example: a driver sends kPa in SCALED_PRESSURE, which is in hPa. 81.25 was read as 8125 Pa, and
    becomes 81,250 Pa if "kPa" is stated. A channel with neither column is returned unchanged.
    Raises MissionError (CHANNEL-UNIT) for a unit of another quantity.
    """
    column, factor, offset = STATED_UNITS[unit]
    if column not in ROLE_COLUMNS[role]:
        raise messages.not_a_unit_of_role(role=role, unit=unit, columns=ROLE_COLUMNS[role])
    numbers = channel.columns.get("value")
    if numbers is None and column in channel.columns:
        unit_of_log = channel.logged_units.get(column, "")
        unit_of_numbers = _NUMBERS_OF.get(unit_of_log, unit_of_log)
        as_in_si = (column, 1.0, 0.0)
        _, log_factor, log_offset = STATED_UNITS.get(unit_of_numbers, as_in_si)
        numbers = (channel[column] - log_offset) / log_factor
    if numbers is None:
        return channel
    columns = dict(channel.columns)
    columns[column] = numbers * factor + offset
    return replace(channel, columns=columns)


def is_number(column: NDArray[Any]) -> bool:
    """Whether a column has one number a row."""
    return column.ndim == 1 and column.dtype.kind in "biuf"


def extract(
    table: Mapping[str, NDArray[Any]],
    columns: tuple[FieldColumn, ...],
    stored: Callable[[Array], Array] = np.asarray,
    used_up: dict[str, NDArray[Any]] | None = None,
) -> dict[str, Array]:
    """Convert the fields of a decoded message to the ``columns`` of its field map, in SI.

    A column without a field of numbers in the ``table`` is left out. Speed and course become
    velocity, the vibrations of several axes their maximum, the clippings of several sensors their
    sum. ``stored`` returns the array in which a column is kept, for example a copy. Fields that no
    further column needs are removed from ``used_up``, because memory has its peak here.
    """
    result: dict[str, Array] = {}
    # the last column that each field may become: later columns replace earlier ones here
    last_use = {field: spec.name for spec in columns for field in spec.fields}
    for spec in columns:
        field = _field_of(spec, table)
        if field is None:
            continue
        in_si = to_si(table[field], spec)
        result[spec.name] = stored(in_si)
        if used_up is not None and last_use[field] == spec.name:
            del used_up[field]
    _make_velocity(result, stored)
    vibrations = _popped(result, "vibration_m_s2_")
    if vibrations:
        worst = np.fmax.reduce(vibrations)
        result["vibration_m_s2"] = stored(worst)
    clippings = _popped(result, "clipping_")
    if clippings:
        total = np.add.reduce(clippings)
        result["clipping"] = stored(total)
    return result


def _make_velocity(
    columns: dict[str, Array],
    stored: Callable[[Array], Array],
) -> None:
    """Replace speed and course by the horizontal velocity, in place.

    The vertical velocity becomes NaN in rows that mark it as not measured.
    """
    if "speed_m_s" in columns and "course_rad" in columns:
        speed = columns.pop("speed_m_s")
        course = columns.pop("course_rad")
        columns["v_north_m_s"] = stored(speed * np.cos(course))
        columns["v_east_m_s"] = stored(speed * np.sin(course))
    has_vertical_speed = columns.pop("has_vertical_speed", None)  # 0: not measured
    if has_vertical_speed is not None and "v_down_m_s" in columns:
        columns["v_down_m_s"][has_vertical_speed == 0.0] = np.nan


def _field_of(spec: FieldColumn, table: Mapping[str, NDArray[Any]]) -> str | None:
    """The first field of a column that the table has with numbers; None without any."""
    for field in spec.fields:
        if field in table and is_number(table[field]):
            return field
    return None


def _popped(columns: dict[str, Array], prefix: str) -> list[Array]:
    """Remove the columns with a prefix in their names; returns them, sorted by name."""
    names = sorted(name for name in columns if name.startswith(prefix))
    return [columns.pop(name) for name in names]


PX4_MESSAGES: Mapping[str, MessageMap] = message_maps("px4")
"""By name in px4_msgs; PX4 logs the same to .ulg and, over ROS 2, to MCAP."""


def topic_of(name: str) -> str:
    """The topic of PX4 on which messages of a name are published.

    >>> topic_of("VehicleGpsPosition")
    'vehicle_gps_position'
    """
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


PX4_TOPICS: Mapping[str, MessageMap] = {topic_of(name): spec for name, spec in PX4_MESSAGES.items()}

UTC_FIELD = "time_utc_usec"  # Unix time [us] of receivers, logged with their time since boot
# Unix time [us] of an exposure, by the autopilot's own clock, which it sets now and then.
CAPTURE_UTC_FIELD = "timestamp_utc"
