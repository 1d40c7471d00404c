"""Files of weather models for tests: the air of columns, written as netCDF or GRIB.

The heights of levels are integrated here, apart from the package: WGS84 normal gravity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyproj  # noqa: F401  (before ecCodes)
import xarray

from unbend.simulate.true_air import normal_gravity

PRESSURE_LEVELS = (
    1000,
    975,
    950,
    925,
    900,
    875,
    850,
    825,
    800,
    775,
    750,
    700,
    650,
    600,
    550,
    500,
    450,
    400,
    350,
    300,
    250,
    225,
    200,
    150,
)

Column = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Heights above sea level [m], temperature [K], pressure and vapour pressure [Pa] of a column."""


def geopotential(latitude: float, h: np.ndarray) -> np.ndarray:
    """[m2/s2] of heights [m]; Simpson is exact for gravity to second order."""
    gravity = np.vectorize(lambda z: normal_gravity(latitude, z))
    return h * (normal_gravity(latitude, 0.0) + 4.0 * gravity(0.5 * h) + gravity(h)) / 6.0


def dataset(
    air: Callable[[float, float, np.datetime64], Column],
    latitude_deg: Sequence[float],
    longitude_deg: Sequence[float],
    times: Sequence[str],
    levels: Sequence[float] = PRESSURE_LEVELS,
) -> xarray.Dataset:
    """Fields on pressure levels, with the names of the climate data store since 2024."""
    stamps = np.array(times, "datetime64[ns]")
    shape = (stamps.size, len(levels), len(latitude_deg), len(longitude_deg))
    t = np.empty(shape)
    q = np.empty(shape)
    z = np.empty(shape)
    for i, when in enumerate(stamps):
        for j, north in enumerate(latitude_deg):
            for k, east in enumerate(longitude_deg):
                h, kelvin, p, e = air(np.radians(north), np.radians(east), when)
                at = np.interp(np.log(100.0 * np.array(levels)), np.log(p[::-1]), h[::-1])
                kelvin = np.interp(at, h, kelvin)
                e = np.exp(np.interp(at, h, np.log(e)))
                t[i, :, j, k], z[i, :, j, k] = kelvin, geopotential(np.radians(north), at)
                q[i, :, j, k] = 0.622 * e / (100.0 * np.array(levels) - 0.378 * e)
    on = ("valid_time", "pressure_level", "latitude", "longitude")
    return xarray.Dataset(
        {
            "t": (on, t, {"units": "K"}),
            "q": (on, q, {"units": "kg kg**-1"}),
            "z": (on, z, {"units": "m**2 s**-2"}),
        },
        {
            "valid_time": stamps,
            "pressure_level": (on[1], np.array(levels, float), {"units": "hPa"}),
            "latitude": list(latitude_deg),
            "longitude": list(longitude_deg),
        },
    )


def on_model_levels(
    air: Callable[[float, float, np.datetime64], Column],
    latitude_deg: Sequence[float],
    longitude_deg: Sequence[float],
    times: Sequence[str],
    ground_m: float,
) -> xarray.Dataset:
    """Fields on ECMWF's levels 60 to 137 over a ground at one height [m above sea level]."""
    from unbend.atmosphere.soundings.model_levels import half_levels

    levels = np.arange(60, 138)
    stamps = np.array(times, "datetime64[ns]")
    shape = (stamps.size, levels.size, len(latitude_deg), len(longitude_deg))
    t = np.empty(shape)
    q = np.empty(shape)
    log_p = np.empty(shape)[:, 0]
    z = np.empty(shape)[:, 0]
    for i, j, k in np.ndindex(shape[0], *shape[2:]):
        place = np.radians(latitude_deg[j]), np.radians(longitude_deg[k])
        h, kelvin, p, e = air(*place, stamps[i])
        log_p[i, j, k] = np.interp(ground_m, h, np.log(p))
        z[i, j, k] = geopotential(place[0], np.array(ground_m))
        half = half_levels(np.exp(log_p[i, j, k]))[0, 59:]
        full = 0.5 * (half[1:] + half[:-1])
        at = np.interp(np.log(full), np.log(p[::-1]), h[::-1])
        e = np.exp(np.interp(at, h, np.log(e)))
        t[i, :, j, k], q[i, :, j, k] = np.interp(at, h, kelvin), 0.622 * e / (full - 0.378 * e)
    on = ("valid_time", "hybrid", "latitude", "longitude")
    flat = (on[0], *on[2:])
    return xarray.Dataset(
        {"t": (on, t), "q": (on, q), "lnsp": (flat, log_p), "z": (flat, z)},
        {
            "valid_time": stamps,
            "hybrid": levels.astype(float),
            "latitude": list(latitude_deg),
            "longitude": list(longitude_deg),
        },
    )


def netcdf(path: Path, data: xarray.Dataset) -> Path:
    """The fields as netCDF-4."""
    data.to_netcdf(path, engine="h5netcdf")
    return path


def grib(path: Path, data: xarray.Dataset, lead_h: int = 0) -> Path:
    """The same fields as GRIB2 from ecCodes' sample, a forecast where it has a lead time."""
    import eccodes

    kind = "isobaricInhPa"
    on = "pressure_level"
    if "hybrid" in data.dims:
        kind = "hybrid"
        on = "hybrid"
    north = data.latitude.values
    east = data.longitude.values
    grid = {
        "Ni": east.size,
        "Nj": north.size,
        "latitudeOfFirstGridPointInDegrees": float(north[0]),
        "latitudeOfLastGridPointInDegrees": float(north[-1]),
        "longitudeOfFirstGridPointInDegrees": float(east[0]) % 360.0,
        "longitudeOfLastGridPointInDegrees": float(east[-1]) % 360.0,
        "iDirectionIncrementInDegrees": float(east[1] - east[0]),
        "jDirectionIncrementInDegrees": float(abs(north[1] - north[0])),
        "jScansPositively": int(north[1] > north[0]),
    }
    with path.open("wb") as file:
        for name, field in data.data_vars.items():
            for when in data.valid_time.values:
                of_time = field.sel(valid_time=when)
                run = (when - np.timedelta64(lead_h, "h")).astype("datetime64[s]").item()
                for level in data[on].values if on in field.dims else [1]:
                    message = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
                    for key, value in {
                        **grid,
                        "typeOfLevel": kind,
                        "level": int(level),
                        "shortName": str(name),
                        "dataDate": int(f"{run:%Y%m%d}"),
                        "dataTime": int(f"{run:%H%M}"),
                        "stepRange": lead_h,
                        "bitsPerValue": 24,
                    }.items():
                        eccodes.codes_set(message, key, value)
                    values = of_time.sel({on: level}) if on in field.dims else of_time
                    eccodes.codes_set_values(message, values.values.ravel())
                    eccodes.codes_write(message, file)
                    eccodes.codes_release(message)
    return path
