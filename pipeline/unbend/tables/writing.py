"""Converts results to Arrow tables and writes Parquet files; stations are GeoParquet.

Source: OGC GeoParquet 1.1.0; OGC 06-103r4 (well-known binary). In a geometry the longitude comes
first, whatever the order of the axes in the coordinate reference system.
"""

import json
import math
import struct
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from unbend.atmosphere.profile import profile_table
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.errors import storage_errors
from unbend.flight.stations import Stations, station_columns
from unbend.refraction.image import Corrections
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.refraction.uncertainty.sigmas import Sigmas
from unbend.tables.observations import Batch
from unbend.tables.pixels import PixelSystem
from unbend.tables.written_columns import PROFILE_COLUMNS, STATION_COLUMNS, schema_of
from unbend.units import Array

if TYPE_CHECKING:
    from unbend.atmosphere.estimate.adjusted_profile import Adjustment


def points_wkb(lon_deg: Array, lat_deg: Array, h_ellipsoid_m: Array) -> list[bytes | None]:
    """Well-known binary of each point; without the height if it is NaN, None without a position.

    >>> import numpy as np
    >>> points_wkb(np.array([8.0]), np.array([47.0]), np.array([500.0]))[0].hex()[:10]
    '01e9030000'
    """
    points: list[bytes | None] = []
    for lon, lat, h in zip(lon_deg.tolist(), lat_deg.tolist(), h_ellipsoid_m.tolist(), strict=True):
        # Byte order 1 is little-endian; type 1 is Point and 1001 PointZ. NaN differs from itself.
        if lon != lon or lat != lat:
            points.append(None)
        elif h != h:
            points.append(struct.pack("<BI2d", 1, 1, lon, lat))
        else:
            points.append(struct.pack("<BI3d", 1, 1001, lon, lat, h))
    return points


