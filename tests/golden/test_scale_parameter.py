"""The recipe of docs/scale_parameter.md: where an adjustment finds the air, and where it cannot.

The truth is the simulator's: rays by its ODE on the ellipsoid, through air that differs from the
profile of the corrections along the leading mode of that profile's covariance.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend import correct, standard_atmosphere
from unbend.atmosphere import Profile
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.refraction import AirMode, WindowRays, leading_mode
from unbend.simulate.optics import enu_axes, height_and_up, shoot, to_ecef

from .conftest import REPOSITORY

Array = NDArray[np.float64]

PAGE = (REPOSITORY / "docs" / "scale_parameter.md").read_text(encoding="utf-8")
(RECIPE,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)

LAT = np.radians(47.45)
LON = np.radians(8.68)
UNDULATION = 47.6
F = 20_000.0
WIDTH = 14_000
HEIGHT = 10_600
FLYING = 6300.0
GNSS = np.array([0.03, 0.03, 0.05])
EDGES = np.array([-600.0, 11_000.0, 20_000.0, 32_000.0])
TEMPERATURE = np.array([292.05, 216.65, 216.65, 228.65])
VAPOUR = np.array([0.011, 0.0, 0.0, 0.0])
ORIGIN = to_ecef(np.array(LAT), np.array(LON), np.array(UNDULATION))
AXES = enu_axes(np.array(LAT), np.array(LON))


def adjust(*given: Any, **more: Any) -> tuple[float, float, Array]:
    names: dict[str, Any] = {}
    exec(compile(RECIPE, "docs/scale_parameter.md", "exec"), names)
    solution: tuple[float, float, Array] = names["adjust"](*given, **more)
    return solution


def air_of(state: Array) -> Profile:
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


def expected_air() -> TimedProfile:
    """Air of which nothing was measured: 6 K, 0.6 % of pressure, a quarter of the vapour."""
    k = EDGES.size
    matrix = np.zeros((2 * k + 1, 2 * k + 1))
    matrix[:k, :k] = 36.0 * np.exp(-np.abs(EDGES[:, None] - EDGES) / 8000.0)
    matrix[k, k], matrix[k + 1, k + 1] = 0.006**2, 0.003**2
    profile = air_of(np.zeros(2 * k + 1))
    return TimedProfile(None, profile, ProfileCovariance(profile, 0.0, matrix))


@dataclass(frozen=True)
class MediumOfProfile:
    """A profile for the simulator's rays."""

    profile: Profile

    def n(self, h_m: Array) -> Array:
        return 1.0 + self.profile.refractivity(h_m)

    def dn_dh(self, h_m: Array) -> Array:
        return (self.profile.refractivity(h_m + 2.0) - self.profile.refractivity(h_m - 2.0)) / 4.0


@dataclass(frozen=True)
class Block:
    """True centres (i, 3), rotations (i, 3, 3) and points (p, 3), east, north, up [m]; who sees."""

    centre: Array
    turn: Array
    point: Array
    image: NDArray[np.int64]
    seen: NDArray[np.int64]


