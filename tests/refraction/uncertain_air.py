"""Air with a covariance for tests: an inversion, knots of 50 m to 1 km that hardly agree."""

from __future__ import annotations

from functools import lru_cache

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
    height = np.minimum(EDGES, 11_000.0)
    return (
        288.15
        - 0.0065 * height
        + 8.0
        * np.clip((height - 1000.0) / 400.0, 0.0, 1.0)
        * (np.exp(-np.maximum(height - 1400.0, 0.0) / 2000.0))
    )


def vapour() -> np.ndarray:
    """e/p at the edges."""
    return 0.012 * np.exp(-np.maximum(EDGES, 0.0) / 2200.0)


def covariance_matrix() -> np.ndarray:
    """Of T_M, ln p at 1000 m' and e/p: temperatures fine and broad, humidity uncertain by half."""
    apart = np.abs(EDGES[:, None] - EDGES[None, :])
    # 0.3 K below 3 km, where a climb was sampled, 3 K above 5 km.
    fine = 0.3 + 2.7 * np.clip((EDGES - 3000.0) / 2000.0, 0.0, 1.0)
    t = np.outer(fine, fine) * np.exp(-apart / 300.0) + 0.25 * np.exp(-apart / 5000.0)
    e = np.outer(vapour(), vapour()) * 0.09 * np.exp(-apart / 1500.0)
    size = EDGES.size
    matrix = np.zeros((2 * size + 1, 2 * size + 1))
    matrix[:size, :size], matrix[size, size] = t, LN_P_SIGMA**2
    matrix[size + 1 :, size + 1 :] = e
    return matrix


def profile_of(t_m: np.ndarray, ln_p: float, e: np.ndarray) -> Profile:
    layers = stack_layers(
        EDGES,
        t_m,
        e,
        ("measured",) * (EDGES.size - 1),
        anchor=(ANCHOR_M, ANCHOR_PA * float(np.exp(ln_p))),
    )
    constant = standard_atmosphere("us1976", latitude=0.8).constant
    return Profile(layers, lambert_gravity(0.8), IndexModel("ciddor"), "adjusted", constant)


def air() -> tuple[Profile, ProfileCovariance]:
    profile = profile_of(temperatures(), 0.0, vapour())
    return profile, ProfileCovariance(profile, ANCHOR_M, covariance_matrix())


@lru_cache(maxsize=1)
def root() -> np.ndarray:
    """L with L L^T the covariance, to 1e-10 of the variances."""
    matrix = covariance_matrix()
    scale = np.sqrt(np.diag(matrix))
    size = np.eye(scale.size)
    return scale[:, None] * np.linalg.cholesky(matrix / np.outer(scale, scale) + 1e-10 * size)


def drawn(rng: np.random.Generator) -> Profile:
    """The same air as it might be too."""
    x = root() @ rng.normal(size=2 * EDGES.size + 1)
    size = EDGES.size
    return profile_of(temperatures() + x[:size], float(x[size]), vapour() + x[size + 1 :])
