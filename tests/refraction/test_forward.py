"""Displaced observations: the way back to the last digit, and what the simulator sees."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.geodesy import euler_radius
from unbend.refraction import BrownConrady, Camera, Exposures, correct_observations, ray_table
from unbend.refraction.forward import apply_refraction
from unbend.refraction.ray import rays_by
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
)
from unbend.simulate.optics import SimulatedCamera, enu_axes, height_and_up, shoot, to_ecef

LATITUDE = 0.8
AIR = standard_atmosphere("us1976", index="gyer")
TABLE = ray_table(AIR)
CAMERA = Camera(
    14_000,
    10_600,
    11_000.0,
    11_000.0,
    7012.4,
    5291.7,
    distortion=BrownConrady(k1=-0.018, k2=0.009, k3=-0.002, p1=1.5e-4, p2=-1e-4),
)
PINHOLE = Camera(14_000, 10_600, 11_000.0, 11_000.0, 7000.0, 5300.0)
DOWN = np.diag([1.0, -1.0, -1.0])
TILTED = (0.0, math.sin(0.3), math.cos(0.3))


def looking(tilt_deg: float, azimuth_deg: float = 0.0, swing_deg: float = 0.0) -> np.ndarray:
    """Rotation of a camera tilted from the nadir towards an azimuth."""
    turn = Rotation.from_euler
    return (
        turn("z", swing_deg, degrees=True).as_matrix()
        @ turn("x", -tilt_deg, degrees=True).as_matrix()
        @ DOWN
        @ turn("z", azimuth_deg, degrees=True).as_matrix()
    )


def seen_from(rotation, h_c, cabin=0.0, normal=(0.0, 0.0, 1.0), change=0.0) -> Exposures:
    outside = float(AIR.refractivity(h_c))
    return Exposures(
        np.array([True]),
        rotation[None],
        np.array([LATITUDE]),
        np.array([h_c]),
        np.array([outside]),
        np.array([outside + cabin]),
        np.array([normal]),
        np.array([change]),
    )


def both_ways(x, y, h_g, exposures, camera=CAMERA, table=TABLE, distance=None):
    """Corrected observations, and these displaced again."""
    x = np.atleast_1d(np.asarray(x, float))
    y = np.atleast_1d(np.asarray(y, float))
    h_g = np.broadcast_to(np.asarray(h_g, float), x.shape)
    first = np.zeros(x.shape, np.int64)
    if distance is not None:
        distance = np.broadcast_to(np.asarray(distance, float), x.shape)
    ideal = correct_observations(
        x, y, h_g, first, exposures, camera=camera, table=table, distance_m=distance
    )
    seen = apply_refraction(
        ideal.x_corrected_px,
        ideal.y_corrected_px,
        h_g,
        first,
        exposures,
        camera=camera,
        table=table,
        distance_m=distance,
    )
    return ideal, seen


SCENES = {
    "nadir": (looking(0.0), 3450.0, 450.0, {}),
    "tilted window": (looking(0.0, 20.0), 9000.0, 100.0, {"cabin": 6e-5, "normal": TILTED}),
    "oblique": (looking(45.0, 200.0, -70.0), 9000.0, 100.0, {"cabin": 6e-5, "change": -4.0}),
    "level": (looking(90.0, 30.0, 5.0), 3450.0, 450.0, {"cabin": 6e-5, "normal": TILTED}),
    "upwards": (looking(90.0), 1000.0, 4000.0, {"change": 2.0}),
}


@pytest.mark.parametrize("scene", SCENES)
def test_there_and_back(scene):
    rotation, h_c, h_g, more = SCENES[scene]
    rng = np.random.default_rng(11)
    x = rng.uniform(0.0, 14_000.0, 1500)
    y = rng.uniform(0.0, 10_600.0, 1500)
    ideal, seen = both_ways(x, y, h_g, seen_from(rotation, h_c, **more))
    # Near the horizon two rays show points of one straight line: see below.
    good = np.isfinite(ideal.x_corrected_px) & (
        np.abs(np.degrees(ideal.zeta_c_rad) - 88.372) > 0.01
    )
    assert good.sum() > 600
    assert np.hypot(ideal.dx_px, ideal.dy_px)[good].max() > 0.4
    np.testing.assert_array_equal(seen.status[good], ideal.status[good])
    for name in ("x_corrected_px", "y_corrected_px"):
        measured = {"x_corrected_px": x, "y_corrected_px": y}[name]
        np.testing.assert_allclose(getattr(seen, name)[good], measured[good], rtol=0.0, atol=1e-9)
    for name, sense in (
        ("dx_px", -1.0),
        ("dy_px", -1.0),
        ("zeta_c_rad", 1.0),
        ("r_c_rad", 1.0),
        ("r_cc_rad", 1.0),
        ("shift_ground_m", 1.0),
    ):
        np.testing.assert_allclose(
            sense * getattr(seen, name)[good], getattr(ideal, name)[good], rtol=0.0, atol=2e-7
        )


@pytest.mark.parametrize("scene", ["nadir", "tilted window", "oblique"])
def test_and_again_from_the_other_side(scene):
    rotation, h_c, h_g, more = SCENES[scene]
    rng = np.random.default_rng(12)
    x = rng.uniform(20.0, 13_980.0, 500)
    y = rng.uniform(20.0, 10_580.0, 500)
    first = np.zeros(500, np.int64)
    exposures = seen_from(rotation, h_c, **more)
    ground = np.full(500, h_g)
    seen = apply_refraction(x, y, ground, first, exposures, camera=CAMERA, table=TABLE)
    assert set(seen.status.tolist()) == {OK}
    back = correct_observations(
        seen.x_corrected_px,
        seen.y_corrected_px,
        ground,
        first,
        exposures,
        camera=CAMERA,
        table=TABLE,
    )
    np.testing.assert_allclose(back.x_corrected_px, x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(back.y_corrected_px, y, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(seen.x_corrected_px - x, seen.dx_px, rtol=0.0, atol=1e-11)


def test_the_ray_is_displaced_away_from_the_nadir():
    x = np.array([8000.0, 7000.0, 7000.0])
    y = np.array([5300.0, 6300.0, 5300.0])
    seen = apply_refraction(
        x,
        y,
        np.zeros(3),
        np.zeros(3, np.int64),
        seen_from(DOWN, 3000.0),
        camera=PINHOLE,
        table=TABLE,
    )
    assert seen.dx_px[0] > 0.01
    assert seen.dy_px[1] == pytest.approx(seen.dx_px[0], rel=1e-2)
    assert abs(seen.dx_px[2]) + abs(seen.dy_px[2]) == 0.0


class FlightAir:
    """US 1976 below 11 km with Gyer's index (Eq. 13), and its slope, from their constants."""

    exponent = 9.80665 * 28.9644 / 8314.32 / 6.5e-3

    def _cooling(self, h):
        return 1.0 - 6.5e-3 / 288.15 * 6_356_766.0 * h / (6_356_766.0 + h)

    def n(self, h_m):
        return 1.0 + 78.831e-6 * 1013.25 / 288.15 * self._cooling(h_m) ** (self.exponent - 1.0)

    def dn_dh(self, h_m):
        rise = (6_356_766.0 / (6_356_766.0 + h_m)) ** 2 * -6.5e-3 / 288.15
        ground = 78.831e-6 * 1013.25 / 288.15
        return ground * (self.exponent - 1.0) * self._cooling(h_m) ** (self.exponent - 2.0) * rise


