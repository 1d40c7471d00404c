"""Files of weather models for tests: the air of columns, written as netCDF or GRIB.

The heights of levels are integrated here, apart from the package: WGS84 normal gravity.
"""

import numpy as np
import pyproj  # noqa: F401  (before ecCodes)
import xarray

from tests.atmosphere.flights import geopotential

PRESSURE_LEVELS = (
    *range(1000, 750, -25),
    *range(750, 250, -50),
    250,
    225,
    200,
    150,
)

COLUMNS = ("valid_time", "latitude", "longitude", "level")
"""Dimensions of fields, column by column."""


def at_pressures(column, pressure_pa):
    """Height [m], temperature [K] and specific humidity of a column at these pressures."""
    h, kelvin, p, e = column
    log_p = np.log(p[::-1])
    levels = np.interp(np.log(pressure_pa), log_p, h[::-1])
    log_e = np.interp(levels, h, np.log(e))
    vapour_pa = np.exp(log_e)
    dry_pa = pressure_pa - 0.378 * vapour_pa
    humidity = 0.622 * vapour_pa / dry_pa
    return levels, np.interp(levels, h, kelvin), humidity


def dataset(
    air,
    latitude_deg,
    longitude_deg,
    times,
    levels=PRESSURE_LEVELS,
):
    """Fields on pressure levels, with the names of the climate data store since 2024.

    ``air`` gives the column at a latitude and longitude [rad] at a time: heights above sea
    level [m], temperature [K], pressure and vapour pressure [Pa].
    """
    stamps = np.array(times, "datetime64[ns]")
    latitude = np.radians(latitude_deg)
    longitude = np.radians(longitude_deg)
    shape = (stamps.size, latitude.size, longitude.size, len(levels))
    t = np.empty(shape)
    q = np.empty(shape)
    z = np.empty(shape)
    pressure_pa = 100.0 * np.array(levels)
    for place in np.ndindex(shape[:3]):
        time, row, column = place
        profile = air(latitude[row], longitude[column], stamps[time])
        h, kelvin, humidity = at_pressures(profile, pressure_pa)
        t[place] = kelvin
        q[place] = humidity
        z[place] = 9.80665 * geopotential(latitude[row], h)
    fields = {
        "t": (COLUMNS, t, {"units": "K"}),
        "q": (COLUMNS, q, {"units": "kg kg**-1"}),
        "z": (COLUMNS, z, {"units": "m**2 s**-2"}),
    }
    hectopascals = np.array(levels, float)
    coordinates = {
        "valid_time": stamps,
        "pressure_level": ("level", hectopascals, {"units": "hPa"}),
        "latitude": list(latitude_deg),
        "longitude": list(longitude_deg),
    }
    return level_by_level(fields, coordinates, "pressure_level")


def on_model_levels(
    air,
    latitude_deg,
    longitude_deg,
    times,
    ground_m,
):
    """Fields on ECMWF's levels 60 to 137 over a ground at one height [m above sea level]."""
    from unbend.atmosphere.soundings.model_levels import half_levels

    levels = np.arange(60, 138)
    stamps = np.array(times, "datetime64[ns]")
    latitude = np.radians(latitude_deg)
    longitude = np.radians(longitude_deg)
    shape = (stamps.size, latitude.size, longitude.size)
    t = np.empty((*shape, levels.size))
    q = np.empty((*shape, levels.size))
    log_p = np.empty(shape)
    z = np.empty(shape)
    for place in np.ndindex(shape):
        time, row, column = place
        profile = air(latitude[row], longitude[column], stamps[time])
        h, _, p, _ = profile
        log_p[place] = np.interp(ground_m, h, np.log(p))
        z[place] = 9.80665 * geopotential(latitude[row], ground_m)
        half = half_levels(np.exp(log_p[place]))[0, 59:]
        full = 0.5 * (half[1:] + half[:-1])
        _, kelvin, humidity = at_pressures(profile, full)
        t[place] = kelvin
        q[place] = humidity
    fields = {
        "t": (COLUMNS, t),
        "q": (COLUMNS, q),
        "lnsp": (COLUMNS[:3], log_p),
        "z": (COLUMNS[:3], z),
    }
    coordinates = {
        "valid_time": stamps,
        "hybrid": ("level", levels.astype(float)),
        "latitude": list(latitude_deg),
        "longitude": list(longitude_deg),
    }
    return level_by_level(fields, coordinates, "hybrid")


def level_by_level(fields, coordinates, level):
    """Fields whose levels are their second dimension, and have a name."""
    data = xarray.Dataset(fields, coordinates).swap_dims({"level": level})
    return data.transpose("valid_time", level, "latitude", "longitude")


def netcdf(path, data):
    """The fields as netCDF-4."""
    data.to_netcdf(path, engine="h5netcdf")
    return path


def grib(path, data, lead_h=0):
    """The same fields as GRIB2 from ecCodes' sample, a forecast where it has a lead time."""
    import eccodes

    kind = "isobaricInhPa"
    level_name = "pressure_level"
    if "hybrid" in data.dims:
        kind = "hybrid"
        level_name = "hybrid"
    north = data.latitude.values.tolist()
    east = data.longitude.values.tolist()
    grid = {
        "Ni": len(east),
        "Nj": len(north),
        "latitudeOfFirstGridPointInDegrees": north[0],
        "latitudeOfLastGridPointInDegrees": north[-1],
        "longitudeOfFirstGridPointInDegrees": east[0] % 360.0,
        "longitudeOfLastGridPointInDegrees": east[-1] % 360.0,
        "iDirectionIncrementInDegrees": east[1] - east[0],
        "jDirectionIncrementInDegrees": abs(north[1] - north[0]),
        "jScansPositively": int(north[1] > north[0]),
        "typeOfLevel": kind,
        "stepRange": lead_h,
        "bitsPerValue": 24,
    }
    with path.open("wb") as file:
        for name, field in data.data_vars.items():
            if level_name not in field.dims:
                field = field.expand_dims({level_name: [1]})
            for when in data.valid_time.values:
                run = (when - np.timedelta64(lead_h, "h")).astype("datetime64[s]").item()
                keys = grid | {
                    "shortName": str(name),
                    "dataDate": int(f"{run:%Y%m%d}"),
                    "dataTime": int(f"{run:%H%M}"),
                }
                for level in field[level_name].values:
                    values = field.sel({"valid_time": when, level_name: level}).values
                    message = eccodes.codes_grib_new_from_samples("regular_ll_pl_grib2")
                    for key, value in (keys | {"level": int(level)}).items():
                        eccodes.codes_set(message, key, value)
                    eccodes.codes_set_values(message, values.ravel())
                    eccodes.codes_write(message, file)
                    eccodes.codes_release(message)
    return path
