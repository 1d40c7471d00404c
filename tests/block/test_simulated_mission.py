"""The corrected observations of a simulated mission meet: conventions of frames from end to end."""

from dataclasses import replace

import numpy as np
import pandas as pd

from tests.block.simulated_block import unit
from unbend.block.image_rays import ImageRays, orientations_of
from unbend.block.intersection import intersect
from unbend.flight.stations import STATION_OK, empty_stations
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera

SIGMA = (0.05, 0.05, 0.05, 3e-4, 3e-4, 3e-4)  # what the simulator's sensors err by
SIZES = (
    "width_px",
    "height_px",
    "fx_px",
    "fy_px",
    "cx_px",
    "cy_px",
)


def stations_of(table):
    empty = empty_stations(
        table.image.to_numpy(object),
        table.camera.to_numpy(object),
        STATION_OK,
    )
    return replace(
        empty,
        lat_rad=np.radians(table.lat_deg.to_numpy()),
        lon_rad=np.radians(table.lon_deg.to_numpy()),
        h_ellipsoid_m=table.h_ellipsoid_m.to_numpy(),
        quaternion=table[["q_w", "q_x", "q_y", "q_z"]].to_numpy(),
        status=table.status.to_numpy(object),
    )


def test_rays_of_a_run_meet_at_the_heights_of_its_ground(baseline):
    table = baseline.stations().to_pandas()
    rows = baseline.results().to_pandas()
    count = len(table)
    logged = orientations_of(stations_of(table))
    sigma = np.tile(SIGMA, (count, 1))
    orientations = replace(logged, sigma=sigma)
    image = pd.Index(table.image).get_indexer(rows.image)
    assert (image >= 0).all()  # each has a station
    point, _ = pd.factorize(rows.point, sort=True)
    corrected_px = rows[["x_corrected_px", "y_corrected_px"]].to_numpy()
    camera_of_row = table.camera.to_numpy()[image]
    direction = np.ones((len(rows), 3))
    for name, keys in baseline.config["cameras"].items():
        is_of_camera = camera_of_row == name
        sizes = [keys[key] for key in SIZES]
        lens = BrownConrady(**keys["distortion"])
        camera = Camera(*sizes, lens)
        x_px, y_px = corrected_px[is_of_camera].T
        u, v, _ = camera.rays(x_px, y_px)
        direction[is_of_camera, 0] = u
        direction[is_of_camera, 1] = v
    rays = ImageRays(
        image,
        point,
        unit(direction),
        sigma_rad=0.5 / 20_000.0,
    )

    points = intersect(orientations, rays)

    assert points.used.sum() >= 5
    assert 0.3 < points.sigma_factor < 1.7
    undulation_m = (table.h_ellipsoid_m - table.h_msl_m).mean()
    ground_m = rows.h_g_m.groupby(point).mean()
    _, _, height_m = points.geodetic
    off_m = np.abs(height_m - undulation_m - ground_m.to_numpy())
    assert np.nanmax(off_m / points.sigma_height_m) < 4.0
    half = count // 2
    rows = np.arange(2 * half)
    swapped = orientations.assigned(np.roll(rows, half))
    swapped = intersect(swapped, rays)
    assert points.log_likelihood - swapped.log_likelihood > 50.0