@pytest.mark.parametrize("tilt", [0.0, 45.0, 70.0])
def test_what_the_simulator_sees(tilt):
    """An image planned in ideal pixels against rays shot through the same air by an ODE."""
    lat = LATITUDE
    lon = 0.2
    h_c = 6000.0
    rotation = looking(tilt, 160.0, 10.0)
    axes = enu_axes(np.array(lat), np.array(lon))
    rng = np.random.default_rng(4)
    towards = np.stack([rng.uniform(-0.6, 0.6, 40), rng.uniform(-0.2, 0.4, 40), np.ones(40)], 1)
    local = towards @ rotation
    local = local[local[:, 2] < -0.05 * np.linalg.norm(local, axis=1)]
    camera_m = np.repeat(to_ecef(np.array(lat), np.array(lon), np.array(h_c))[None], len(local), 0)
    # Points near the ground, wherever exactly: their height is what their coordinates say.
    ground_m = camera_m + (local / -local[:, 2:] * (h_c - 700.0)) @ axes
    h_g = height_and_up(ground_m)[0]
    assert len(local) > 20
    assert np.all((h_g > -100.0) & (h_g < 5990.0))
    rays = shoot(FlightAir(), camera_m, ground_m, 0.0)
    assert rays.miss_m.max() < 1e-6
    lens = SimulatedCamera(
        "planned", 0, 11_000.0, 7012.4, 5291.7, (-0.018, 0.009, 1.5e-4, -1e-4, -0.002), 0.0,
        (0.0, 0.0, 0.0),
    )  # fmt: skip
    ideal, truth = (
        np.stack(lens.project(way @ axes.T @ rotation.T), 1)
        for way in (rays.straight, rays.apparent)
    )
    inside = np.all((truth > 0.0) & (truth < [14_000.0, 10_600.0]), axis=1)
    assert inside.sum() > 15
    seen = apply_refraction(
        ideal[inside, 0],
        ideal[inside, 1],
        h_g[inside],
        np.zeros(inside.sum(), np.int64),
        seen_from(rotation, h_c),
        camera=CAMERA,
        table=TABLE,
    )
    shift = np.abs(truth - ideal)[inside].max()
    miss = np.abs(np.stack([seen.x_corrected_px, seen.y_corrected_px], 1) - truth[inside]).max()
    assert shift > 0.2
    # The sphere in the azimuth of the ray against the ellipsoid.
    assert miss < 2e-5 * shift + 1e-7


