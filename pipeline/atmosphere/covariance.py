"""The covariance of an estimated profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.profile import Profile

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ProfileCovariance:
    """One-sigma and correlation of a profile.

    Parameters
    ----------
    profile : the profile, with k edges of layers.
    anchor_m : geopotential height [m'] at which ln p is a state of its own.
    matrix : (2k + 1, 2k + 1) covariance of T_M at the edges [K], ln p at the anchor, and e/p at
        the edges, in this order. For any quantity with gradient g by them, sigma^2 = g^T C g.
    """

    profile: Profile
    anchor_m: float
    matrix: Array

    def __post_init__(self) -> None:
        size = 2 * self.profile.layers.edge.size + 1
        if self.matrix.shape != (size, size):
            raise ValueError("the covariance does not fit the layers of the profile")

    @property
    def anchor_height_m(self) -> float:
        """The anchor's height above sea level [m]."""
        return float(self.profile.gravity.height(self.anchor_m))
