"""Solutions of RTKLIB and Emlid Studio: ``.pos``, and the ``_events.pos`` of camera time marks.

Format: RTKLIB manual 2.4.2, appendix B.1. Columns are found by the names in the header, so each
order and each separator that RTKLIB can write is read.
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from unbend.flight.channels import Channel
from unbend.geodesy import enu_from_ecef, geodetic_of_ecef, offset_geodetic
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated, channel_of_rows, read_text
from unbend.tables.text_columns import numbers, split_lines, utc_of_dates, utc_of_weeks
from unbend.units import Array

# A single-point fix (Q 5) is not better than this, whatever its formal sigma says.
SINGLE_SIGMA_H_M, SINGLE_SIGMA_V_M = 2.5, 5.0
_SEPARATOR = r"[\s,;]+"
_MINUTES = "latitude(d'\")"
_JST_NS = 9 * 3600 * 1_000_000_000
_SINGLE = 5  # its number among the qualities
_QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "DGPS", 5: "single", 6: "PPP"}


def read_pos(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """The solutions of a ``.pos`` file as a channel of positions, or of events with positions.

    Geodetic (degrees, or degrees, minutes and seconds), earth-centred and east-north-up baselines,
    times as dates or as week and seconds, in GPST, UTC or JST. ``solution_quality`` is RTKLIB's Q,
    ``event_index`` counts the rows from 1.
    """
    lines = read_text(path)
    header = [line for line in lines if line[0] == "%"]
    rows = [line for line in lines if line[0] != "%"]
    titles = [line for line in header if re.search(r"[\s,;]Q[\s,;]", line)]
    clock, *names = re.split(_SEPARATOR, titles[-1].strip("% \t")) if titles else [""]
    if clock not in ("GPST", "UTC", "JST"):
        raise messages.pos_without_titles(where=path)
    if not rows:
        raise messages.pos_without_solutions(where=path)
    if _MINUTES in names:
        names = [f"{axis}_{part}" for axis in ("lat", "lon") for part in "dms"] + names[2:]
    table = split_lines(rows, ["day", "time", *names], _SEPARATOR)
    value = {name: numbers(table[name]) for name in names}
    system = stated.system_of(path, ledger, "gpst" if clock == "GPST" else "utc")
    if "/" in rows[0].split()[0]:
        time_ns, readable = utc_of_dates(table["day"] + "T" + table["time"], system)
    else:
        week, seconds = numbers(table["day"]), numbers(table["time"])
        time_ns, readable = utc_of_weeks(week, seconds, system), np.isfinite(week + seconds)
    columns = _positions(path, header, value, stated, ledger)
    quality = value["Q"]
    readable = readable & (quality > 0) & np.isfinite(columns["lat_rad"])
    columns |= {"solution_quality": quality, "event_index": np.arange(1.0, len(rows) + 1.0)}
    for name, sign, written in (("north", 1, "vn"), ("east", 1, "ve"), ("down", -1, "vu")):
        if f"{written}(m/s)" in value and "x-ecef(m)" not in value:
            columns[f"v_{name}_m_s"] = sign * value[f"{written}(m/s)"]
    for name, least in (("sigma_h_m", SINGLE_SIGMA_H_M), ("sigma_v_m", SINGLE_SIGMA_V_M)):
        columns[name] = np.where(quality == _SINGLE, np.fmax(columns[name], least), columns[name])
    time_ns = time_ns - (_JST_NS if clock == "JST" and system == "utc" else 0)
    channel = channel_of_rows(path, "RTKLIB", time_ns, columns, ledger, readable=readable)
    found, counts = np.unique(channel["solution_quality"].astype(int), return_counts=True)
    shares = ", ".join(
        f"{100.0 * count / len(channel):.1f} % {_QUALITY.get(int(q), f'Q {q}')}"
        for q, count in zip(found, counts, strict=True)
    )
    qualities = messages.solution_qualities(where=path.name, count=len(channel), shares=shares)
    ledger.add(qualities)
    if single := int(counts[found == _SINGLE].sum()):
        ledger.add(
            messages.single_point_solutions(
                where=path.name,
                count=single,
                total=len(channel),
                sigma_h_m=SINGLE_SIGMA_H_M,
                sigma_v_m=SINGLE_SIGMA_V_M,
            )
        )
    return channel


def _positions(
    path: Path, header: list[str], value: Mapping[str, Array], stated: Stated, ledger: Ledger
) -> dict[str, Array]:
    """Positions and their sigmas per axis, whichever coordinates the file has."""
    nowhere = np.full(value["Q"].shape, np.nan)
    north, east, up = (value.get(f"sd{axis}(m)", nowhere) for axis in "neu")
    variance = (north**2 + east**2) / 2.0, up**2
    above: str | None = "ellipsoid"
    if "x-ecef(m)" in value:
        lat, lon, height = geodetic_of_ecef(*(value[f"{axis}-ecef(m)"] for axis in "xyz"))
        # Covariances are written as square roots with the sign of the covariance.
        pairs = ("x", "xy", "zx"), ("xy", "y", "yz"), ("zx", "yz", "z")
        root = np.array([[value.get(f"sd{p}(m)", nowhere) for p in row] for row in pairs])
        axes = enu_from_ecef(np.nan_to_num(lat), np.nan_to_num(lon))
        local = np.einsum("nij,jkn,nik->ni", axes, np.sign(root) * root**2, axes)
        variance = (local[:, 0] + local[:, 1]) / 2.0, local[:, 2]
    elif "e-baseline(m)" in value:
        origin = _base(header)
        if origin is None:
            raise messages.pos_without_base(where=path)
        enu = np.stack([value[f"{axis}-baseline(m)"] for axis in "enu"], axis=1)
        start = np.tile([*np.radians(origin[:2]), origin[2]], (len(enu), 1)).T
        lat, lon, height = offset_geodetic(start[0], start[1], start[2], enu)
    else:
        if "lat_d" in value:  # the degrees carry the sign, -0 as well
            degrees = [
                np.copysign(abs(value[f"{axis}_d"]) + value[f"{axis}_m"] / 60.0
                            + value[f"{axis}_s"] / 3600.0, value[f"{axis}_d"])
                for axis in ("lat", "lon")
            ]  # fmt: skip
        else:
            degrees = [value["latitude(deg)"], value["longitude(deg)"]]
        lat, lon = np.radians(degrees)
        height = value["height(m)"]
        said = re.search(r"height=[^/]+/(ellipsoidal|geodetic)", "\n".join(header))
        above = {"ellipsoidal": "ellipsoid", "geodetic": "msl"}[said[1]] if said else None
    sigma_h, sigma_v = np.sqrt(np.maximum(variance, 0.0))
    places = {"lat_rad": lat, "lon_rad": lon, stated.height_column(path, ledger, above): height}
    return places | {"sigma_h_m": sigma_h, "sigma_v_m": sigma_v}


_MINUTES_AND_SECONDS = 60.0  # below it each, of an angle in degrees, minutes and seconds


def _base(header: Sequence[str]) -> tuple[float, float, float] | None:
    """Latitude, longitude [deg] and height [m] of the base of a solution, by its header.

    RTKLIB writes both angles in degrees, or in degrees, minutes and seconds; the degrees carry the
    sign, -0 as well. None where the header has no base, or one that is no place.

    >>> _base(["% ref pos   :  47 30 00.0000   -0 30 00.0000   450.0000"])
    (47.5, -0.5, 450.0)
    """
    line = next((line for line in header if re.match(r"%\s*ref pos\s*:", line)), "")
    fields = re.split(_SEPARATOR, line.partition(":")[2].strip())
    try:
        numbers_of_base = [float(field) for field in fields]
    except ValueError:
        return None
    if len(numbers_of_base) == 3:
        latitude, longitude, height = numbers_of_base
    elif len(numbers_of_base) == 7:
        *angles, height = numbers_of_base
        if any(not 0.0 <= part < _MINUTES_AND_SECONDS for part in (*angles[1:3], *angles[4:6])):
            return None
        latitude = _degrees_of(angles[:3])
        longitude = _degrees_of(angles[3:])
    else:
        return None
    if abs(latitude) > 90.0 or abs(longitude) > 360.0:
        return None
    return latitude, longitude, height


def _degrees_of(parts: Sequence[float]) -> float:
    """Degrees, minutes and seconds as degrees; the degrees carry the sign."""
    degrees, minutes, seconds = parts
    return math.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees)
