"""Stations as tables of places and angles, as programs of bundle adjustment write them."""

import pandas as pd
from scipy.spatial.transform import Rotation

from tests.stages.block_files import matrices

OPK = ["omega", "phi", "kappa"]
PLACE = ["latitude", "longitude", "height"]
QUATERNION = ["q_w", "q_x", "q_y", "q_z"]


def attitudes(table):
    """(n, 3, 3) from east, north, up to the cameras."""
    return matrices(table[QUATERNION])


def textbook_opk(matrix):
    """(n, 3) degrees: turns about x, y and z from the world to a camera of x right, y up."""
    world_from_camera = matrix.transpose(0, 2, 1) * [1.0, -1.0, -1.0]
    rotation = Rotation.from_matrix(world_from_camera)
    return rotation.as_euler("XYZ", degrees=True)


def columns_of(table, digits=9):
    """image, camera, time, latitude, longitude, height above sea level, omega, phi, kappa."""
    time = pd.to_datetime(table["time_utc"])
    rows = table[["image", "camera"]].copy()
    rows["time"] = time.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    rows["latitude"] = table["lat_deg"].round(digits)
    rows["longitude"] = table["lon_deg"].round(digits)
    rows["height"] = table["h_msl_m"].round(4)
    rows[OPK] = textbook_opk(attitudes(table)).round(digits)
    return rows


PINHOLE = {
    "width_px": 14000,
    "height_px": 10600,
    "f_px": 20000.0,
    "cx_px": 7012.4,
    "cy_px": 5291.7,
    "calibration": "laboratory",
}
"""The cameras of the simulation without their distortion: the rays of tie points do not meet."""

PINHOLES = {"nadir": PINHOLE, "oblique": PINHOLE}