def table_of(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """An Arrow table with the columns of the schema; NaN and NaT become null.

    ``columns`` : name -> values (n,), or None for a column of nulls, which cannot be the first.
    Other columns than those of the schema are left out; a missing one is a KeyError.
    """
    rows = len(next(iter(columns.values())))
    arrays = []
    for item in schema:
        values = columns[item.name]
        has_nan = True
        if isinstance(values, np.ndarray) and values.dtype.kind == "f":
            # Most columns have no NaN, some only NaN: the test is faster than Arrow's conversion.
            is_nan = np.isnan(values)
            has_nan = bool(is_nan.any())
            if has_nan and bool(is_nan.all()):
                values = None
        if values is None:
            values = pa.nulls(rows, item.type)
        if not isinstance(values, pa.Array):
            values = pa.array(values, item.type, from_pandas=has_nan)
        arrays.append(values)
    return pa.table(arrays, schema=schema)


def table_of_observations(
    batch: Batch, corrections: Corrections, h_g: Any, pixels: PixelSystem, schema: pa.Schema
) -> pa.Table:
    """The output rows of a batch, in the pixel system of the table that it was read from.

    ``h_g`` (n,) are ground heights [m]. ``schema`` is that of corrected or of displaced
    observations: it decides under which names the new pixels are written.
    """
    x = pixels.from_colmap(corrections.x_corrected_px)
    y = pixels.from_colmap(corrections.y_corrected_px)
    names = pa.array(STATUS_NAMES)
    sigmas: dict[str, Any] = dict.fromkeys(Sigmas.column_names())
    if corrections.sigmas is not None:
        sigmas = corrections.sigmas.named()
    columns = {
        "image": batch.image,
        "point": batch.point,
        "x_px": batch.x_given_px,
        "y_px": batch.y_given_px,
        "x_corrected_px": x,
        "y_corrected_px": y,
        "x_displaced_px": x,  # the schema contains one of the two pairs
        "y_displaced_px": y,
        "zeta_c_rad": corrections.zeta_c_rad,
        "r_c_rad": corrections.r_c_rad,
        "r_cc_rad": corrections.r_cc_rad,
        "h_g_m": h_g,
        "status": names.take(pa.array(corrections.status)),
    }
    return table_of(columns | sigmas | batch.users, schema)


PROFILE_ID = "flight"  # of a single profile; several are flight-001 and so on


def profile_ids(series: ProfileSeries) -> list[str]:
    """The ids of the profiles of a flight, in the order of time: flight, or flight-001, ..."""
    count = len(series.timed_profiles)
    if count == 1:
        return [PROFILE_ID]
    return [f"{PROFILE_ID}-{number:03d}" for number in range(1, count + 1)]


def table_of_stations(stations: Stations, series: ProfileSeries) -> pa.Table:
    """The table of ``stations.parquet``, as GeoParquet with points in EPSG:4979."""
    columns = station_columns(stations)
    columns["geometry"] = points_wkb(
        columns["lon_deg"],
        columns["lat_deg"],
        columns["h_ellipsoid_m"],
    )
    ids = np.array(profile_ids(series), dtype=object)[series.profile_number]
    ids[~stations.ok] = None
    columns["profile_id"] = ids
    system = files("unbend.tables").joinpath("data/wgs84_3d.json").read_text("utf-8")
    geometry = {
        "encoding": "WKB",
        "geometry_types": ["Point", "Point Z"],
        "crs": json.loads(system),
    }
    geo = {
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": {"geometry": geometry},
    }
    return table_of(columns, schema_of(STATION_COLUMNS, {"geo": json.dumps(geo)}))


def rows_of_stations(stations: Stations) -> list[dict[str, Any]]:
    """Stations as rows, with the columns of ``stations.parquet`` except geometry and profile.

    None for values that are unknown.
    """
    columns = station_columns(stations)
    schema = schema_of({name: STATION_COLUMNS[name] for name in columns}, {})
    rows: list[dict[str, Any]] = table_of(columns, schema).to_pylist()
    return rows


def table_of_profiles(
    adjustment: "Adjustment", series: ProfileSeries, heights: ArrayLike | None = None
) -> pa.Table:
    """The table of ``profile.parquet``: all profiles of a flight, one after the other.

    ``heights`` (n,) [m above sea level]; None: the edges of each profile's layers.
    """
    tables = []
    for profile_id, air in zip(profile_ids(series), series.timed_profiles, strict=True):
        tables.append(table_of_profile(adjustment, profile_id, heights, air))
    return pa.concat_tables(tables)


def table_of_profile(
    adjustment: "Adjustment",
    profile_id: str,
    heights: ArrayLike | None = None,
    air: TimedProfile | None = None,
) -> pa.Table:
    """A profile as a table, a row a height, with the standard atmosphere at the same heights.

    The pressure of each row can be computed from its base values and the equation it names.
    ``heights`` (n,) [m above sea level]; None: the edges of the layers. ``air`` is one of several
    profiles along the flight; None: that of the whole flight.
    """
    standard = adjustment.standard
    air = air or TimedProfile(adjustment.time_ns, adjustment.profile, adjustment.covariance)
    profile = air.profile
    time_ns = air.time_ns
    if not adjustment.utc_known:
        time_ns = None
    columns = profile_table(profile, heights)
    h = columns["h_m"]
    columns |= {
        "profile_id": np.full(h.shape, profile_id, dtype=object),
        "time_utc": [time_ns] * h.size,
        "standard_temperature_k": standard.temperature(h),
        "standard_pressure_pa": standard.pressure(h),
        "standard_vapour_pressure_pa": standard.vapour_pressure(h),
        "standard_refractivity": standard.refractivity(h),
        "sigma_temperature_k": None,
        "sigma_refractivity": None,
    }
    covariance = air.covariance
    if covariance is not None:
        columns["sigma_temperature_k"] = covariance.sigma_temperature(h)
        columns["sigma_refractivity"] = covariance.sigma_refractivity(h)
    gravity = profile.gravity
    latitude = gravity.latitude_rad
    extra = {
        "unbend.basis": adjustment.basis,
        "unbend.reason": adjustment.reason,
        "unbend.standard": standard.name,
        "unbend.index": profile.index.name,
        "unbend.wavelength_m": repr(profile.index.wavelength_m),
        "unbend.co2_ppm": repr(profile.index.co2_ppm),
        "latitude": "" if latitude is None else repr(math.degrees(latitude)),
        "g_phi": repr(gravity.g_phi),
        "r_phi": repr(gravity.r_phi),
        "units": "latitude deg, g_phi m s-2, r_phi m",
        "unbend.constant_k_per_m": repr(profile.constant),
        "unbend.pressure": "52: p = p_base (t_base / (t_base + lapse dH)) ** (constant / lapse); "
        "53: p = p_base exp(-constant dH / t_base); dH = geopotential_m - geopotential_base_m",
    }
    return table_of(columns, schema_of(PROFILE_COLUMNS, extra))


def parquet_settings(schema: pa.Schema) -> dict[str, Any]:
    """Settings of pyarrow for writing Parquet with a schema.

    Floats are stored with their bytes split into streams, which compress better; measured numbers
    hardly repeat, so a dictionary of them would be longer. All other columns have dictionaries.
    """
    float_types = (pa.float32(), pa.float64())
    floats = [column.name for column in schema if column.type in float_types]
    return {
        "compression": "lz4",
        "use_byte_stream_split": floats,
        "use_dictionary": [name for name in schema.names if name not in floats],
        "write_page_checksum": True,
    }


def write_parquet(table: pa.Table, path: Path) -> None:
    """Write one complete Parquet file with page checksums."""
    with storage_errors(path):
        pq.write_table(table, path, **parquet_settings(table.schema))
