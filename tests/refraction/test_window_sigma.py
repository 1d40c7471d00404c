"""Sigmas behind plane windows against corrections in changed air, column by column of C."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.refraction import uncertain_air
from tests.refraction.images import (
    DOWN,
    RADIUS,
    SKEWED,
    Look,
    corrected,
    looking,
    station_sigmas,
    uncertainties,
)
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.refraction import WindowRays, leading_mode, ray_table, refraction_angle
from unbend.refraction.uncertainty.budget import window_turn
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED, window_kind_of
from unbend.refraction.window import refract_at_window

AIR, COVARIANCE = uncertain_air.air()
TABLE = ray_table(AIR)
BANKED = Rotation.from_euler("zyx", [20.0, 5.0, 40.0], degrees=True).as_matrix() @ DOWN
FORTY = looking(40.0)
LEANING = tuple(Rotation.from_euler("xy", [25.0, -10.0], degrees=True).as_matrix()[:, 2])
FLOOR = tuple(-FORTY[:, 2])  # of a level aircraft, whatever the camera does

LOOKS = {
    "no window": Look(BANKED, 2680.0),
    "nadir camera": Look(DOWN, 2680.0, kind=SEALED),
    "banked camera, own window": Look(BANKED, 2680.0, kind=SEALED),
    "banked camera, leaning window": Look(BANKED, 2680.0, LEANING, SEALED),
    "oblique camera over the floor": Look(FORTY, 2680.0, FLOOR, SEALED),
    "schedule below 3 km": Look(BANKED, 2680.0, kind=SCHEDULED),
    "schedule, nadir": Look(DOWN, 1500.0, kind=SCHEDULED),
    "schedule, leaning": Look(BANKED, 2680.0, LEANING, SCHEDULED),
    "schedule above 3 km": Look(BANKED, 5200.0, kind=SEALED),
}


def shifts(air, table, look, *, higher_m=0.0, **options):
    rng = np.random.default_rng(5)
    x = rng.uniform(0, SKEWED.width_px, 40)
    y = rng.uniform(0, SKEWED.height_px, 40)
    h_g = rng.uniform(0.0, 700.0, 40)
    exposures = look.exposure(air, higher_m=higher_m)
    return corrected(x, y, exposures, table, camera=SKEWED, h_g=h_g, **options)


def claimed(covariance, look, height=0.0):
    stations = station_sigmas(height=height)
    kinds = np.array([look.kind])
    exposures = look.exposure(AIR)
    made = uncertainties(AIR, covariance, exposures, SKEWED, stations, window_kinds=kinds)
    return shifts(AIR, TABLE, look, uncertainty=made).sigmas


@dataclass(frozen=True)
class Doubt:
    """A covariance of the air, by its root (state, k)."""

    root: np.ndarray

    @property
    def covariance(self) -> ProfileCovariance:
        return ProfileCovariance(AIR, uncertain_air.ANCHOR_M, self.root @ self.root.T)

    @cached_property
    def pairs(self) -> list[list[tuple]]:
        """Two airs, and how rays bend in them, for each column of the root and its opposite."""
        pairs = []
        for column in self.root.T:
            airs = [uncertain_air.changed(column), uncertain_air.changed(-column)]
            pairs.append([(air, ray_table(air)) for air in airs])
        return pairs

    def sigmas(self, look) -> dict[str, np.ndarray]:
        """Those of dx, dy and R_c from corrections in the airs."""
        variance = dict.fromkeys(("dx_px", "dy_px", "r_c_rad"), 0.0)
        for more, less in self.pairs:
            plus = shifts(*more, look)
            minus = shifts(*less, look)
            for name in variance:
                half = 0.5 * (getattr(plus, name) - getattr(minus, name))
                variance[name] = variance[name] + half**2
        return {name: np.sqrt(values) for name, values in variance.items()}


NAMES = {"dx_px": "air_dx_px", "dy_px": "air_dy_px", "r_c_rad": "r_c_rad"}


def assert_claims(doubt, covariance, look) -> None:
    """Sigmas are the differences, to half a per cent; where they nearly vanish, of the usual."""
    claims = claimed(covariance, look)
    for name, expected in doubt.sigmas(look).items():
        sigma = getattr(claims, NAMES[name])
        usual = float(np.median(expected))
        np.testing.assert_allclose(sigma, expected, rtol=0.005, atol=0.002 * usual)


@pytest.fixture(scope="module")
def of_pressure() -> Doubt:
    """0.4 % uncertainty of pressure."""
    root = np.zeros((2 * uncertain_air.EDGES.size + 1, 1))
    root[uncertain_air.EDGES.size] = 0.004
    return Doubt(root)


@pytest.fixture(scope="module")
def of_all() -> Doubt:
    """Uncertain temperatures, pressure and humidity."""
    return Doubt(uncertain_air.root())


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_the_air_in_doubt_by_its_pressure(of_pressure, look):
    """A window that looks down turns the ray by N_c, which the way takes back."""
    assert_claims(of_pressure, of_pressure.covariance, look)


@pytest.mark.parametrize(
    "name", ["no window", "nadir camera", "banked camera, leaning window", "schedule, leaning"]
)
def test_the_air_in_doubt_altogether(of_all, name):
    assert_claims(of_all, COVARIANCE, LOOKS[name])


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_the_height_of_the_station(look):
    """Higher up the air outside is thinner, that in the cabin is not, or follows the schedule."""
    sigmas = claimed(None, look, height=12.0)
    high = shifts(AIR, TABLE, look, higher_m=12.0)
    low = shifts(AIR, TABLE, look, higher_m=-12.0)
    for name in ("dx_px", "dy_px"):
        expected = np.abs(0.5 * (getattr(high, name) - getattr(low, name)))
        sigma = getattr(sigmas, f"station_{name}")
        usual = float(np.median(expected))
        np.testing.assert_allclose(sigma, expected, rtol=0.01, atol=0.003 * usual)


def net_directions(air, look, rays) -> tuple[np.ndarray, np.ndarray]:
    """Corrected rays (n, 3) in east-north-up, by the window and the angle alone; and R_c."""
    exposures = look.exposure(air)
    inside = float(exposures.refractivity_cabin[0])
    outside = float(exposures.refractivity_outside[0])
    if look.kind != OPEN:
        change, _ = refract_at_window(rays, inside, outside, np.array(look.normal))
        rays = rays + change
    east, north, up = (rays @ look.rotation).T
    zeta = np.arctan2(np.hypot(east, north), -up)
    r_c = refraction_angle(air, look.h_c, 100.0, zeta, RADIUS)
    chord = zeta - r_c
    level = np.sin(chord) / np.sin(zeta)
    return np.column_stack([east * level, north * level, -np.cos(chord)]), r_c


@pytest.mark.parametrize("name", ["no window", "nadir camera", "banked camera, leaning window"])
def test_the_leading_mode_is_that_of_changed_airs(of_all, name):
    """The singular vector of what changed air does to corrected rays, without a derivative."""
    look = LOOKS[name]
    u, v = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 30))
    rays = np.stack([u, v, np.ones(30)], axis=1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    moved = []
    for (more, _), (less, _) in of_all.pairs:
        plus, _ = net_directions(more, look, rays)
        minus, _ = net_directions(less, look, rays)
        moved.append(0.5 * (plus - minus))
    moved = np.array(moved)
    straight, r_c = net_directions(AIR, look, rays)
    # Towards the nadir, (columns, n), and all of it.
    to_nadir = np.array([0.0, 0.0, -1.0]) + straight[:, 2:] * straight
    to_nadir /= np.linalg.norm(to_nadir, axis=1)[:, None]
    errors = np.einsum("kni,ni->kn", moved, to_nadir)
    left, size, _ = np.linalg.svd(moved.reshape(len(moved), -1), full_matrices=False)
    of_columns = left[:, 0] * np.sign(left[:, 0] @ errors @ r_c)

    down = np.broadcast_to(-look.rotation[:, 2], rays.shape)
    turns = window_turn(rays, down, np.broadcast_to(look.normal, rays.shape))
    zeta_c = np.arccos(-straight[:, 2]) + r_c
    window_rays = WindowRays(np.full(30, look.h_c), zeta_c, np.full(30, look.kind), *turns)
    mode = leading_mode(AIR, COVARIANCE, window_rays, 100.0, radius=RADIUS)
    np.testing.assert_allclose(mode.sigma, size[0] / np.linalg.norm(r_c), rtol=2e-3)
    np.testing.assert_allclose(mode.variance_share, size[0] ** 2 / np.sum(size**2), rtol=2e-3)
    # The same change of the air, wherever it matters: a hundredth of its largest.
    state = of_all.root @ of_columns
    np.testing.assert_allclose(mode.state, state, atol=0.01 * np.abs(state).max())
    if name == "banked camera, leaning window":
        assert mode.variance_share < 0.99


@pytest.mark.parametrize(
    ("scheduled", "kinds"),
    [
        (True, [SCHEDULED, SCHEDULED, SEALED, SEALED]),
        (False, [SEALED] * 4),
    ],
)
def test_the_schedule_ends_where_the_cabin_stops_to_follow(scheduled, kinds):
    """701.2 hPa: thinner air outside leaves the cabin as it is."""
    outside = np.array([90_000.0, 70_121.0, 70_119.0, np.nan])
    assert window_kind_of(outside, scheduled=scheduled).tolist() == kinds
