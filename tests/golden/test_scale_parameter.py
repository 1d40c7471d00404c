"""The recipe of docs/scale_parameter.md: where an adjustment finds the air, and where it cannot.

The truth is the simulator's: rays by its ODE on the ellipsoid, through air that differs from the
profile of the corrections along the leading mode of that profile's covariance.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.logs import REPOSITORY
from unbend import correct, standard_atmosphere
from unbend.atmosphere import Profile
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.refraction import WindowRays, leading_mode
from unbend.simulate.optics import enu_axes, height_and_up, shoot, to_ecef, unit

Array = NDArray[np.float64]

PAGE = (REPOSITORY / "docs" / "scale_parameter.md").read_text("utf-8")
(RECIPE,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)

LAT = np.radians(47.45)
LON = np.radians(8.68)
UNDULATION = 47.6
F = 20_000.0
WIDTH = 14_000
HEIGHT = 10_600
PRINCIPAL = np.array([WIDTH / 2, HEIGHT / 2])
FLYING = 6300.0
GNSS = np.array([0.03, 0.03, 0.05])
EDGES = np.array([-600.0, 11_000.0, 20_000.0, 32_000.0])
TEMPERATURE = np.array([292.05, 216.65, 216.65, 228.65])
VAPOUR = np.array([0.011, 0.0, 0.0, 0.0])
ORIGIN = to_ecef(np.array(LAT), np.array(LON), np.array(UNDULATION))
AXES = enu_axes(np.array(LAT), np.array(LON))
UP = [0.0, 0.0, 1.0]
NORTH = [0.0, 1.0, 0.0]


def recipe():
    """The function `adjust` of the page."""
    names = {}
    exec(compile(RECIPE, "docs/scale_parameter.md", "exec"), names)
    return names["adjust"]


def air_of(state):
    """One layer to 11 km, so that the simulator's rays meet no kink; changed by a state."""
    standard = standard_atmosphere("us1976", latitude=LAT)
    k = EDGES.size
    layers = stack_layers(
        EDGES,
        TEMPERATURE + state[:k],
        VAPOUR + state[k + 1 :],
        ("measured",) * 3,
        anchor=(0.0, 101_325.0 * float(np.exp(state[k]))),
        constant=standard.constant,
    )
    return replace(standard, layers=layers, name="adjusted")


def expected_air():
    """Air of which nothing was measured: 6 K, 0.6 % of pressure, a quarter of the vapour."""
    k = EDGES.size
    size = 2 * k + 1
    matrix = np.zeros((size, size))
    gaps_m = np.abs(EDGES[:, None] - EDGES)
    matrix[:k, :k] = 36.0 * np.exp(-gaps_m / 8000.0)
    matrix[k, k] = 0.006**2
    matrix[k + 1, k + 1] = 0.003**2
    profile = air_of(np.zeros(size))
    return TimedProfile(None, profile, ProfileCovariance(profile, 0.0, matrix))


@dataclass(frozen=True)
class MediumOfProfile:
    """A profile for the simulator's rays."""

    profile: Profile

    def n(self, h_m):
        return 1.0 + self.profile.refractivity(h_m)

    def dn_dh(self, h_m):
        above = self.profile.refractivity(h_m + 2.0)
        below = self.profile.refractivity(h_m - 2.0)
        return (above - below) / 4.0


@dataclass(frozen=True)
class Block:
    """True centres (i, 3), rotations (i, 3, 3) and points (p, 3), east, north, up [m]; who sees."""

    centre: Array
    turn: Array
    point: Array
    image: NDArray[np.int64]
    seen: NDArray[np.int64]


def sides(
    away,
    east_or_west,
    north_or_south,
    inwards,
):
    """Pairs of a place and an aim: so far from the middle, along two sides and two others."""
    pairs = []
    for side in (-away, away):
        pairs += [[(side, along), (0.0, inwards * along)] for along in east_or_west]
    for side in (-away, away):
        pairs += [[(along, side), (inwards * along, 0.0)] for along in north_or_south]
    return pairs


