"""The language of the field maps: which field of a message is which column, in which unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.channels import Array
from pipeline.units import DEGREE, HECTOPASCAL, ZERO_CELSIUS_K

# unit in the log -> (divisor, factor, offset): SI = value / divisor * factor + offset. Division
# where the log holds scaled integers: x / 1e7 is the nearest double, x * 1e-7 is not.
UNITS: Mapping[str, tuple[float, float, float]] = {
    "": (1.0, 1.0, 0.0),
    "deg": (1.0, DEGREE, 0.0),
    "degE7": (1e7, DEGREE, 0.0),
    "cdeg": (100.0, DEGREE, 0.0),
    "mm": (1e3, 1.0, 0.0),
    "-m": (1.0, -1.0, 0.0),
    "hPa": (1.0, HECTOPASCAL, 0.0),
    "degC": (1.0, 1.0, ZERO_CELSIUS_K),
    "cdegC": (100.0, 1.0, ZERO_CELSIUS_K),
    "%": (100.0, 1.0, 0.0),
    "c%": (1e4, 1.0, 0.0),
}

# The roles of a sensor, which plays those inside the cabin only where a mission file names it.
GNSS, ATTITUDE = ("height", "position"), ("attitude",)
PRESSURE = ("pressure", "cabin_pressure")
TEMPERATURE, HUMIDITY = ("temperature", "cabin_temperature"), ("humidity", "cabin_humidity")


@dataclass(frozen=True)
class Column:
    """One column of a channel.

    ``fields`` are the names it has had, newest first; ``missing`` is the value in the log that
    means unknown, ``floor`` the value below which it means unknown.
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
) -> Column:
    """A column from field names separated by spaces."""
    return Column(name, tuple(fields.split()), unit, missing, floor)


@dataclass(frozen=True)
class MessageMap:
    """One message and the channel it becomes.

    ``id_field`` names the field that tells instances apart, ``time_field`` the message's own time;
    ``spare_rank`` is the rank of all instances but the first, where those are spares. Where it is
    not given they all rank alike: which thermometer is outside is nothing their numbers tell.
    ``position`` drops rows without a fix, ``attitude`` turns Euler angles into a quaternion.
    """

    columns: tuple[Column, ...]
    roles: tuple[str, ...] = ()
    rank: int = 50
    id_field: str = ""
    time_field: str = ""
    position: bool = False
    attitude: bool = False
    spare_rank: int | None = None

    def rank_of(self, instance: str | None) -> int:
        """The rank of an instance; None where the message has no instances."""
        if self.spare_rank is None or instance in (None, "0"):
            return self.rank
        return self.spare_rank

    @property
    def event(self) -> bool:
        return "events" in self.roles


def to_si(raw: NDArray[Any], spec: Column) -> Array:
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
    divisor, factor, offset = UNITS[spec.unit]
    value[unknown] = np.nan  # before the arithmetic, which warns of signalling NaNs
    value /= divisor  # in place: a column of a long log has hundreds of MB
    value *= factor
    value += offset
    return value


def is_number(column: NDArray[Any]) -> bool:
    """Whether a column holds one number a row."""
    return column.ndim == 1 and column.dtype.kind in "biuf"


def extract(
    table: Mapping[str, NDArray[Any]],
    columns: tuple[Column, ...],
    kept: Callable[[Array], Array] = np.asarray,
) -> dict[str, Array]:
    """The columns of a field map that a decoded message has, each as it is to be ``kept``.

    A field that is an array or a text where a number is wanted is none of them.
    """
    result: dict[str, Array] = {}
    for spec in columns:
        field = next((n for n in spec.fields if n in table and is_number(table[n])), None)
        if field is not None:
            result[spec.name] = kept(to_si(table[field], spec))
    return result
