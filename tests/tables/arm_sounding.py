"""A radiosonde as netCDF with ARM's names: its variables, which a test may change, and its file."""

from collections.abc import Mapping

import numpy as np
from scipy.io import netcdf_file

RELEASE_S = 1_700_000_000
# US 1976 at geopotential heights [m'], dry.
HEIGHT = np.arange(0.0, 6000.0, 500.0)
CELSIUS = 15.0 - 0.0065 * HEIGHT
HECTOPASCAL = 1013.25 * ((CELSIUS + 273.15) / 288.15) ** 5.255877
VARIABLES = {
    "base_time": np.array(RELEASE_S, "i4"),
    "time_offset": np.arange(HEIGHT.size) * 60.0 + 12.5,
    "lat": np.full(HEIGHT.size, 36.6, "f4"),
    "lon": np.full(HEIGHT.size, -97.5, "f4"),
    "pres": HECTOPASCAL,
    "tdry": CELSIUS,
    "dp": CELSIUS - 10.0,
    "rh": np.full(HEIGHT.size, 50.0),
    "alt": HEIGHT,
}


def write_arm(path, variables: Mapping[str, np.ndarray] = VARIABLES):
    """The file of these variables, each of a number or of one for each level."""
    with netcdf_file(path, "w") as file:
        file.createDimension("time", HEIGHT.size)
        for name, values in variables.items():
            dimensions = ("time",) if values.ndim else ()
            variable = file.createVariable(name, values.dtype, dimensions)
            variable[...] = values
    return path