def block_of(kind, rng):
    """24 images over 100 points: two strips from either side at 75 degrees, a nadir block, or heads
    at 45 degrees from four sides."""
    if kind == "75":
        span = 9000.0
        along = np.linspace(-8000.0, 8000.0, 8)
        pairs = sides(22_400.0, along, along[::2], inwards=0.6)
    elif kind == "nadir":
        span = 3000.0
        grid = np.linspace(-2500.0, 2500.0, 6)
        below = [(e, n) for e in grid[[0, 2, 3, 5]] for n in grid]
        pairs = [[place, place] for place in below]
    else:
        span = 2500.0
        along = np.linspace(-3000.0, 3000.0, 6)
        pairs = sides(6000.0, along, along, inwards=0.5)
    place, aim = np.swapaxes(pairs, 0, 1)
    centre = np.insert(place, 2, FLYING, axis=1)
    z = unit(
        np.insert(
            aim,
            2,
            300.0,
            axis=1,
        )
        - centre
    )
    x = unit(np.cross(z, NORTH if kind == "nadir" else UP))
    turn = np.stack([x, np.cross(z, x), z], axis=1)

    plane = rng.uniform(-span, span, (100, 2))
    point = np.column_stack([plane, rng.uniform(150.0, 450.0, 100)])
    rays = []
    for i in range(len(centre)):
        ray = (point - centre[i]) @ turn[i].T
        pixel = F * ray[:, :2] / ray[:, 2:]
        inside = np.all(np.abs(pixel) < PRINCIPAL - 200, axis=1)
        seen = np.flatnonzero(inside & (ray[:, 2] > 0))
        drawn = rng.permutation(seen)[:70]
        rays += [(i, p) for p in drawn]
    image, seen = np.array(rays).T
    return Block(centre, turn, point, image, seen)


def measured(
    block,
    sigmas,
    noise_px,
    rng,
):
    """Corrected in the expected air, seen in one that many sigmas along the mode; sigma of s."""
    air = expected_air()
    i = block.image
    p = block.seen
    ecef = block.centre @ AXES + ORIGIN
    ground = block.point @ AXES + ORIGIN
    h_ellipsoid, up = height_and_up(ecef)
    h_msl = h_ellipsoid - UNDULATION
    h_g = height_and_up(ground)[0][p] - UNDULATION
    chord = unit(ground[p] - ecef[i])
    zeta = np.arccos(-np.einsum("ij,ij->i", chord, up[i]))
    no_window = np.zeros(i.size)
    rays = WindowRays(
        h_msl[i],
        zeta,
        np.zeros(i.size, np.int64),
        no_window,
        no_window,
    )
    assert air.covariance is not None
    mode = leading_mode(air.profile, air.covariance, rays, h_g)
    assert mode is not None
    true = MediumOfProfile(air_of(sigmas * mode.state))
    apparent = (
        shoot(
            true,
            ecef[i],
            ground[p],
            UNDULATION,
        ).apparent
        @ AXES.T
    )
    ray = np.einsum("nij,nj->ni", block.turn[i], apparent)
    pixel = F * ray[:, :2] / ray[:, 2:] + PRINCIPAL
    pixel += noise_px * rng.standard_normal(pixel.shape)

    lat = np.arcsin(up[:, 2])
    lon = np.arctan2(up[:, 1], up[:, 0])
    of_enu = block.turn @ AXES @ np.swapaxes(enu_axes(lat, lon), 1, 2)
    quaternion = Rotation.from_matrix(of_enu).as_quat()
    stations = pd.DataFrame(quaternion, columns=["q_x", "q_y", "q_z", "q_w"])
    names = np.array([f"image{k}" for k in range(len(ecef))])
    stations["image"] = names
    stations["lat_deg"] = np.degrees(lat)
    stations["lon_deg"] = np.degrees(lon)
    stations["h_msl_m"] = h_msl
    rows = pd.DataFrame(pixel, columns=["x_px", "y_px"])
    rows["image"] = names[i]
    rows["point"] = [f"point{k}" for k in p]
    rows["h_g_m"] = h_g
    rows["image_row"] = i
    rows["point_row"] = p
    cx_px, cy_px = PRINCIPAL.tolist()
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "f_px": F,
        "cx_px": cx_px,
        "cy_px": cy_px,
        "calibration": "laboratory",
    }

    corrected = correct(
        rows,
        stations,
        air,
        {"camera": camera},
        mission={"undulation_m": UNDULATION},
    )

    inside = corrected["status"] == "ok"
    assert inside.mean() > 0.98  # the others were displaced out of the image
    scale_sigma = corrected.attrs["uncertainty"]["scale_sigma"]
    return corrected[inside].copy(), scale_sigma


