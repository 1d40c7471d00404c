"""Kernels give the same bits interpreted and compiled, in hard cases too."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.refraction import (
    Camera,
    Exposures,
    StationSigmas,
    bend,
    correct_observations,
    height_at_distance,
    ray_table,
    uncertainty_of,
)
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.general_frame import GeneralFrame
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.refraction.image import straight_reach
from unbend.refraction.kernels.columns import RayColumns
from unbend.refraction.kernels.jit import Kernel
from unbend.refraction.kernels.ray import bend_rays
from unbend.refraction.status_codes import STATUS_NAMES
from unbend.refraction.window import refract_at_window

AIR = standard_atmosphere("us1976")
TABLE = ray_table(AIR)
RNG = np.random.default_rng(20261123)


def both(monkeypatch, call):
    """What a call gives when all kernels are interpreted, and when all are compiled."""
    with monkeypatch.context() as patch:
        patch.setattr(Kernel, "__call__", Kernel.interpreted)
        interpreted = call()
    with monkeypatch.context() as patch:
        patch.setattr(Kernel, "always_compiled", True)
        compiled = call()
    return interpreted, compiled


def assert_same_bits(interpreted, compiled):
    assert len(interpreted) == len(compiled) > 0
    for one, other in zip(interpreted, compiled, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(np.isnan(one), np.isnan(other))
        known = ~np.isnan(one)
        assert one[known].tobytes() == other[known].tobytes()


@pytest.mark.parametrize(
    "distortion",
    [BrownConrady(-0.018, 0.009, -0.002, 1e-4, -1e-4), OpenCVFisheye(0.01, -0.002),
     GeneralFrame(k1=-0.02, q1=0.01, px=1e-4, sense=-1.0)],
)  # fmt: skip
def test_image_points_behind_windows_and_their_sigmas(monkeypatch, distortion):
    """Pixels outside the format, no number, no station; a window that reflects; rays upwards."""
    n, seen = 160, 4
    camera = Camera(8000, 6000, 5000.0, 5010.0, 4012.4, 2991.7, distortion)
    height = np.array([3000.0, 6000.0, 9000.0, 3000.0])
    roll = np.radians([0.0, 20.0, 60.0, 75.0])
    zero, one = np.zeros(seen), np.ones(seen)
    turned = np.moveaxis(np.array([
        [one, zero, zero], [zero, -np.cos(roll), -np.sin(roll)], [zero, np.sin(roll), -np.cos(roll)]
    ]), 2, 0)  # fmt: skip
    outside = AIR.refractivity(height)
    exposures = Exposures(
        np.array([True, True, True, True]), turned, 0.8 * one, height, outside,
        outside + np.array([7e-5, 0.0, 7e-5, 0.4]), principal_change_px=0.3 * one,
    )  # fmt: skip
    stations = StationSigmas(1e-3 * one, 3e-3 * one, np.tile([0.0, 0.0, 1.0], (seen, 1)), 2.0 * one)
    uncertainty = uncertainty_of(
        AIR, None, exposures, stations, [(camera, one > 0.0)], ground_heights_m=(0.0, 4000.0)
    )
    x, y = RNG.uniform(-500.0, 8500.0, n), RNG.uniform(-500.0, 6500.0, n)
    h_g, x[3], h_g[7] = RNG.uniform(0.0, 4000.0, n), np.nan, np.nan
    row = np.sort(RNG.integers(-1, seen, n))

    def corrected():
        found = correct_observations(
            x, y, h_g, row, exposures, camera=camera, table=TABLE, uncertainty=uncertainty,
            sigma_h_g=np.full(n, 2.0),
        )  # fmt: skip
        assert found.sigmas is not None
        numbers = [v for k, v in vars(found).items() if k != "sigmas"]
        return [*numbers, *found.sigmas._asdict().values(), *camera.rays(x, y)[:2]]

    interpreted, compiled = both(monkeypatch, corrected)
    assert_same_bits(interpreted, compiled)
    assert np.isfinite(interpreted[0]).sum() > 30


def test_rays_of_all_kinds(monkeypatch):
    """Steep, level, upwards, along the horizon, through the lowest point; heights outside."""
    n = 180
    zeta = np.radians(np.concatenate([RNG.uniform(0.0, 180.0, 80), RNG.uniform(85.0, 91.0, 100)]))
    h_c = np.where(np.arange(n) % 3 == 0, 3000.0, RNG.uniform(-1000.0, 90_000.0, n))
    h_g = np.where(np.arange(n) % 5 == 0, h_c, RNG.uniform(-1000.0, 20_000.0, n))
    h_g[5], zeta[9], h_c[11:60], zeta[11:60] = np.nan, np.nan, 5000.0, np.linspace(0.0, 1.0, 49)
    distance = RNG.uniform(0.0, 800_000.0, n)
    distance[::2] = np.nan

    def rays():
        sine, cosine = np.sin(zeta), np.cos(zeta)
        bent = bend(TABLE, h_c, h_g, sine, cosine, distance=distance)
        at = height_at_distance(TABLE, h_c, sine, cosine, distance)
        reach = straight_reach(h_c, h_g, cosine, radius=6371e3, far=np.arange(n) % 2)
        direction = np.stack([sine, 0.0 * sine, cosine], axis=1)
        return [*bent, *at, reach, *refract_at_window(direction, 0.3, np.linspace(0.0, 1.0, n))]

    interpreted, compiled = both(monkeypatch, rays)
    assert_same_bits(interpreted, compiled)
    names = {STATUS_NAMES[code] for code in interpreted[1]}
    assert names >= {"ok", "bad_measurement", "misses_ground", "outside_profile", "far_branch",
                     "beyond_grazing"}  # fmt: skip


def test_one_angle_needs_no_compiler(monkeypatch):
    code = (
        "import sys\n"
        "from unbend.atmosphere import standard_atmosphere\n"
        "from unbend.refraction import refraction_angle\n"
        "print(refraction_angle(standard_atmosphere('us1976'), 1e4, 0.0, 1.3).hex(),\n"
        "      'numba' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    value, loaded = ended.stdout.split()
    assert loaded == "False"
    sine, cosine = np.sin([1.3]), np.cos([1.3])
    kernel, angle = np.full(1, np.nan), np.zeros(1, np.uint8)
    whole = [np.array([v]) for v in (1e4, 0.0, sine[0], cosine[0], 6_371_000.0, np.nan)]
    monkeypatch.setattr(Kernel, "always_compiled", True)
    bend_rays(TABLE.pieces, RayColumns(*whole), np.arange(1), kernel, angle)
    assert float.fromhex(value) == kernel[0]


def test_a_ray_that_turns_below_a_near_target_may_mean_the_second_crossing():
    """1 degree below the horizon from 3 km it turns 1.2 km lower: far from grazing at 2800 m."""
    sine, cosine = np.sin(np.radians(89.0)), np.cos(np.radians(89.0))
    near, status = bend(TABLE, 3000.0, 2800.0, sine, cosine)
    assert STATUS_NAMES[int(status)] == "beyond_grazing"
    again, status = bend(TABLE, 3000.0, 2800.0, sine, cosine, distance=12_000.0)
    assert (STATUS_NAMES[int(status)], again) == ("ok", near)
    far, status = bend(TABLE, 3000.0, 2800.0, sine, cosine, distance=240_000.0)
    assert STATUS_NAMES[int(status)] == "far_branch"
    assert far > 5.0 * near
