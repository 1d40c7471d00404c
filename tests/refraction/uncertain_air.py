"""Air with a covariance for tests: an inversion, knots of 50 m to 1 km that hardly agree."""

from functools import cache

import numpy as np
from scipy.linalg import block_diag

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.geodesy import lambert_gravity
from unbend.refraction import ray_table

FINE_EDGES = np.arange(-600.0, 3600.0, 50.0)
COARSE_EDGES = np.arange(3600.0, 12_001.0, 600.0)
EDGES = np.concatenate([FINE_EDGES, COARSE_EDGES, [20e3, 32e3]])
SIZE = EDGES.size
STATES = 2 * SIZE + 1  # T_M at the edges, ln p at the anchor, e/p at the edges
ANCHOR_M = 1000.0
ANCHOR_PA = 90_000.0
LN_P_SIGMA = 0.001


# T_M at the edges: US 1976 with 8 K more from 1000 to 1400 m'.
STANDARD = 288.15 - 0.0065 * np.minimum(EDGES, 11_000.0)
INVERSION = 8.0 * np.clip((EDGES - 1000.0) / 400.0, 0.0, 1.0)
TEMPERATURES = STANDARD + INVERSION * np.exp(-np.maximum(EDGES - 1400.0, 0.0) / 2000.0)
VAPOUR = 0.012 * np.exp(-np.maximum(EDGES, 0.0) / 2200.0)  # e/p at the edges


def covariance_matrix():
    """Of T_M, ln p at 1000 m' and e/p: temperatures fine and broad, humidity uncertain by half."""
    apart = np.abs(EDGES[:, None] - EDGES[None, :])
    # 0.3 K below 3 km, where a climb was sampled, 3 K above 5 km.
    fine = 0.3 + 2.7 * np.clip((EDGES - 3000.0) / 2000.0, 0.0, 1.0)
    of_temperature = np.outer(fine, fine) * np.exp(-apart / 300.0)
    of_temperature += 0.25 * np.exp(-apart / 5000.0)
    humid = 0.3 * VAPOUR
    of_vapour = np.outer(humid, humid)
    of_vapour *= np.exp(-apart / 1500.0)
    return block_diag(of_temperature, LN_P_SIGMA**2, of_vapour)


def changed(state):
    """The air with something added to T_M, ln p at 1000 m' and e/p."""
    pressure_pa = ANCHOR_PA * float(np.exp(state[SIZE]))
    layers = stack_layers(
        EDGES,
        TEMPERATURES + state[:SIZE],
        VAPOUR + state[SIZE + 1 :],
        ("measured",) * (SIZE - 1),
        anchor=(ANCHOR_M, pressure_pa),
    )
    constant = standard_atmosphere("us1976", latitude=0.8).constant
    return Profile(
        layers,
        lambert_gravity(0.8),
        IndexModel("ciddor"),
        "adjusted",
        constant,
    )


AIR = changed(np.zeros(STATES))
COVARIANCE = ProfileCovariance(AIR, ANCHOR_M, covariance_matrix())
TABLE = ray_table(AIR)


@cache
def root():
    """L with L L^T the covariance, to 1e-10 of the variances."""
    matrix = covariance_matrix()
    scale = np.sqrt(np.diag(matrix))
    correlation = matrix / np.outer(scale, scale)
    factor = np.linalg.cholesky(correlation + 1e-10 * np.eye(STATES))
    return scale[:, None] * factor