@dataclass(frozen=True)
class Adjusted:
    """The scale parameter and its sigma, as the recipe finds them, and as it was drawn."""

    s: float
    sigma: float
    prior: float
    true: float


def adjusted(
    kind,
    sigmas=0.0,
    noise_px=0.0,
    seed=0,
    sign=1.0,
    **more,
):
    """A block in air that many sigmas along the mode, with derivatives of this sign."""
    rng = np.random.default_rng(seed)
    block = block_of(kind, rng)
    rows, prior = measured(block, sigmas, noise_px, rng)
    rows[["dx_ds_px", "dy_ds_px"]] *= sign
    # Nine control points, spread over the block.
    grid = np.linspace(-0.6, 0.6, 3) * block.point.max()
    places = [(e, n) for e in grid for n in grid]
    gaps = np.linalg.norm(block.point[:, None, :2] - places, axis=2)
    nearest = gaps.argmin(axis=0)
    is_control = np.isin(np.arange(len(block.point)), nearest)
    off = rng.standard_normal(block.point.shape)
    off[is_control] = 0.0
    gnss = (noise_px > 0) * GNSS * rng.standard_normal(block.centre.shape)
    tilt = Rotation.from_rotvec(1e-4 * rng.standard_normal(block.centre.shape))

    s, sigma, _ = recipe()(
        rows,
        tilt.as_matrix() @ block.turn,
        block.centre + gnss,
        block.point + off,
        is_control,
        camera=(F, *PRINCIPAL),
        prior=prior,
        **more,
    )
    return Adjusted(s, sigma, prior, sigmas * prior)


@pytest.mark.parametrize("sigmas", [1.0, -0.7])
def test_an_oblique_block_finds_the_air(sigmas):
    """75 degrees, control and GNSS, no noise: within 2 % of the air that was drawn."""
    solution = adjusted("75", sigmas, sigma_px=0.05)
    assert 0.02 < solution.prior < 0.06
    assert solution.sigma < 0.1 * solution.prior
    assert solution.s == pytest.approx(solution.true, rel=0.02)


def test_the_other_sign_is_seen():
    solution = adjusted("75", 1.0, sigma_px=0.05, sign=-1.0)
    assert solution.s < -0.9 * solution.true


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_with_noise_within_three_sigma(seed):
    solution = adjusted("75", 1.0, noise_px=0.3, seed=seed)
    assert solution.sigma < 0.3 * solution.prior
    assert abs(solution.s - solution.true) <= 3.0 * solution.sigma


@pytest.mark.parametrize(
    ("kind", "free", "least", "most"),
    [
        ("75", False, 0.0, 1 / 3),
        ("75", True, 0.0, 1 / 3),
        ("45", True, 0.5, 1.01),
        ("nadir", False, 0.5, 1.01),
        ("nadir", True, 0.5, 1.01),
    ],
)
def test_where_it_can_be_told(kind, free, least, most):
    """Below a third of its prior at 75 degrees, above half elsewhere; as the page says."""
    interior = "free" if free else "fixed"
    (shown,) = re.findall(rf"\| {kind}[^|]*\| {interior} \| ([0-9.]+) \|", PAGE)

    solution = adjusted(kind, free=free)

    share = solution.sigma / solution.prior
    assert share == pytest.approx(float(shown), abs=0.02)
    assert least < share < most
