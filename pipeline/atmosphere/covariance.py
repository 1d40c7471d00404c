"""The covariance of an estimated profile, and what follows from it for temperature, N and R."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.atmosphere.hypsometry import hats
from pipeline.atmosphere.jacobian import log_pressure_jacobian
from pipeline.atmosphere.profile import Profile
from pipeline.units import VAPOUR_DEFICIT

Array = NDArray[np.float64]

_RAY_STEPS = 200  # trapezia of the plane integral: 1e-5 of R over 10 km


def plane_rule(h_c: float, h_g: float, steps: int) -> tuple[Array, Array]:
    """Heights [m], and the weights of N there whose sum is R/tan zeta in the plane.

    Mean of N over the way - N_c (Gyer 1996, Eq. 24), by ``steps`` trapezia from the ground at
    ``h_g`` to a camera at ``h_c`` [m above sea level].
    """
    h = np.linspace(h_g, h_c, steps + 1)
    weight = np.full(h.size, 1.0 / steps)
    weight[[0, -1]] *= 0.5
    weight[-1] -= 1.0
    return h, weight


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

    def sigma_temperature(self, h: ArrayLike) -> Array:
        """One sigma of temperature [K] at heights ``h`` (n,) [m above sea level]."""
        height = np.atleast_1d(np.asarray(h, np.float64))
        weights = self._weights(height)
        t_m, _, vapour = self.profile.state(height)
        zero = np.zeros((height.size, 1))
        return self._sigma(
            [
                (1.0 - VAPOUR_DEFICIT * vapour)[:, None] * weights,
                zero,
                (-VAPOUR_DEFICIT * t_m)[:, None] * weights,
            ]
        )

    def sigma_log_pressure(self, h: ArrayLike) -> Array:
        """One sigma of ln p, that is sigma_p/p, at heights ``h`` (n,) [m above sea level]."""
        height = np.atleast_1d(np.asarray(h, np.float64))
        by_virtual = self.log_pressure_by_virtual(height)
        return self._sigma(
            [by_virtual, np.ones((height.size, 1)), np.zeros((height.size, by_virtual.shape[1]))]
        )

    def sigma_vapour_pressure(self, h: ArrayLike) -> Array:
        """One sigma of vapour pressure [Pa] at heights ``h`` (n,) [m above sea level]."""
        height = np.atleast_1d(np.asarray(h, np.float64))
        _, p, vapour = self.profile.state(height)
        e = (vapour * p)[:, None]
        by_vapour = p[:, None] * self._weights(height)
        return self._sigma([e * self.log_pressure_by_virtual(height), e, by_vapour])

    def sigma_refractivity(self, h: ArrayLike) -> Array:
        """One sigma of n - 1 at heights ``h`` (n,) [m above sea level]."""
        gradient = self.refractivity_gradient(np.atleast_1d(np.asarray(h, np.float64)))
        return self.sigma_of(gradient)

    def refractivity_gradient(self, h: Array) -> Array:
        """(n, 2k + 1) derivatives of n - 1 at heights (n,) [m] by the quantities of ``matrix``.

        The index formula is differenced centrally (1e-7 of the derivative); hydrostatics carry
        pressure with temperature in closed form.
        """
        t_m, p, vapour = self.profile.state(h)
        weights = self._weights(h)
        by_virtual = (self._index(t_m + 0.1, p, vapour) - self._index(t_m - 0.1, p, vapour)) / 0.2
        up, down = p * (1.0 + 1e-3), p * (1.0 - 1e-3)
        by_level = (self._index(t_m, up, vapour) - self._index(t_m, down, vapour)) / 2e-3
        step = 1e-4
        by_vapour = self._index(t_m, p, vapour + step) - self._index(t_m, p, vapour - step)
        by_vapour = by_vapour / (2.0 * step)
        carried = by_level[:, None] * self.log_pressure_by_virtual(h)
        return np.concatenate(
            [
                by_virtual[:, None] * weights + carried,
                by_level[:, None],
                by_vapour[:, None] * weights,
            ],
            axis=1,
        )

    def relative_sigma(self, h_c: float, h_g: float) -> float:
        """sigma_R/R of rays from a camera at ``h_c`` to the ground at ``h_g`` [m], to first order.

        In the plane, see `plane_rule`; the ratio differs from the spherical one by less than 1 %
        of itself below 75 degrees. This is the sigma of the one scale factor of R that a whole
        flight shares.
        """
        h, weight = plane_rule(h_c, h_g, _RAY_STEPS)
        r = float(weight @ self.profile.refractivity(h))
        gradient = weight @ self.refractivity_gradient(h)
        return float(np.sqrt(gradient @ self.matrix @ gradient)) / abs(r)

    def _weights(self, h: Array) -> Array:
        edge = self.profile.layers.edge
        return hats(edge, self.profile.gravity.geopotential_height(h))

    def _index(self, t_m: Array, p: Array, vapour: Array) -> Array:
        return self.profile.index.refractivity(t_m * (1.0 - VAPOUR_DEFICIT * vapour), p, vapour * p)

    def log_pressure_by_virtual(self, h: Array) -> Array:
        """(n, k) derivatives of ln p at heights (n,) [m] by T_M at the edges [1/K]."""
        return log_pressure_jacobian(self.profile, h, self.anchor_height_m)

    def _sigma(self, blocks: list[Array]) -> Array:
        return self.sigma_of(np.concatenate(blocks, axis=1))

    def sigma_of(self, gradient: Array) -> Array:
        """One sigma of quantities whose derivatives (n, 2k + 1) are in the order of ``matrix``."""
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", gradient @ self.matrix, gradient)))
