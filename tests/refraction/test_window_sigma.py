"""Sigmas behind plane windows against corrections in changed air, column by column of C."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from tests.refraction import uncertain_air
from tests.refraction.comparing import assert_close
from tests.refraction.images import (
    DOWN,
    RADIUS,
    SKEWED,
    Look,
    corrected,
    looking,
    station_sigmas,
    turned,
    uncertainties,
)
from tests.refraction.uncertain_air import AIR, COVARIANCE, TABLE
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.refraction import WindowRays, leading_mode, ray_table, refraction_angle
from unbend.refraction.uncertainty.budget import window_turn
from unbend.refraction.uncertainty.sigmas import OPEN, SCHEDULED, SEALED, window_kind_of
from unbend.refraction.window import refract_at_window

BANKED = turned("zyx", [20.0, 5.0, 40.0]) @ DOWN
FORTY = looking(40.0)
LEANING = tuple(turned("xy", [25.0, -10.0])[:, 2])
FLOOR = tuple(-FORTY[:, 2])  # of a level aircraft, whatever the camera does

H_C = 2680.0
LOOKS = {
    "no window": Look(BANKED, H_C),
    "nadir camera": Look(DOWN, H_C, kind=SEALED),
    "banked camera, own window": Look(BANKED, H_C, kind=SEALED),
    "banked camera, leaning window": Look(BANKED, H_C, LEANING, SEALED),
    "oblique camera over the floor": Look(FORTY, H_C, FLOOR, SEALED),
    "schedule below 3 km": Look(BANKED, H_C, kind=SCHEDULED),
    "schedule, nadir": Look(DOWN, 1500.0, kind=SCHEDULED),
    "schedule, leaning": Look(BANKED, H_C, LEANING, SCHEDULED),
    "schedule above 3 km": Look(BANKED, 5200.0, kind=SEALED),
}
EVERY_LOOK = pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)


def shifts(air, table, look, *, higher_m=0.0, **options):
    rng = np.random.default_rng(5)
    x = rng.uniform(0, SKEWED.width_px, 40)
    y = rng.uniform(0, SKEWED.height_px, 40)
    return corrected(
        x,
        y,
        look.exposure(air, higher_m=higher_m),
        table,
        camera=SKEWED,
        h_g=rng.uniform(0.0, 700.0, 40),
        **options,
    )


def claimed(covariance, look, height=0.0):
    made = uncertainties(
        AIR,
        covariance,
        look.exposure(AIR),
        SKEWED,
        station_sigmas(height=height),
        window_kinds=np.array([look.kind]),
    )
    return shifts(AIR, TABLE, look, uncertainty=made).sigmas


@dataclass(frozen=True)
class Doubt:
    """A covariance of the air, by its root (state, k)."""

    root: np.ndarray

    @property
    def covariance(self):
        return ProfileCovariance(AIR, uncertain_air.ANCHOR_M, self.root @ self.root.T)

    @cached_property
    def pairs(self):
        """Two airs, and how rays bend in them, for each column of the root and its opposite."""
        pairs = []
        for column in self.root.T:
            more = uncertain_air.changed(column)
            less = uncertain_air.changed(-column)
            pairs.append([(more, ray_table(more)), (less, ray_table(less))])
        return pairs

    def sigma(self, look, name):
        """That of dx, dy or R_c from corrections in the airs."""
        variance = 0.0
        for more, less in self.pairs:
            plus = getattr(shifts(*more, look), name)
            minus = getattr(shifts(*less, look), name)
            variance = variance + (0.5 * (plus - minus)) ** 2
        return np.sqrt(variance)


SIGMA_OF = {"dx_px": "air_dx_px", "dy_px": "air_dy_px", "r_c_rad": "r_c_rad"}


def assert_claims(doubt, covariance, look):
    """Sigmas are the differences, to half a per cent; where they nearly vanish, of the usual."""
    claims = claimed(covariance, look)
    for name, name_of_sigma in SIGMA_OF.items():
        expected = doubt.sigma(look, name)
        sigma = getattr(claims, name_of_sigma)
        assert_close(sigma, expected, rtol=0.005, atol=0.002 * np.median(expected))


@pytest.fixture(scope="module")
def of_pressure():
    """0.4 % uncertainty of pressure."""
    root = np.zeros((uncertain_air.STATES, 1))
    root[uncertain_air.SIZE] = 0.004
    return Doubt(root)


@pytest.fixture(scope="module")
def of_all():
    """Uncertain temperatures, pressure and humidity."""
    return Doubt(uncertain_air.root())


@EVERY_LOOK
def test_the_air_in_doubt_by_its_pressure(of_pressure, look):
    """A window that looks down turns the ray by N_c, which the way takes back."""
    assert_claims(of_pressure, of_pressure.covariance, look)


@pytest.mark.parametrize(
    "name",
    [
        "no window",
        "nadir camera",
        "banked camera, leaning window",
        "schedule, leaning",
    ],
)
def test_the_air_in_doubt_altogether(of_all, name):
    assert_claims(of_all, COVARIANCE, LOOKS[name])


@EVERY_LOOK
def test_the_height_of_the_station(look):
    """Higher up the air outside is thinner, that in the cabin is not, or follows the schedule."""
    sigmas = claimed(None, look, height=12.0)
    high = shifts(AIR, TABLE, look, higher_m=12.0)
    low = shifts(AIR, TABLE, look, higher_m=-12.0)
    for name in ("dx_px", "dy_px"):
        difference = getattr(high, name) - getattr(low, name)
        expected = np.abs(0.5 * difference)
        sigma = getattr(sigmas, f"station_{name}")
        assert_close(sigma, expected, rtol=0.01, atol=0.003 * np.median(expected))


def net_directions(air, look, rays):
    """Corrected rays (n, 3) in east-north-up, by the window and the angle alone; and R_c."""
    exposures = look.exposure(air)
    if look.kind != OPEN:
        (inside,) = exposures.refractivity_cabin
        (outside,) = exposures.refractivity_outside
        change, _ = refract_at_window(rays, inside, outside, np.array(look.normal))
        rays = rays + change
    east, north, up = (rays @ look.rotation).T
    zeta = np.arctan2(np.hypot(east, north), -up)
    r_c = refraction_angle(
        air,
        look.h_c,
        100.0,
        zeta,
        RADIUS,
    )
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
    changes = []
    for (more, _), (less, _) in of_all.pairs:
        plus, _ = net_directions(more, look, rays)
        minus, _ = net_directions(less, look, rays)
        changes.append(0.5 * (plus - minus))
    moved = np.array(changes)
    straight, r_c = net_directions(AIR, look, rays)
    # Towards the nadir, (columns, n), and all of it.
    to_nadir = np.array([0.0, 0.0, -1.0]) + straight[:, 2:] * straight
    to_nadir /= np.linalg.norm(to_nadir, axis=1)[:, None]
    errors = np.einsum("kni,ni->kn", moved, to_nadir)
    left, size, _ = np.linalg.svd(moved.reshape(len(moved), -1), full_matrices=False)
    of_columns = left[:, 0] * np.sign(left[:, 0] @ errors @ r_c)

    down = np.tile(-look.rotation[:, 2], (30, 1))
    normals = np.tile(look.normal, (30, 1))
    zeta_c = np.arccos(-straight[:, 2]) + r_c
    window_rays = WindowRays(
        np.full(30, look.h_c),
        zeta_c,
        np.full(30, look.kind),
        *window_turn(rays, down, normals),
    )
    mode = leading_mode(
        AIR,
        COVARIANCE,
        window_rays,
        100.0,
        radius=RADIUS,
    )
    assert_close(mode.sigma, size[0] / np.linalg.norm(r_c), rtol=2e-3)
    share = size[0] ** 2 / np.sum(size**2)
    assert_close(mode.variance_share, share, rtol=2e-3)
    # The same change of the air, wherever it matters: a hundredth of its largest.
    state = of_all.root @ of_columns
    largest = np.abs(state).max()
    assert_close(mode.state, state, rtol=1e-7, atol=0.01 * largest)
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