def far_end(ideal, h_c, h_g, azimuth=0.0) -> np.ndarray:
    """Where the straight lines come up through a height again [m]."""
    radius = float(euler_radius(LATITUDE, azimuth))
    along = (radius + h_c) * np.cos(ideal.zeta_c_rad - ideal.r_c_rad)
    return along + np.sqrt(along**2 - (h_c - h_g) * (2.0 * radius + h_c + h_g))


def level_pixels(degrees, tilt=90.0) -> np.ndarray:
    """Rows of pixels at nadir angles, for a pinhole that looks north."""
    return PINHOLE.cy_px + 11_000.0 * np.tan(np.radians(tilt - np.asarray(degrees)))


def test_beyond_grazing_survives():
    y = level_pixels([88.2, 88.35])
    ideal, seen = both_ways(np.full(2, 7000.0), y, 450.0, seen_from(looking(90.0), 3450.0), PINHOLE)
    assert ideal.status.tolist() == seen.status.tolist() == [BEYOND_GRAZING] * 2
    np.testing.assert_allclose(seen.y_corrected_px, y, rtol=0.0, atol=1e-9)


WINDOWS = pytest.mark.parametrize(
    ("tilt", "window"),
    [(90.0, {}), (75.0, {"cabin": 6e-5, "normal": TILTED, "change": -4.0})],
    ids=["open", "window"],
)


@WINDOWS
def test_the_far_branch_survives(tilt, window):
    y = level_pixels(np.linspace(88.16, 88.37, 200), tilt)
    x = np.full(200, 7000.0)
    exposures = seen_from(looking(tilt), 3450.0, **window)
    ideal, _ = both_ways(x, y, 450.0, exposures, PINHOLE, distance=1e7)
    y = y[ideal.status == FAR_BRANCH]
    x = x[ideal.status == FAR_BRANCH]
    assert y.size > 180  # the window moves the others over the horizon
    distance = far_end(ideal, 3450.0, 450.0)[ideal.status == FAR_BRANCH]
    ideal, seen = both_ways(x, y, 450.0, exposures, PINHOLE, distance=distance)
    assert set(ideal.status.tolist()) == set(seen.status.tolist()) == {FAR_BRANCH}
    np.testing.assert_allclose(seen.y_corrected_px, y, rtol=0.0, atol=1e-8)
    steep = np.degrees(ideal.zeta_c_rad) < 88.35
    np.testing.assert_allclose(seen.y_corrected_px[steep], y[steep], rtol=0.0, atol=1e-9)
    near, _ = both_ways(x, y, 450.0, exposures, PINHOLE)
    assert np.abs(near.y_corrected_px - ideal.y_corrected_px).min() > 2.0


