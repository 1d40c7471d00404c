"""Solutions of RTKLIB and Emlid Studio: ``.pos``, and the ``_events.pos`` of camera time marks.

Format: RTKLIB manual 2.4.2, appendix B.1. Columns are found by the names in the header, so each
order and each separator that RTKLIB can write is read.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.flight.channels import Array, Channel
from pipeline.geodesy import geodetic_of_ecef, offset_geodetic
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import (
    Stated,
    channel_of_rows,
    height_column,
    not_of_format,
    number,
    read_text,
    time_system,
    utc_of_calendar,
    utc_of_week_seconds,
)

SINGLE_SIGMA_H_M, SINGLE_SIGMA_V_M = 2.5, 5.0
"""A single-point fix (Q 5) is not better than this, whatever its formal sigma says [m]."""

_SEPARATOR = re.compile(r"[\s,;]+")
_DEGREES, _MINUTES = "latitude(deg)", "latitude(d'\")"
_JST_NS = 9 * 3600 * 1_000_000_000
_QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "DGPS", 5: "single", 6: "PPP"}


def read_pos(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """The solutions of a ``.pos`` file as a channel of positions, or of events with positions.

    Geodetic (degrees, or degrees, minutes and seconds), earth-centred and east-north-up baselines,
    times as dates or as week and seconds, in GPST, UTC or JST. ``solution_quality`` is RTKLIB's Q,
    ``event_index`` counts the rows from 1.
    """
    lines = read_text(path)
    header = [line for line in lines if line.startswith("%")]
    titles = [line for line in header if re.search(r"\sQ\s|[,;]\s*Q\s*[,;]", line)]
    names = _SEPARATOR.split(titles[-1].lstrip("% ").strip()) if titles else []
    if not titles or names[0] not in ("GPST", "UTC", "JST"):
        raise not_of_format(
            path,
            "it has no line like '%  GPST  latitude(deg) longitude(deg) height(m) Q ns ...', which "
            "says what its columns and its time system are",
            "keep the header when exporting, or read it as csv",
        )
    found = {"GPST": "gpst", "UTC": "utc", "JST": "utc"}[names[0]]
    system = time_system(path, stated, found)
    columns = names[1:]
    if _MINUTES in columns:
        columns = [f"{axis}_{part}" for axis in ("lat", "lon") for part in "dms"] + columns[2:]
    needed = columns.index("Q") + 3
    rows = [_SEPARATOR.split(line.strip()) for line in lines if line.strip() and line[0] != "%"]
    readable = np.array([len(row) >= needed for row in rows], np.bool_)
    if not rows:
        raise not_of_format(path, "it has a header and no solutions", "process the flight again")
    width = len(columns) + 2
    rows = [(row + [""] * width)[:width] for row in rows]
    fields = np.array([[number(field) for field in row[2:]] for row in rows])
    value = {name: fields[:, k] for k, name in enumerate(columns)}
    if "/" in rows[0][0]:
        text = [f"{row[0].replace('/', '-')}T{row[1]}" for row in rows]
        stamps = pd.Series(pd.to_datetime(text, format="ISO8601", errors="coerce"))
        readable &= stamps.notna().to_numpy()
        time_ns = utc_of_calendar(stamps.to_numpy("datetime64[ns]").astype(np.int64), system)
    else:
        week, seconds = np.array([[number(field) for field in row[:2]] for row in rows]).T
        readable &= np.isfinite(week) & np.isfinite(seconds)
        time_ns = utc_of_week_seconds(path, seconds, stated, system, week)
    if names[0] == "JST":
        time_ns = time_ns - _JST_NS
    place = positions_of(path, header, value, stated)
    quality = value["Q"]
    readable &= np.isfinite(quality) & (quality > 0) & np.isfinite(place["lat_rad"])
    place |= {"solution_quality": quality, "event_index": np.arange(1.0, len(rows) + 1.0)}
    for column, name, sign in (("v_north_m_s", "vn(m/s)", 1.0), ("v_east_m_s", "ve(m/s)", 1.0),
                               ("v_down_m_s", "vu(m/s)", -1.0)):  # fmt: skip
        if name in value and "x-ecef(m)" not in value:
            place[column] = sign * value[name]
    single = quality == 5
    for name, least in (("sigma_h_m", SINGLE_SIGMA_H_M), ("sigma_v_m", SINGLE_SIGMA_V_M)):
        place[name] = np.where(single, np.fmax(place[name], least), place[name])
    channel = channel_of_rows(path, "RTKLIB", time_ns, place, ledger, readable=readable)
    numbers, counts = np.unique(channel["solution_quality"].astype(int), return_counts=True)
    counted = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    shares = ", ".join(
        f"{100.0 * count / len(channel):.1f} % {_QUALITY.get(q, f'Q {q}')}"
        for q, count in counted.items()
    )
    ledger.note("TRAJECTORY-QUALITY", f"solutions: {shares}", where=path.name, count=len(channel))
    if counted.get(5):
        ledger.warning(
            "TRAJECTORY-SINGLE",
            f"{counted[5]} of {len(channel)} solutions are single-point fixes (Q 5): metres, not "
            f"centimetres; their sigma is at least {SINGLE_SIGMA_H_M} m, {SINGLE_SIGMA_V_M} m in "
            "height",
            where=path.name,
            count=counted[5],
        )
    return channel


def positions_of(
    path: Path, header: list[str], value: dict[str, Array], stated: Stated
) -> dict[str, Array]:
    """Positions and their sigmas per axis, whichever coordinates the file has."""
    nowhere = np.full(next(iter(value.values())).shape, np.nan)

    def sigma(axes: str) -> Array:
        parts = [value.get(f"sd{axis}(m)", nowhere) for axis in axes]
        return np.asarray(np.sqrt(np.mean(np.square(parts), axis=0)))

    if "x-ecef(m)" in value:
        x, y, z = (value[f"{axis}-ecef(m)"] for axis in "xyz")
        lat, lon, height = geodetic_of_ecef(x, y, z)
        sigma_h, sigma_v = sigmas_of_ecef(value, lat, lon)
        surface = height_column(path, stated, "ellipsoid")
    elif "e-baseline(m)" in value:
        base = next((line for line in header if re.match(r"%\s*ref pos\s*:", line)), "")
        origin = [float(number) for number in re.findall(r"-?\d+\.\d+", base)]
        if len(origin) != 3 or abs(origin[0]) > 90.0:
            raise not_of_format(
                path,
                "its baselines start at a base whose latitude, longitude and height the header "
                "does not give ('% ref pos   :')",
                "export latitude, longitude and height",
            )
        enu = np.stack([value[f"{axis}-baseline(m)"] for axis in "enu"], axis=1)
        start = [np.full(enu.shape[0], v) for v in (*np.radians(origin[:2]), origin[2])]
        lat, lon, height = offset_geodetic(start[0], start[1], start[2], enu)
        sigma_h, sigma_v = sigma("ne"), sigma("u")
        surface = height_column(path, stated, "ellipsoid")
    else:
        if _DEGREES in value:
            lat, lon = np.radians(value[_DEGREES]), np.radians(value["longitude(deg)"])
        else:
            parts = {axis: [value[f"{axis}_{part}"] for part in "dms"] for axis in ("lat", "lon")}
            lat, lon = (  # the degrees carry the sign, -0 as well
                np.radians(np.copysign(np.abs(d) + m / 60.0 + sec / 3600.0, d))
                for d, m, sec in parts.values()
            )
        height = value["height(m)"]
        sigma_h, sigma_v = sigma("ne"), sigma("u")
        said = re.search(r"height=[^/]+/(ellipsoidal|geodetic)", "\n".join(header))
        above = {"ellipsoidal": "ellipsoid", "geodetic": "msl"}
        surface = height_column(path, stated, above[said[1]] if said else None)
    return {
        "lat_rad": lat,
        "lon_rad": lon,
        surface: height,
        "sigma_h_m": sigma_h,
        "sigma_v_m": sigma_v,
    }


def sigmas_of_ecef(value: dict[str, Array], lat: Array, lon: Array) -> tuple[Array, Array]:
    """Sigmas per horizontal axis and in height from a covariance in earth-centred axes.

    RTKLIB writes covariances as square roots with the sign of the covariance.
    """
    if "sdx(m)" not in value:
        return np.full(lat.shape, np.nan), np.full(lat.shape, np.nan)
    xx, yy, zz, xy, yz, zx = (
        np.sign(value[f"sd{pair}(m)"]) * value[f"sd{pair}(m)"] ** 2
        for pair in ("x", "y", "z", "xy", "yz", "zx")
    )
    up = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    vertical = up[0] ** 2 * xx + up[1] ** 2 * yy + up[2] ** 2 * zz
    vertical += 2.0 * (up[0] * up[1] * xy + up[1] * up[2] * yz + up[2] * up[0] * zx)
    vertical = np.maximum(vertical, 0.0)
    horizontal = np.maximum((xx + yy + zz - vertical) / 2.0, 0.0)
    return np.sqrt(horizontal), np.sqrt(vertical)
