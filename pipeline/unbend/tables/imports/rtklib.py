"""Solutions of RTKLIB and Emlid Studio: ``.pos``, and the ``_events.pos`` of camera time marks.

Format: RTKLIB manual 2.4.2, appendix B.1. Columns are found by the names in the header, so each
order and each separator that RTKLIB can write is read.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from unbend.flight.channels import Channel, TimeArray
from unbend.geodesy import enu_from_ecef, geodetic_of_ecef, offset_geodetic
from unbend.messages import Ledger
from unbend.tables.imports import messages
from unbend.tables.imports.stated import Stated, channel_of_rows, read_text
from unbend.tables.text_columns import numbers, split_lines, utc_of_dates, utc_of_weeks
from unbend.units import Array, Mask

# The error of a single-point fix (Q 5) is at least this, also where its formal sigma is smaller.
SINGLE_SIGMA_H_M = 2.5
SINGLE_SIGMA_V_M = 5.0
_SEPARATOR = r"[\s,;]+"
_TITLE_OF_MINUTES = "latitude(d'\")"
_COLUMNS_OF_MINUTES = ["lat_d", "lat_m", "lat_s", "lon_d", "lon_m", "lon_s"]
_JST_NS = 9 * 3600 * 1_000_000_000
_SINGLE = 5  # quality Q of a single-point fix
_NAMES_OF_QUALITY = {
    1: "fixed",
    2: "float",
    3: "SBAS",
    4: "DGPS",
    5: "single",
    6: "PPP",
}
_SURFACES = {"ellipsoidal": "ellipsoid", "geodetic": "msl"}  # of heights, by RTKLIB's words


def read_pos(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Read a ``.pos`` file as a channel of positions, or of camera events with their positions.

    Positions are geodetic (degrees, or degrees, minutes and seconds), earth-centred, or
    east-north-up baselines; times are dates or week and seconds, in GPST, UTC or JST. The column
    ``solution_quality`` is RTKLIB's Q, ``event_index`` counts the rows of the file from 1.
    """
    lines = read_text(path)
    header = [line for line in lines if line[0] == "%"]
    rows = [line for line in lines if line[0] != "%"]
    clock, names = _titles(path, header)
    if not rows:
        raise messages.pos_without_solutions(where=path)
    table = split_lines(rows, ["day", "time", *names], _SEPARATOR)
    file_columns = {name: numbers(table[name]) for name in names}
    system = stated.system_of(path, ledger, "gpst" if clock == "GPST" else "utc")
    has_dates = "/" in rows[0].split()[0]
    time_ns, is_time = _times(table, system, has_dates=has_dates)
    if clock == "JST" and system == "utc":  # JST was read as UTC
        time_ns = time_ns - _JST_NS
    columns = _positions(path, header, file_columns, stated, ledger)
    columns["solution_quality"] = file_columns["Q"]
    columns["event_index"] = np.arange(1.0, len(rows) + 1.0)
    columns |= _velocities(file_columns)
    is_single = file_columns["Q"] == _SINGLE
    columns["sigma_h_m"] = _at_least(columns["sigma_h_m"], SINGLE_SIGMA_H_M, is_single)
    columns["sigma_v_m"] = _at_least(columns["sigma_v_m"], SINGLE_SIGMA_V_M, is_single)
    has_position = (file_columns["Q"] > 0) & np.isfinite(columns["lat_rad"])
    channel = channel_of_rows(
        path,
        "RTKLIB",
        time_ns,
        columns,
        ledger,
        readable=is_time & has_position,
    )
    _report_qualities(path, channel, ledger)
    return channel


def _times(
    table: pd.DataFrame,
    system: str,
    *,
    has_dates: bool,
) -> tuple[TimeArray, Mask]:
    """UTC (n,) of the rows, and which rows have a readable time.

    The columns ``day`` and ``time`` are a date and a time of day (``has_dates``), or the GPS week
    and its seconds.
    """
    if has_dates:
        return utc_of_dates(table["day"] + "T" + table["time"], system)
    week = numbers(table["day"])
    seconds = numbers(table["time"])
    return utc_of_weeks(week, seconds, system), np.isfinite(week + seconds)


