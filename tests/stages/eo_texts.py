"""Exterior orientations as POSPac writes them, in a grid by pyproj, with angles by scipy."""

import numpy as np
import pandas as pd
import pyproj
from scipy.spatial.transform import Rotation

from tests.stages.flown_files import gps_time
from tests.stages.oriented_tables import attitudes

ZONE = 32  # of UTM, in which the flight is
GRID = f"EPSG:{32600 + ZONE}"
PHOTOGRAMMETRIC = np.diag([1.0, -1.0, -1.0])
HEADS = {"h_msl_m": "ORTHOMETRIC HEIGHT", "h_ellipsoid_m": "ELLIPSOID HEIGHT"}


def write_eo(
    path,
    stations,
    *,
    axes="XYZ",
    head="",
    height="h_msl_m",
    zone=ZONE,
    turn_deg=0.0,
):
    """Angles about ``axes`` of the grid, kappa turned further; the head may name another zone.

    Returns the section of the mission file.
    """
    lon, lat = stations[["lon_deg", "lat_deg"]].to_numpy().T
    utm = pyproj.Proj(GRID)
    east, north = utm(lon, lat)
    convergence = utm.get_factors(lon, lat).meridian_convergence[:, None]
    grid_from_enu = Rotation.from_euler("z", convergence, degrees=True).as_matrix()
    enu_from_camera = attitudes(stations).transpose(0, 2, 1)
    grid_from_image = grid_from_enu @ enu_from_camera @ PHOTOGRAMMETRIC
    turns = Rotation.from_matrix(grid_from_image)
    first, second, kappa = turns.as_euler(axes, degrees=True).T
    angle = {axes[0]: first, axes[1]: second}
    week, seconds = gps_time(pd.to_datetime(stations["time_utc"], utc=True))
    table = pd.DataFrame(
        {
            "ID": stations["image"],
            "EVENT": np.arange(len(stations)) + 1,
            "TIME (s)": seconds,
            "EASTING": east,
            "NORTHING": north,
            HEADS[height]: stations[height],
            "OMEGA": angle["X"],
            "PHI": angle["Y"],
            "KAPPA": kappa + turn_deg,
            "LAT": lat,
            "LONG": lon,
        }
    )
    text = f"{head}Grid: Zone: UTM North {zone}; lat, long in Deg; orientation in Degrees ;\n\n"
    text += " ".join(table.columns) + "\n"
    text += table.to_csv(sep=" ", header=False, index=False, float_format="%.9f")
    path.write_text(text)
    return {
        "path": path.name,
        "image": "{name}",
        "time": {"system": "gpst", "week": int(week.iloc[0])},
    }
