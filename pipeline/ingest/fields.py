"""Field maps: which field of a message is which column of a channel, in which unit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissionError
from pipeline.flight.channels import ROLE_COLUMNS, Channel
from pipeline.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K, Array

# unit in the log -> (divisor, factor, offset): SI = value / divisor * factor + offset. Division
# where the log holds scaled integers: x / 1e7 is the nearest double, x * 1e-7 is not.
UNITS: Mapping[str, tuple[float, float, float]] = {
    "": (1.0, 1.0, 0.0),
    "deg": (1.0, DEGREE, 0.0),
    "degE7": (1e7, DEGREE, 0.0),
    "cdeg": (100.0, DEGREE, 0.0),
    "mm": (1e3, 1.0, 0.0),
    "m plane": (2**0.5, 1.0, 0.0),  # a distance rms in the plane, per axis
    "mm plane": (1e3 * 2**0.5, 1.0, 0.0),
    "cm": (100.0, 1.0, 0.0),
    "ms": (1e3, 1.0, 0.0),
    "1/100": (100.0, 1.0, 0.0),
    "-": (1.0, -1.0, 0.0),  # of the other sign
    "hPa": (1.0, HECTOPASCAL, 0.0),
    "degC": (1.0, 1.0, ZERO_CELSIUS_K),
    "cdegC": (100.0, 1.0, ZERO_CELSIUS_K),
    "%": (100.0, 1.0, 0.0),
    "c%": (1e4, 1.0, 0.0),
}

# Bits 0 to 9 of the flags of a filter are the same everywhere; of others, where they are -> where
# they are in `Channel.columns`. Sources: EKF_STATUS_FLAGS and ESTIMATOR_STATUS_FLAGS of MAVLink's
# common.xml, nav_filter_status in ArduPilot's AP_Nav_Common.h (XKF4.SS).
FLAGS: Mapping[str, tuple[tuple[int, int], ...]] = {
    "EKF_STATUS_FLAGS": ((10, 10), (15, 15)),
    "ESTIMATOR_STATUS_FLAGS": ((10, 15),),
    "nav_filter_status": ((14, 15), (18, 18)),
}

# unit that a mission file may state -> (column, factor, offset): SI = number * factor + offset
STATED_UNITS: Mapping[str, tuple[str, float, float]] = {
    "Pa": ("pressure_pa", 1.0, 0.0),
    "hPa": ("pressure_pa", HECTOPASCAL, 0.0),
    "kPa": ("pressure_pa", 1000.0, 0.0),
    "K": ("temperature_k", 1.0, 0.0),
    "degC": ("temperature_k", 1.0, ZERO_CELSIUS_K),
    "fraction": ("relative_humidity", 1.0, 0.0),
    "percent": ("relative_humidity", 0.01, 0.0),
    "m/s": ("airspeed_m_s", 1.0, 0.0),
}
# The scaled integers of a log are numbers of these units: 8050 c% is 80.5 percent.
_NUMBERS_OF = {"cdegC": "degC", "%": "percent", "c%": "percent"}

# The roles of a sensor. It gets those in the cabin only where a mission file names it.
GNSS, ATTITUDE = ("height", "position"), ("attitude",)
PRESSURE = ("pressure", "cabin_pressure")
TEMPERATURE, HUMIDITY = ("temperature", "cabin_temperature"), ("humidity", "cabin_humidity")


@dataclass(frozen=True)
class FieldColumn:
    """One column of a channel, and the field of a message that it is read from.

    ``fields`` are the names of the field in all versions, newest first; ``missing`` is the value in
    the log that means unknown, ``floor`` the value below which it means unknown.
    """

    name: str
    fields: tuple[str, ...]
    unit: str = ""
    missing: float | None = None
    floor: float | None = None


def column(
    name: str,
    fields: str,
    unit: str = "",
    *,
    missing: float | None = None,
    floor: float | None = None,
) -> FieldColumn:
    """A column from field names separated by spaces."""
    return FieldColumn(name, tuple(fields.split()), unit, missing, floor)


def columns(
    names: str, fields: str, unit: str = "", missing: float | None = None
) -> tuple[FieldColumn, ...]:
    """Columns of one unit, each from a field of its own: both separated by spaces.

    >>> columns("q_w q_x", "q.0 q.1") == (column("q_w", "q.0"), column("q_x", "q.1"))
    True
    """
    pairs = zip(names.split(), fields.split(), strict=True)
    return tuple(FieldColumn(name, (field,), unit, missing) for name, field in pairs)


def members(path: str, names: str) -> str:
    """The paths of members, or elements, of a field: each has a name of one letter."""
    return " ".join(f"{path}.{name}" for name in names)


INNOVATIONS = "innovation_velocity innovation_position innovation_height innovation_compass"

# A fix in MAVLink's units, also as mavros passes it on. Trimmed zeros of MAVLink 2 and the short
# MAVLink 1 message look like 0: 0 is missing.
MAVLINK_FIX = (
    column("lat_rad", "lat", "degE7"),
    column("lon_rad", "lon lng", "degE7"),
    column("h_msl_m", "alt", "mm"),
    column("h_ellipsoid_m", "alt_ellipsoid", "mm", missing=0.0),
    column("sigma_h_m", "h_acc", "mm plane", missing=0.0),
    column("sigma_v_m", "v_acc", "mm", missing=0.0),
    column("fix", "fix_type"),
    column("satellites", "satellites_visible", missing=255.0),
    column("hdop", "eph", "1/100", missing=65535.0),
    column("speed_m_s", "vel", "cm", missing=65535.0),
    column("course_rad", "cog", "cdeg", missing=65535.0),
)


@dataclass(frozen=True)
class MessageMap:
    """One message and the channel it becomes.

    ``id_field`` names the field that tells instances apart, ``time_field`` the message's own time,
    both where the format itself does not;
    ``spare_rank`` is the rank of all instances but the first, where those are spares. Where it is
    not given all have the same rank: instance numbers do not show which thermometer is outside.
    ``position`` drops rows without a fix, ``attitude`` turns Euler angles into a quaternion.
    ``text_field`` names the text of what the autopilot says: such a channel has no columns.
    """

    columns: tuple[FieldColumn, ...]
    roles: tuple[str, ...] = ()
    rank: int = 50
    id_field: str = ""
    time_field: str = "timestamp"
    position: bool = False
    attitude: bool = False
    text_field: str = ""
    spare_rank: int | None = None

    @property
    def event(self) -> bool:
        return "events" in self.roles


def to_si(raw: NDArray[Any], spec: FieldColumn) -> Array:
    """Values of a log -> SI, NaN where the log says unknown or the value is not finite.

    >>> to_si(np.array([-32768, 2000]), column("temperature_k", "t", "cdegC", missing=-32768))
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
        bits = np.where(unknown, 0.0, value).astype(np.int64)
        flags = bits & 0x3FF
        for logged, meant in FLAGS[spec.unit]:
            flags |= (bits >> logged & 1) << meant
        return np.where(unknown, np.nan, flags.astype(np.float64))
    divisor, factor, offset = UNITS[spec.unit]
    value[unknown] = np.nan  # before the arithmetic, which warns of signalling NaNs
    value /= divisor  # in place: a column of a long log has hundreds of MB
    value *= factor
    value += offset
    return value


