"""Sigmas behind plane windows against corrections in changed air, column by column of C."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.atmosphere.covariance import ProfileCovariance
from unbend.refraction import (
    BrownConrady,
    Camera,
    Exposures,
    StationSigmas,
    WindowRays,
    correct_observations,
    leading_mode,
    ray_table,
    refraction_angle,
    uncertainty_of,
)
from unbend.refraction.uncertainty.budget import window_turn
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED, window_kind_of
from unbend.refraction.window import refract_at_window

RADIUS = 6_371_000.0
CAMERA = Camera(
    14_000,
    10_600,
    11_000.0,
    11_200.0,
    7012.4,
    5291.7,
    BrownConrady(-0.02, 0.01, -0.002, 2e-4, -1e-4),
)
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
BANKED = Rotation.from_euler("zyx", [20.0, 5.0, 40.0], degrees=True).as_matrix() @ DOWN
FORTY = Rotation.from_euler("x", -40.0, degrees=True).as_matrix() @ DOWN
LEANING = Rotation.from_euler("xy", [25.0, -10.0], degrees=True).as_matrix()[:, 2]
CABIN = 2.4e-4


def nadir_in(rotation) -> tuple[float, ...]:
    """A window in the floor of a level aircraft, whatever the camera does."""
    return tuple(-rotation[:, 2])


# Rotation of the camera, its height, normal of the window, what is in front.
LOOKS = {
    "no window": (BANKED, 2680.0, (0.0, 0.0, 1.0), OPEN),
    "nadir camera": (DOWN, 2680.0, (0.0, 0.0, 1.0), SEALED),
    "banked camera, own window": (BANKED, 2680.0, (0.0, 0.0, 1.0), SEALED),
    "banked camera, leaning window": (BANKED, 2680.0, tuple(LEANING), SEALED),
    "oblique camera over the floor": (FORTY, 2680.0, nadir_in(FORTY), SEALED),
    "schedule below 3 km": (BANKED, 2680.0, (0.0, 0.0, 1.0), SCHEDULED),
    "schedule, nadir": (DOWN, 1500.0, (0.0, 0.0, 1.0), SCHEDULED),
    "schedule, leaning": (BANKED, 2680.0, tuple(LEANING), SCHEDULED),
    "schedule above 3 km": (BANKED, 5200.0, (0.0, 0.0, 1.0), SEALED),
}


def exposed(profile, look, at_m: float | None = None) -> Exposures:
    """The exposure as this air has it: the cabin of the schedule follows the pressure outside."""
    rotation, h_c, normal, view = look
    h = np.array([h_c if at_m is None else at_m])
    outside = profile.refractivity(h)
    cabin = {
        OPEN: outside,
        SEALED: np.array([CABIN]),
        SCHEDULED: profile.index.refractivity(294.26, profile.pressure(h), 0.0),
    }[view]
    return Exposures(
        np.array([True]),
        rotation[None],
        np.array([0.8]),
        h,
        outside,
        cabin,
        np.array([normal]),
        radius_m=RADIUS,
    )


def points(n=40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    x = rng.uniform(0, CAMERA.width_px, n)
    y = rng.uniform(0, CAMERA.height_px, n)
    return x, y, rng.uniform(0.0, 700.0, n)


def shifts(profile, table, look, at_m=None, **more):
    x, y, h_g = points()
    zero = np.zeros(x.size, np.int64)
    return correct_observations(
        x, y, h_g, zero, exposed(profile, look, at_m), camera=CAMERA, table=table, **more
    )


def claimed(profile, covariance, look, height=0.0):
    stations = StationSigmas(
        np.zeros(1), np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full(1, height)
    )
    made = uncertainty_of(
        profile,
        covariance,
        exposed(profile, look),
        stations,
        [(CAMERA, np.array([True]))],
        ground_heights_m=(-600.0, 10_000.0),
        window_kinds=np.array([look[3]]),
    )
    return shifts(profile, ray_table(profile), look, uncertainty=made).sigmas


def changed(airs, root: np.ndarray) -> list[list[tuple]]:
    """Two airs for each column of the root of a covariance, with it added and taken away."""
    size = airs.EDGES.size
    pairs = []
    for column in root.T:
        pair = []
        for x in (column, -column):
            air = airs.profile_of(
                airs.temperatures() + x[:size],
                float(x[size]),
                airs.vapour() + x[size + 1 :],
            )
            pair.append((air, ray_table(air)))
        pairs.append(pair)
    return pairs


@pytest.fixture(scope="module")
def by_pressure(airs):
    """0.4 % uncertainty of pressure: air, covariance, and the airs that differ by it."""
    profile = airs.air()[0]
    size = airs.EDGES.size
    root = np.zeros((2 * size + 1, 1))
    root[size] = 0.004
    covariance = ProfileCovariance(profile, airs.ANCHOR_M, root @ root.T)
    return profile, covariance, changed(airs, root)


@pytest.fixture(scope="module")
def by_all(airs):
    """Uncertain temperatures, pressure and humidity."""
    return *airs.air(), changed(airs, airs.root())


def differences(airs, look) -> np.ndarray:
    """(3, n) sigma of dx, dy and R_c from corrections in the airs."""
    variance = np.zeros((3, points()[0].size))
    for pair in airs:
        one, two = (shifts(*air, look) for air in pair)
        for i, name in enumerate(("dx_px", "dy_px", "r_c_rad")):
            variance[i] += (0.5 * (getattr(one, name) - getattr(two, name))) ** 2
    return np.sqrt(variance)


def assert_claims(made, look) -> None:
    """Sigmas are the differences, to half a per cent; where they nearly vanish, of the usual."""
    profile, covariance, airs = made
    found = claimed(profile, covariance, look)
    sigmas = found.air_dx_px, found.air_dy_px, found.r_c_rad
    for sigma, expected in zip(sigmas, differences(airs, look), strict=True):
        np.testing.assert_allclose(
            sigma, expected, rtol=0.005, atol=0.002 * float(np.median(expected))
        )


@pytest.mark.parametrize("name", LOOKS)
def test_the_air_in_doubt_by_its_pressure(by_pressure, name):
    """A window that looks down turns the ray by N_c, which the way takes back."""
    assert_claims(by_pressure, LOOKS[name])


@pytest.mark.parametrize(
    "name", ["no window", "nadir camera", "banked camera, leaning window", "schedule, leaning"]
)
def test_the_air_in_doubt_altogether(by_all, name):
    assert_claims(by_all, LOOKS[name])


def test_a_cabin_makes_doubt_of_pressure_larger_and_a_schedule_smaller(by_pressure):
    """What is at stake: N of the way alone is several times N of the way less N_c."""
    profile, covariance, _ = by_pressure

    def median(name):
        return float(np.median(claimed(profile, covariance, LOOKS[name]).air_dy_px))

    assert median("banked camera, own window") > 2.0 * median("no window")
    assert median("schedule below 3 km") < 0.5 * median("banked camera, own window")


@pytest.mark.parametrize("name", LOOKS)
def test_the_height_of_the_station(by_pressure, name):
    """Higher up the air outside is thinner, that in the cabin is not, or follows the schedule."""
    profile, _, _ = by_pressure
    look = LOOKS[name]
    sigma = 12.0
    table = ray_table(by_pressure[0])
    found = claimed(profile, None, look, height=sigma)
    high, low = (shifts(profile, table, look, look[1] + d) for d in (sigma, -sigma))
    for got, axis in ((found.station_dx_px, "dx_px"), (found.station_dy_px, "dy_px")):
        expected = np.abs(0.5 * (getattr(high, axis) - getattr(low, axis)))
        np.testing.assert_allclose(
            got, expected, rtol=0.01, atol=0.003 * float(np.median(expected))
        )


def net_directions(profile, look, rays) -> tuple[np.ndarray, np.ndarray]:
    """Corrected rays (n, 3) in east-north-up, by the window and the angle alone; and R_c."""
    rotation, h_c, normal, view = look
    ex = exposed(profile, look)
    change, _ = refract_at_window(
        rays, ex.refractivity_cabin, ex.refractivity_outside, np.array(normal)
    )
    out = (rays + change if view != OPEN else rays) @ rotation
    zeta = np.arctan2(np.hypot(out[:, 0], out[:, 1]), -out[:, 2])
    r_c = refraction_angle(profile, h_c, 100.0, zeta, RADIUS)
    level = out[:, :2] / np.sin(zeta)[:, None]
    chord = zeta - r_c
    return np.column_stack([level * np.sin(chord)[:, None], -np.cos(chord)]), r_c


def rays_of(look, rays, zeta) -> WindowRays:
    rotation, height, normal, view = look
    down = np.broadcast_to(-rotation[:, 2], rays.shape)
    turns = window_turn(rays, down, np.broadcast_to(normal, rays.shape))
    count = len(rays)
    return WindowRays(np.full(count, height), zeta, np.full(count, view), *turns)


@pytest.mark.parametrize("name", ["no window", "nadir camera", "banked camera, leaning window"])
def test_the_leading_mode_is_that_of_changed_airs(airs, by_all, name):
    """The singular vector of what changed air does to corrected rays, without a derivative."""
    profile, covariance, changed_airs = by_all
    look = LOOKS[name]
    u, v = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 30))
    rays = np.stack([u, v, np.ones(30)], axis=1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    straight, r_c = net_directions(profile, look, rays)
    moved = np.array(
        [
            0.5 * (net_directions(one[0], look, rays)[0] - net_directions(two[0], look, rays)[0])
            for one, two in changed_airs
        ]
    )
    # Towards the nadir, (columns, n), and all of it.
    to_nadir = np.array([0.0, 0.0, -1.0]) + straight[:, 2:] * straight
    to_nadir /= np.linalg.norm(to_nadir, axis=1)[:, None]
    errors = np.einsum("kni,ni->kn", moved, to_nadir)
    left, size, _ = np.linalg.svd(moved.reshape(len(moved), -1), full_matrices=False)
    of_columns = left[:, 0] * np.sign(left[:, 0] @ errors @ r_c)

    zeta = np.arctan2(np.hypot(*straight[:, :2].T), -straight[:, 2]) + r_c
    mode = leading_mode(profile, covariance, rays_of(look, rays, zeta), 100.0, radius=RADIUS)
    np.testing.assert_allclose(mode.sigma, size[0] / np.linalg.norm(r_c), rtol=2e-3)
    np.testing.assert_allclose(mode.variance_share, size[0] ** 2 / np.sum(size**2), rtol=2e-3)
    # The same change of the air, wherever it matters: a hundredth of its largest.
    state = airs.root() @ of_columns
    np.testing.assert_allclose(mode.state, state, atol=0.01 * np.abs(state).max())
    if name == "banked camera, leaning window":
        assert mode.variance_share < 0.99


def test_the_schedule_ends_where_the_cabin_stops_to_follow():
    """701.2 hPa: thinner air outside leaves the cabin as it is."""
    outside = np.array([90_000.0, 70_121.0, 70_119.0, np.nan])
    assert window_kind_of(outside, scheduled=True).tolist() == [
        SCHEDULED,
        SCHEDULED,
        SEALED,
        SEALED,
    ]
    assert window_kind_of(outside, scheduled=False).tolist() == [SEALED] * 4