def block_of(kind: str, rng: np.random.Generator) -> Block:
    """24 images over 100 points: two strips from either side at 75 degrees, a nadir block, or heads
    at 45 degrees from four sides."""
    along = np.linspace(-8000.0, 8000.0, 8)
    span = 9000.0
    if kind == "75":
        place = [(e, n) for e in (-22_400.0, 22_400.0) for n in along]
        place += [(e, n) for n in (-22_400.0, 22_400.0) for e in along[::2]]
        aim = [(0.0, 0.6 * n) if abs(e) > 2e4 else (0.6 * e, 0.0) for e, n in place]
    elif kind == "nadir":
        span = 3000.0
        grid = np.linspace(-2500.0, 2500.0, 6)
        place = aim = [(e, n) for e in grid[[0, 2, 3, 5]] for n in grid]
    else:
        span = 2500.0
        along = np.linspace(-3000.0, 3000.0, 6)
        place = [(side, a) for side in (-6e3, 6e3) for a in along]
        place += [(a, side) for side in (-6e3, 6e3) for a in along]
        aim = [(0.0, 0.5 * n) if abs(e) == 6e3 else (0.5 * e, 0.0) for e, n in place]
    centre = np.column_stack([place, np.full(len(place), FLYING)])
    turns = []
    for c, t in zip(centre, aim, strict=True):
        z = np.array([*t, 300.0]) - c
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 1.0, 0.0] if kind == "nadir" else [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        turns.append(np.stack([x, np.cross(z, x), z]))
    point = np.column_stack([rng.uniform(-span, span, (100, 2)), rng.uniform(150.0, 450.0, 100)])
    turn = np.array(turns)
    pairs = []
    for i in range(len(centre)):
        ray = (point - centre[i]) @ turn[i].T
        x, y = (F * ray[:, :2] / ray[:, 2:]).T
        inside = (ray[:, 2] > 0) & (np.abs(x) < WIDTH / 2 - 200) & (np.abs(y) < HEIGHT / 2 - 200)
        drawn = rng.permutation(np.flatnonzero(inside))[:70]
        pairs += [(i, p) for p in drawn]
    image, seen = np.array(pairs).T
    return Block(centre, turn, point, image, seen)


def measured(
    block: Block, sigmas: float, noise_px: float, rng: np.random.Generator
) -> tuple[pd.DataFrame, float, AirMode]:
    """Corrected in the expected air, seen in one that many sigmas along the mode; the true s."""
    air = expected_air()
    i = block.image
    p = block.seen
    ecef = block.centre @ AXES + ORIGIN
    ground = block.point @ AXES + ORIGIN
    (h, up), (h_g, _) = height_and_up(ecef), height_and_up(ground)
    chord = ground[p] - ecef[i]
    zeta = np.arccos(-np.einsum("ij,ij->i", chord, up[i]) / np.linalg.norm(chord, axis=1))
    none = np.zeros(i.size)
    rays = WindowRays(h[i] - UNDULATION, zeta, np.zeros(i.size, np.int64), none, none)
    assert air.covariance is not None
    mode = leading_mode(air.profile, air.covariance, rays, h_g[p] - UNDULATION)
    assert mode is not None
    true = MediumOfProfile(air_of(sigmas * mode.state))
    apparent = shoot(true, ecef[i], ground[p], UNDULATION).apparent @ AXES.T
    ray = np.einsum("nij,nj->ni", block.turn[i], apparent)
    pixel = F * ray[:, :2] / ray[:, 2:] + [WIDTH / 2, HEIGHT / 2]
    pixel += noise_px * rng.standard_normal(pixel.shape)
    lat = np.arcsin(up[:, 2])
    lon = np.arctan2(up[:, 1], up[:, 0])
    of_enu = block.turn @ AXES @ np.swapaxes(enu_axes(lat, lon), 1, 2)
    x, y, z, w = Rotation.from_matrix(of_enu).as_quat().T
    names = np.array([f"image{k}" for k in range(len(ecef))])
    stations = pd.DataFrame(
        {
            "image": names,
            "lat_deg": np.degrees(lat),
            "lon_deg": np.degrees(lon),
            "h_msl_m": h - UNDULATION,
            "q_w": w,
            "q_x": x,
            "q_y": y,
            "q_z": z,
        }
    )
    rows = pd.DataFrame(
        {
            "image": names[i],
            "point": [f"point{k}" for k in p],
            "x_px": pixel[:, 0],
            "y_px": pixel[:, 1],
            "h_g_m": h_g[p] - UNDULATION,
            "image_row": i,
            "point_row": p,
        }
    )
    camera = {
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "f_px": F,
        "cx_px": WIDTH / 2,
        "cy_px": HEIGHT / 2,
        "calibration": "laboratory",
    }
    corrected = correct(
        rows, stations, air, {"camera": camera}, mission={"undulation_m": UNDULATION}
    )
    inside = corrected["status"] == "ok"
    assert inside.mean() > 0.98  # the others were displaced out of the image
    return corrected[inside], corrected.attrs["uncertainty"]["scale_sigma"], mode


def adjusted(
    kind: str,
    sigmas: float = 0.0,
    noise_px: float = 0.0,
    seed: int = 0,
    change: Callable[[pd.DataFrame], pd.DataFrame] = lambda rows: rows,
    **more: Any,
) -> tuple[float, float, float]:
    """s over its truth (the prior where that is zero), sigma over the prior, and the prior."""
    rng = np.random.default_rng(seed)
    block = block_of(kind, rng)
    rows, prior, _ = measured(block, sigmas, noise_px, rng)
    # Nine control points, spread over the block.
    place = [[e, n] for e in (-1, 0, 1) for n in (-1, 0, 1)] * np.array(0.6 * block.point.max())
    near = np.linalg.norm(block.point[:, None, :2] - place, axis=2).argmin(axis=0)
    held = np.isin(np.arange(len(block.point)), near)
    start = block.point + np.where(held[:, None], 0.0, rng.standard_normal(block.point.shape))
    centre = block.centre + (noise_px > 0) * GNSS * rng.standard_normal(block.centre.shape)
    tilted = Rotation.from_rotvec(1e-4 * rng.standard_normal(block.centre.shape)).as_matrix()
    s, sigma, _ = adjust(
        change(rows),
        tilted @ block.turn,
        centre,
        start,
        held,
        camera=(F, WIDTH / 2, HEIGHT / 2),
        prior=prior,
        **more,
    )
    return s / (sigmas * prior or prior), sigma / prior, prior


def wrong_sign(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(dx_ds_px=-rows["dx_ds_px"], dy_ds_px=-rows["dy_ds_px"])


@pytest.mark.parametrize("sigmas", [1.0, -0.7])
def test_an_oblique_block_finds_the_air(sigmas):
    """75 degrees, control and GNSS, no noise: within 2 % of the air that was drawn."""
    share, sigma, prior = adjusted("75", sigmas, sigma_px=0.05)
    assert 0.02 < prior < 0.06
    assert sigma < 0.1
    assert abs(share - 1.0) <= 0.02


def test_the_other_sign_is_seen():
    assert adjusted("75", 1.0, sigma_px=0.05, change=wrong_sign)[0] < -0.9


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_with_noise_within_three_sigma(seed):
    share, sigma, _ = adjusted("75", 1.0, noise_px=0.3, seed=seed)
    assert sigma < 0.3
    assert abs(share - 1.0) <= 3.0 * sigma


@pytest.mark.parametrize(
    ("kind", "free", "is_known"),
    [
        ("75", False, True),
        ("75", True, True),
        ("45", True, False),
        ("nadir", False, False),
        ("nadir", True, False),
    ],
)
def test_where_it_can_be_told(kind, free, is_known, capsys):
    """Below a third of its prior at 75 degrees, above half elsewhere; as the page says."""
    _, sigma, prior = adjusted(kind, free=free)
    (shown,) = re.findall(rf"\| {kind}[^|]*\| {'free' if free else 'fixed'} \| ([0-9.]+) \|", PAGE)
    with capsys.disabled():
        print(f"\nsigma of s over its prior of {prior:.4f}: {kind}, free {free}: {sigma:.2f}")
    assert abs(sigma - float(shown)) <= 0.02
    assert sigma < 1 / 3 if is_known else sigma > 0.5
