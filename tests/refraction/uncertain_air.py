"""Air with a covariance for tests: an inversion, knots of 50 m to 1 km that hardly agree."""

from __future__ import annotations

from functools import cache

import numpy as np

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.geodesy import lambert_gravity

EDGES = np.concatenate(
    [np.arange(-600.0, 3600.0, 50.0), np.arange(3600.0, 12_001.0, 600.0), [20e3, 32e3]]
)
ANCHOR_M = 1000.0
ANCHOR_PA = 90_000.0
LN_P_SIGMA = 0.001


def temperatures() -> np.ndarray:
    """T_M at the edges: US 1976 with 8 K more from 1000 to 1400 m'."""
    standard = 288.15 - 0.0065 * np.minimum(EDGES, 11_000.0)
    inversion = 8.0 * np.clip((EDGES - 1000.0) / 400.0, 0.0, 1.0)
    return standard + inversion * np.exp(-np.maximum(EDGES - 1400.0, 0.0) / 2000.0)


def vapour() -> np.ndarray:
    """e/p at the edges."""
    return 0.012 * np.exp(-np.maximum(EDGES, 0.0) / 2200.0)


def covariance_matrix() -> np.ndarray:
    """Of T_M, ln p at 1000 m' and e/p: temperatures fine and broad, humidity uncertain by half."""
    apart = np.abs(EDGES[:, None] - EDGES[None, :])
    # 0.3 K below 3 km, where a climb was sampled, 3 K above 5 km.
    fine = 0.3 + 2.7 * np.clip((EDGES - 3000.0) / 2000.0, 0.0, 1.0)
    size = EDGES.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[:size, :size] = np.outer(fine, fine) * np.exp(-apart / 300.0)
    matrix[:size, :size] += 0.25 * np.exp(-apart / 5000.0)
    matrix[size, size] = LN_P_SIGMA**2
    matrix[size + 1 :, size + 1 :] = np.outer(vapour(), vapour()) * 0.09 * np.exp(-apart / 1500.0)
    return matrix


def changed(state: np.ndarray) -> Profile:
    """The air with something added to T_M, ln p at 1000 m' and e/p."""
    size = EDGES.size
    layers = stack_layers(
        EDGES,
        temperatures() + state[:size],
        vapour() + state[size + 1 :],
        ("measured",) * (size - 1),
        anchor=(ANCHOR_M, ANCHOR_PA * float(np.exp(state[size]))),
    )
    constant = standard_atmosphere("us1976", latitude=0.8).constant
    return Profile(layers, lambert_gravity(0.8), IndexModel("ciddor"), "adjusted", constant)


def air() -> tuple[Profile, ProfileCovariance]:
    profile = changed(np.zeros(2 * EDGES.size + 1))
    return profile, ProfileCovariance(profile, ANCHOR_M, covariance_matrix())


@cache
def root() -> np.ndarray:
    """L with L L^T the covariance, to 1e-10 of the variances."""
    matrix = covariance_matrix()
    scale = np.sqrt(np.diag(matrix))
    correlation = matrix / np.outer(scale, scale)
    return scale[:, None] * np.linalg.cholesky(correlation + 1e-10 * np.eye(scale.size))


def drawn(rng: np.random.Generator) -> Profile:
    """The same air as it might be too."""
    return changed(root() @ rng.normal(size=2 * EDGES.size + 1))
