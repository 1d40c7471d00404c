"""Units that cannot be what the file says: refused, because a silent repair may be wrong."""

from __future__ import annotations

import numpy as np

from pipeline.atmosphere.soundings.raw import Array, RawLevels
from pipeline.errors import InputError
from pipeline.units import HECTOPASCAL, ZERO_CELSIUS_K

# No sounding begins above 25 km, nor below the Dead Sea.
_GROUND_PA = (2_500.0, 110_000.0)
# The warmest level of a sounding: air below -75 C or above 60 C is nowhere near the ground.
_WARMEST_LEVEL_K = (198.0, 333.0)
_THICKNESS_RATIO = 0.03

WILD = 0.05
"""Share of a column that may be rubbish without the rest being refused."""


def refuse_wrong_units(raw: RawLevels) -> None:
    """Refuse pressures, temperatures or humidities whose largest values no ground has."""
    p, t = _largest(raw.pressure_pa), _largest(raw.temperature_k)
    if p is not None and not _GROUND_PA[0] <= p <= _GROUND_PA[1]:
        as_pa, as_hpa = p * HECTOPASCAL, p / HECTOPASCAL
        guess = (
            "they look like hPa where Pa is said" if _GROUND_PA[0] <= as_pa <= _GROUND_PA[1]
            else "they look like Pa where hPa is said" if _GROUND_PA[0] <= as_hpa <= _GROUND_PA[1]
            else "that is no air near the ground"
        )  # fmt: skip
        raise _refusal(raw, "pressure", f"the highest pressure is {p:.6g} Pa: {guess}",
                       "pressure_pa or pressure_hpa")  # fmt: skip
    if t is not None and not _WARMEST_LEVEL_K[0] <= t <= _WARMEST_LEVEL_K[1]:
        guess = (
            "they look like Celsius where Kelvin is said" if t < 80.0
            else "they look like Kelvin where Celsius is said" if t > 198.0 + ZERO_CELSIUS_K
            else "they look like Fahrenheit" if t > _WARMEST_LEVEL_K[1]
            else "that is too cold for the warmest level of a sounding"
        )  # fmt: skip
        raise _refusal(raw, "temperature", f"the warmest level has {t:.6g} K: {guess}",
                       "temperature_k or temperature_c, and convert Fahrenheit")  # fmt: skip
    _refuse_humidity(raw)


def _refuse_humidity(raw: RawLevels) -> None:
    dew = None if raw.dew_point_k is None else _largest(raw.dew_point_k)
    if dew is not None and not 150.0 <= dew <= 333.0:
        raise _refusal(raw, "dew point", f"the highest dew point is {dew:.6g} K",
                       "dew_point_c or dew_point_k")  # fmt: skip
    wet = None if raw.relative_humidity is None else _largest(raw.relative_humidity)
    # Sensors read up to 1.1 in cloud. All of a sounding below 1 % does not happen: the lowest
    # kilometre holds more, even over deserts.
    if wet is not None and (wet > 1.5 or wet <= 0.011):
        raise _refusal(raw, "relative humidity", f"the highest is {wet:.4g} as a fraction of one",
                       "relative_humidity (0 to 1) or relative_humidity_percent")  # fmt: skip
    e = None if raw.vapour_pressure_pa is None else _largest(raw.vapour_pressure_pa)
    if e is not None and e > 10_000.0:  # 46 C of dew point
        raise _refusal(raw, "vapour pressure", f"the highest is {e:.6g} Pa",
                       "vapour_pressure_pa or vapour_pressure_hpa")  # fmt: skip


def refuse_wrong_heights(raw: RawLevels, h: Array, rise: Array) -> None:
    """Refuse heights that are not those of pressures and temperatures.

    ``h`` and ``rise`` (n,) [m']: heights of the file and by the hypsometric equation. A balloon's
    heights are computed from its pressures and temperatures and agree to 0.05 %; feet, Fahrenheit
    or another balloon's heights do not. A single wrong level does not move the median.
    """
    apart = max(1, h.size // 4)
    far = rise[apart:] - rise[:-apart]
    thick = far > 10.0
    if not bool(thick.any()):
        return
    ratio = float(np.median((h[apart:] - h[:-apart])[thick] / far[thick]))
    if abs(ratio - 1.0) > _THICKNESS_RATIO:
        raise InputError(
            "SOUNDING-INCONSISTENT",
            f"the layers are {ratio:.3f} times as thick as their pressures and temperatures say",
            where=raw.where,
            remedy="look for heights in feet (3.28 times), temperatures in Fahrenheit, or columns "
            "mixed up",
        )


def _largest(column: Array) -> float | None:
    """The largest value but for one in twenty: a wild one is no matter of units."""
    known = column[np.isfinite(column)]
    return float(np.quantile(known, 1.0 - WILD, method="lower")) if known.size else None


def _refusal(raw: RawLevels, quantity: str, what: str, remedy: str) -> InputError:
    column = raw.said.get(quantity, "")
    return InputError(
        "SOUNDING-UNITS",
        f"{quantity}: {what}" + (f" (column {column})" if column else ""),
        where=raw.where,
        remedy=f"say the unit in the column's name: {remedy}",
    )