def _titles(path: Path, header: Sequence[str]) -> tuple[str, list[str]]:
    """The clock of a solution, GPST, UTC or JST, and the names of the columns after its time.

    Refuses (InputError) a header without a line of titles.
    """
    titles = [line for line in header if re.search(r"[\s,;]Q[\s,;]", line)]
    if not titles:
        raise messages.pos_without_titles(where=path)
    clock, *names = re.split(_SEPARATOR, titles[-1].strip("% \t"))
    if clock not in ("GPST", "UTC", "JST"):
        raise messages.pos_without_titles(where=path)
    if _TITLE_OF_MINUTES in names:
        names = [*_COLUMNS_OF_MINUTES, *names[2:]]  # two titles for six columns
    return clock, names


def _velocities(file_columns: Mapping[str, Array]) -> dict[str, Array]:
    """The velocities north, east and down [m/s] that the file has; none if earth-centred."""
    velocities: dict[str, Array] = {}
    if "x-ecef(m)" in file_columns:
        return velocities
    if "vn(m/s)" in file_columns:
        velocities["v_north_m_s"] = file_columns["vn(m/s)"]
    if "ve(m/s)" in file_columns:
        velocities["v_east_m_s"] = file_columns["ve(m/s)"]
    if "vu(m/s)" in file_columns:
        velocities["v_down_m_s"] = -file_columns["vu(m/s)"]
    return velocities


def _at_least(sigma: Array, least: float, is_single: Mask) -> Array:
    """Sigmas (n,) [m]; in the rows ``is_single`` at least ``least``, which replaces NaN too."""
    return np.where(is_single, np.fmax(sigma, least), sigma)


def _report_qualities(path: Path, channel: Channel, ledger: Ledger) -> None:
    """Report the shares of the qualities of the solutions, and how many are single-point fixes."""
    qualities = channel["solution_quality"].astype(int)
    numbers_of_quality, counts = np.unique(qualities, return_counts=True)
    shares = []
    for number, count in zip(numbers_of_quality.tolist(), counts, strict=True):
        percent = 100.0 * count / len(channel)
        shares.append(f"{percent:.1f} % {_NAMES_OF_QUALITY.get(number, f'Q {number}')}")
    note = messages.solution_qualities(
        where=path.name,
        count=len(channel),
        shares=", ".join(shares),
    )
    ledger.add(note)
    single = int(np.sum(qualities == _SINGLE))
    if single:
        warning = messages.single_point_solutions(
            where=path.name,
            count=single,
            total=len(channel),
            sigma_h_m=SINGLE_SIGMA_H_M,
            sigma_v_m=SINGLE_SIGMA_V_M,
        )
        ledger.add(warning)


def _positions(
    path: Path,
    header: list[str],
    file_columns: Mapping[str, Array],
    stated: Stated,
    ledger: Ledger,
) -> dict[str, Array]:
    """The channel's columns of position, height and their sigmas per axis [rad, m].

    ``file_columns`` are the numbers of the file by title, with the coordinates that it has.
    """
    surface: str | None = "ellipsoid"  # that the heights count from; None where not stated
    horizontal, vertical = _variances(file_columns)
    if "x-ecef(m)" in file_columns:
        lat, lon, height = geodetic_of_ecef(
            file_columns["x-ecef(m)"],
            file_columns["y-ecef(m)"],
            file_columns["z-ecef(m)"],
        )
        horizontal, vertical = _variances_of_ecef(file_columns, lat, lon)
    elif "e-baseline(m)" in file_columns:
        lat, lon, height = _ends_of_baselines(path, header, file_columns)
    else:
        lat, lon = _latitudes_longitudes(file_columns)
        height = file_columns["height(m)"]
        statement = re.search(r"height=[^/]+/(ellipsoidal|geodetic)", "\n".join(header))
        surface = _SURFACES[statement[1]] if statement else None
    return {
        "lat_rad": lat,
        "lon_rad": lon,
        stated.height_column(path, ledger, surface): height,
        "sigma_h_m": np.sqrt(np.maximum(horizontal, 0.0)),
        "sigma_v_m": np.sqrt(np.maximum(vertical, 0.0)),
    }