@WINDOWS
def test_two_rays_for_one_straight_line_are_told_apart_by_distance(tilt, window):
    """Between the straight and the bent horizon the near crossing is the line's far one."""
    radius = float(euler_radius(LATITUDE, 0.0))
    h_c = 3450.0
    h_g = 450.0
    straight = math.asin((radius + h_g) / (radius + h_c))
    n_c = 1.0 + AIR.refractivity(h_c)
    n_g = 1.0 + AIR.refractivity(h_g)
    bent = math.asin(float(n_g) * (radius + h_g) / (float(n_c) * (radius + h_c)))
    exposures = seen_from(looking(tilt), h_c, **window)
    y = level_pixels(np.linspace(88.36, 88.40, 400), tilt)
    ideal, other = both_ways(np.full(400, 7000.0), y, h_g, exposures, PINHOLE)
    band = np.degrees(np.abs(ideal.zeta_c_rad - (bent - math.radians(2e-3)))) < 5e-4
    assert band.sum() > 5
    assert np.all((ideal.zeta_c_rad - ideal.r_c_rad)[band] < straight)
    assert set(other.status[band].tolist()) == {BEYOND_GRAZING}
    assert np.all(np.abs(other.y_corrected_px - y)[band] > 1.0)
    # Both are right: they end in the same ideal pixel.
    again = correct_observations(
        other.x_corrected_px[band],
        other.y_corrected_px[band],
        np.full(band.sum(), h_g),
        np.zeros(band.sum(), np.int64),
        exposures,
        camera=PINHOLE,
        table=TABLE,
    )
    np.testing.assert_allclose(
        again.y_corrected_px, ideal.y_corrected_px[band], rtol=0.0, atol=1e-8
    )
    distance = far_end(ideal.rows(np.flatnonzero(band)), h_c, h_g)
    ideal, seen = both_ways(
        np.full(band.sum(), 7000.0), y[band], h_g, exposures, PINHOLE, distance=distance
    )
    assert set(ideal.status.tolist()) == set(seen.status.tolist()) == {OK}
    np.testing.assert_allclose(seen.y_corrected_px, y[band], rtol=0.0, atol=1e-8)