def in_stated_unit(channel: Channel, role: str, unit: str) -> Channel:
    """The channel with the column of a role in SI, where its numbers are really in another unit.

    ``role``: a role that the mission file names the channel for. ``unit``: the unit that it states,
    one of `STATED_UNITS`.

    A bare ``value`` becomes the column; numbers that were converted from the unit in which the
    format defines them are converted back first. For example: SCALED_PRESSURE is defined in hPa; a
    sensor whose driver sends kPa has 81.25 for 81,250 Pa, read as 8125 Pa; stated as kPa it is
    81,250 Pa. Raises MissionError (CHANNEL-UNIT).
    """
    column, factor, offset = STATED_UNITS[unit]
    if column not in ROLE_COLUMNS[role]:
        what = f"{unit} is no unit of {role.replace('_', ' ')}"
        remedy = f"its column is {', '.join(ROLE_COLUMNS[role])}"
        raise MissionError("CHANNEL-UNIT", what, where=f"log.channels.{role}", remedy=remedy)
    raw = channel.columns.get("value")
    if raw is None and column in channel.columns:
        logged = channel.logged_units.get(column, "")
        _, logged_factor, logged_offset = STATED_UNITS.get(
            _NUMBERS_OF.get(logged, logged), (column, 1.0, 0.0)
        )
        raw = (channel[column] - logged_offset) / logged_factor
    if raw is None:
        return channel
    return replace(channel, columns=dict(channel.columns) | {column: raw * factor + offset})


def is_number(column: NDArray[Any]) -> bool:
    """Whether a column holds one number a row."""
    return column.ndim == 1 and column.dtype.kind in "biuf"


def extract(
    table: Mapping[str, NDArray[Any]],
    columns: tuple[FieldColumn, ...],
    kept: Callable[[Array], Array] = np.asarray,
    used_up: dict[str, NDArray[Any]] | None = None,
) -> dict[str, Array]:
    """The columns of a field map that a decoded message has, each as it is to be ``kept``.

    A field that is an array or a text where a number is expected is left out. Speed and course
    become velocity, a vibration that of the worst axis, clippings of several sensors their sum.
    Fields that are read are removed from ``used_up``: memory has its peak here.
    """
    result: dict[str, Array] = {}
    last = {field: spec.name for spec in columns for field in spec.fields}
    for spec in columns:
        field = next((n for n in spec.fields if n in table and is_number(table[n])), None)
        if field is not None:
            result[spec.name] = kept(to_si(table[field], spec))
            if used_up is not None and last[field] == spec.name:
                del used_up[field]
    if {"speed_m_s", "course_rad"} <= result.keys():
        speed, course = result.pop("speed_m_s"), result.pop("course_rad")
        result["v_north_m_s"] = kept(speed * np.cos(course))
        result["v_east_m_s"] = kept(speed * np.sin(course))
    has_vertical = result.pop("has_vertical_speed", None)  # the speed is 0 where it has none
    if has_vertical is not None and "v_down_m_s" in result:
        result["v_down_m_s"][has_vertical == 0.0] = np.nan
    for name, joined in (("vibration_m_s2", np.fmax.reduce), ("clipping", np.add.reduce)):
        if parts := [result.pop(part) for part in sorted(result) if part.startswith(f"{name}_")]:
            result[name] = kept(joined(parts))
    return result
