"""The corrected observations of a simulated mission meet: conventions of frames from end to end."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from unbend.block.image_rays import ImageRays, orientations_of
from unbend.block.intersection import intersect
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera


def test_rays_of_a_run_meet_at_the_heights_of_its_ground(baseline):
    table = baseline.stations().to_pandas()
    rows = baseline.results().to_pandas()
    stations = SimpleNamespace(
        lat_rad=np.radians(table.lat_deg.to_numpy()),
        lon_rad=np.radians(table.lon_deg.to_numpy()),
        h_msl_m=table.h_msl_m.to_numpy(),
        h_ellipsoid_m=table.h_ellipsoid_m.to_numpy(),
        quaternion=table[["q_w", "q_x", "q_y", "q_z"]].to_numpy(),
        ok=(table.status == "ok").to_numpy(),
        camera=table.camera.to_numpy(object),
        **{
            f"sigma_{name}": np.full(len(table), np.nan)
            for name in ("horizontal_m", "height_m", "tilt_rad", "yaw_rad")
        },
    )
    sigma = [0.05, 0.05, 0.05, 3e-4, 3e-4, 3e-4]  # what the simulator's sensors err by
    orientations = replace(orientations_of(stations), sigma=np.tile(sigma, (len(table), 1)))
    image = rows.image.map({name: n for n, name in enumerate(table.image)}).to_numpy()
    direction = np.empty((len(rows), 3))
    for name, keys in baseline.config["cameras"].items():
        own = (stations.camera == name)[image]
        camera = Camera(
            *(keys[key] for key in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")),
            BrownConrady(**keys["distortion"]),
        )
        u, v, _ = camera.rays(
            rows.x_corrected_px[own].to_numpy(), rows.y_corrected_px[own].to_numpy()
        )
        direction[own] = np.stack([u, v, np.ones(u.size)], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points, point = np.unique(rows.point, return_inverse=True)
    rays = ImageRays(image, point, direction, 0.5 / 20_000.0)
    found = intersect(orientations, rays)
    assert found.used.sum() >= 5
    assert 0.3 < found.sigma_factor < 1.7
    undulation = float((table.h_ellipsoid_m - table.h_msl_m).mean())
    ground = rows.h_g_m.groupby(point).mean().to_numpy()
    off = found.geodetic[2] - undulation - ground
    assert points.size == off.size
    assert np.nanmax(np.abs(off) / found.sigma_height_m) < 4.0
    half = len(table) // 2
    swapped = orientations.assigned(np.roll(np.arange(2 * half), half))
    assert found.log_likelihood - intersect(swapped, rays).log_likelihood > 50.0