def _variances(file_columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """(n,) horizontal variance per axis and vertical variance [m2]; NaN in a file without them."""
    unknown = np.full(file_columns["Q"].shape, np.nan)
    north = file_columns.get("sdn(m)", unknown)
    east = file_columns.get("sde(m)", unknown)
    up = file_columns.get("sdu(m)", unknown)
    return (north**2 + east**2) / 2.0, up**2


def _variances_of_ecef(
    file_columns: Mapping[str, Array],
    lat: Array,
    lon: Array,
) -> tuple[Array, Array]:
    """As `_variances`, from the covariance of earth-centred coordinates; ``lat``, ``lon`` in rad.

    RTKLIB writes each covariance as the square root of its size, with its sign.
    """
    unknown = np.full(file_columns["Q"].shape, np.nan)

    def root(name: str) -> Array:
        return file_columns.get(f"sd{name}(m)", unknown)

    roots = np.array(
        [
            [root("x"), root("xy"), root("zx")],
            [root("xy"), root("y"), root("yz")],
            [root("zx"), root("yz"), root("z")],
        ]
    )
    covariance = np.sign(roots) * roots**2
    axes = enu_from_ecef(np.nan_to_num(lat), np.nan_to_num(lon))
    # The diagonal of A C A^T of each row n.
    variance_enu = np.einsum("nij,jkn,nik->ni", axes, covariance, axes)
    horizontal = (variance_enu[:, 0] + variance_enu[:, 1]) / 2.0
    return horizontal, variance_enu[:, 2]


def _ends_of_baselines(
    path: Path,
    header: Sequence[str],
    file_columns: Mapping[str, Array],
) -> tuple[Array, Array, Array]:
    """(n,) latitudes, longitudes [rad] and heights [m] of the rover, from base and baselines.

    Refuses (InputError) a header without the place of the base.
    """
    base = _base_of_header(header)
    if base is None:
        raise messages.pos_without_base(where=path)
    latitude_deg, longitude_deg, height_m = base
    enu = np.stack([file_columns[f"{axis}-baseline(m)"] for axis in "enu"], axis=1)
    return offset_geodetic(
        np.full(len(enu), np.radians(latitude_deg)),
        np.full(len(enu), np.radians(longitude_deg)),
        np.full(len(enu), height_m),
        enu,
    )


def _latitudes_longitudes(file_columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """(n,) latitudes and longitudes [rad] of a file in degrees, or in minutes and seconds."""
    if "lat_d" not in file_columns:
        return np.radians(file_columns["latitude(deg)"]), np.radians(file_columns["longitude(deg)"])
    lat_deg = _decimal_degrees(file_columns["lat_d"], file_columns["lat_m"], file_columns["lat_s"])
    lon_deg = _decimal_degrees(file_columns["lon_d"], file_columns["lon_m"], file_columns["lon_s"])
    return np.radians(lat_deg), np.radians(lon_deg)


def _decimal_degrees(degrees: Array, minutes: Array, seconds: Array) -> Array:
    """(n,) decimal degrees of degrees, minutes and seconds; the degrees have the sign, also -0."""
    size = abs(degrees) + minutes / 60.0 + seconds / 3600.0
    return np.copysign(size, degrees)


_FULL_MINUTE = 60.0  # minutes and seconds of an angle are less


def _base_of_header(header: Sequence[str]) -> tuple[float, float, float] | None:
    """Latitude, longitude [deg] and height [m] of the base of a solution, by its header.

    RTKLIB writes both angles in degrees (3 numbers), or in degrees, minutes and seconds (7 numbers;
    the degrees have the sign, also -0). None where the header has no base, or an impossible place.

    >>> _base_of_header(["% ref pos   :  47 30 00.0000   -0 30 00.0000   450.0000"])
    (47.5, -0.5, 450.0)
    """
    fields: list[str] = []
    for line in header:
        if re.match(r"%\s*ref pos\s*:", line):
            _, _, place = line.partition(":")
            fields = re.split(_SEPARATOR, place.strip())
            break
    try:
        numbers_of_base = [float(field) for field in fields]
    except ValueError:
        return None
    if len(numbers_of_base) == 3:
        latitude, longitude, height = numbers_of_base
    elif len(numbers_of_base) == 7:
        *angles, height = numbers_of_base
        minutes_and_seconds = [*angles[1:3], *angles[4:6]]
        if any(not 0.0 <= part < _FULL_MINUTE for part in minutes_and_seconds):
            return None
        degrees, minutes, seconds = np.array(angles).reshape(2, 3).T
        latitude, longitude = _decimal_degrees(degrees, minutes, seconds).tolist()
    else:
        return None
    if abs(latitude) > 90.0 or abs(longitude) > 360.0:
        return None
    return latitude, longitude, height