def test_points_on_the_edge_of_the_format_come_back():
    x = np.array([0.0, 14_000.0, 7000.0, 7000.0])
    y = np.array([5000.0, 5000.0, 0.0, 10_600.0])
    ideal, seen = both_ways(x, y, 450.0, seen_from(DOWN, 3450.0, cabin=8e-5))
    outside = (
        (ideal.x_corrected_px < 0)
        | (ideal.x_corrected_px > 14_000)
        | (ideal.y_corrected_px < 0)
        | (ideal.y_corrected_px > 10_600)
    )
    assert outside.all()  # the window's part is the larger, and the correction goes outward
    assert set(seen.status.tolist()) == {OK}
    np.testing.assert_allclose(seen.x_corrected_px, x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(seen.y_corrected_px, y, rtol=0.0, atol=1e-9)


def test_a_point_displaced_out_of_the_format_is_outside():
    x = np.array([13_999.9, 13_999.0, 14_009.0])
    y = np.full(3, 5300.0)
    seen = apply_refraction(
        x,
        y,
        np.zeros(3),
        np.zeros(3, np.int64),
        seen_from(DOWN, 8000.0),
        camera=PINHOLE,
        table=TABLE,
    )
    assert seen.status.tolist() == [OUTSIDE_CAMERA, OK, OUTSIDE_CAMERA]
    assert np.isfinite(seen.x_corrected_px).tolist() == [False, True, False]
    assert seen.dx_px[1] > 0.2


@pytest.mark.parametrize("axis", [0, 1])
def test_and_over_the_left_and_the_upper_edge(axis):
    pixels = [np.full(2, 7000.0), np.full(2, 5300.0)]
    pixels[axis] = np.array([0.01, 5.0])
    seen = apply_refraction(
        *pixels,
        np.zeros(2),
        np.zeros(2, np.int64),
        seen_from(DOWN, 8000.0),
        camera=PINHOLE,
        table=TABLE,
    )
    assert seen.status.tolist() == [OUTSIDE_CAMERA, OK]


def test_each_reason_in_its_place():
    x = np.array([7000.0, np.nan, np.inf, 7000.0, 7000.0, 1e7, 7000.0, 7000.0, 7000.0])
    y = np.full(9, 5000.0)
    h_g = np.array([450.0, 450.0, 450.0, 450.0, np.nan, 450.0, -9000.0, 450.0, np.inf])
    row = np.array([0, 0, 0, -1, 0, 0, 0, 1, 0])
    one = seen_from(DOWN, 3450.0)
    two = replace(
        one,
        usable=np.array([True, False]),
        **{
            name: np.repeat(getattr(one, name), 2, axis=0)
            for name in (
                "rotation",
                "latitude_rad",
                "height_m",
                "refractivity_outside",
                "refractivity_cabin",
                "window_normal",
                "principal_change_px",
            )
        },
    )
    two.rotation[1] = np.nan
    seen = apply_refraction(x, y, h_g, row, two, camera=CAMERA, table=TABLE)
    assert seen.status.tolist() == [
        OK,
        BAD_MEASUREMENT,
        BAD_MEASUREMENT,
        NO_STATION,
        NO_GROUND,
        OUTSIDE_CAMERA,
        OUTSIDE_PROFILE,
        NO_STATION,
        NO_GROUND,
    ]
    for values in (seen.x_corrected_px, seen.dy_px, seen.r_c_rad, seen.shift_ground_m):
        np.testing.assert_array_equal(np.isfinite(values), seen.status == OK)


def test_over_the_horizon_no_ray_shows_the_ground():
    y = level_pixels([88.0, 88.6, 90.5])
    seen = apply_refraction(
        np.full(3, 7000.0),
        y,
        np.full(3, 450.0),
        np.zeros(3, np.int64),
        seen_from(looking(90.0), 3450.0),
        camera=PINHOLE,
        table=TABLE,
    )
    assert seen.status.tolist() == [OK, MISSES_GROUND, MISSES_GROUND]
    assert np.isfinite(seen.y_corrected_px).tolist() == [True, False, False]


def test_neighbours_do_not_matter():
    rng = np.random.default_rng(8)
    x = rng.uniform(0.0, 14_000.0, 50)
    y = rng.uniform(0.0, 10_600.0, 50)
    x[7] = np.nan
    h_g = np.full(50, 450.0)
    first = np.zeros(50, np.int64)
    exposures = seen_from(DOWN, 3450.0)
    together = apply_refraction(x, y, h_g, first, exposures, camera=CAMERA, table=TABLE)
    for i in (3, 7, 30):
        one = slice(i, i + 1)
        alone = apply_refraction(
            x[one], y[one], h_g[one], first[one], exposures, camera=CAMERA, table=TABLE
        )
        np.testing.assert_allclose(
            alone.x_corrected_px, together.x_corrected_px[one], rtol=0.0, atol=1e-10
        )
        assert alone.status[0] == together.status[i]


def test_a_published_method_goes_both_ways_too():
    rng = np.random.default_rng(6)
    x = rng.uniform(0.0, 14_000.0, 200)
    y = rng.uniform(0.0, 10_600.0, 200)
    for method in ("plane", "gyer1996"):
        ideal, seen = both_ways(
            x, y, 450.0, seen_from(looking(20.0), 3450.0), table=rays_by(AIR, method)
        )
        assert set(ideal.status.tolist()) == {OK}
        np.testing.assert_allclose(seen.x_corrected_px, x, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(seen.y_corrected_px, y, rtol=0.0, atol=1e-9)


def test_nothing_to_displace():
    none = seen_from(DOWN, 3450.0)
    empty = np.empty(0)
    found = apply_refraction(
        empty, empty, empty, np.empty(0, np.int64), none, camera=CAMERA, table=TABLE
    )
    assert found.x_corrected_px.shape == (0,)
    stationless = Exposures(
        np.empty(0, bool), np.empty((0, 3, 3)), empty, empty, empty, empty, np.empty((0, 3)), empty
    )
    one = np.ones(1)
    found = apply_refraction(one, one, one, np.array([-1]), stationless, camera=CAMERA, table=TABLE)
    assert found.status.tolist() == [NO_STATION]
