"""Derivatives of a profile's air, and the covariance of an estimated profile.

T_M and e/p are continuous, and linear between the edges of layers (`layers.stack_layers`). With
phi_k the hat function of edge k, T_M(H) = sum of phi_k T_k and ln p(H) = ln p(anchor) -
(G M0 / R*) * integral of dH / T_M, so that d ln p(H) / d T_k = (G M0 / R*) * integral from the
anchor to H of phi_k / T_M^2 dH (`hypsometry.inverse_temperature_integral`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere import messages
from unbend.atmosphere.hypsometry import interpolation_weights, inverse_temperature_integral
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.units import VAPOUR_DEFICIT, Array

RAY_STEPS = 200  # trapezia of the plane integral: 1e-5 of R over 10 km

# Central differences of eighth order of the index formula itself, so that a new one is still one
# function. Its poles in T, p and e/p are far away: with long steps derivatives keep 13 digits.
_STENCIL = np.array(
    [
        4.0 / 5.0,
        -1.0 / 5.0,
        4.0 / 105.0,
        -1.0 / 280.0,
    ]
)
_TEMPERATURE_STEP = 0.007  # relative, of T
_PRESSURE_STEP = 0.05  # relative, of p
_VAPOUR_STEP = 0.05  # absolute, in e/p


def air_jacobian(
    profile: Profile,
    h: ArrayLike,
    anchor_height_m: float,
) -> Array:
    """Derivatives of N = n - 1 at heights by the parameters of a profile of m layers.

    ``h``: (n,) heights [m above sea level]; rows of heights outside the profile are NaN.
    ``anchor_height_m``: where pressure stays when temperatures change [m above sea level].

    Returns (n, 2m + 3), in the order of `ProfileCovariance.matrix`: by T_M at the m + 1 edges of
    the layers [1/K], with constant e/p, and pressure changed by hydrostatics from the anchor; by
    ln p at the anchor; and by e/p at the edges, with constant T_M (so pressure stays).

    A thermometer measures T = T_M (1 - 0.378 e/p). With x_k for e/p at edge k, the derivative with
    respect to T_k at fixed x_k is that for T_M,k divided by (1 - 0.378 x_k); the one with respect
    to x_k at fixed T_k is that for x_k + that for T_M,k * 0.378 T_M,k / (1 - 0.378 x_k).

    Raises `PhysicsError` for an anchor outside the profile. Against 30-digit arithmetic 3e-13 of
    the largest derivative.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = air_jacobian(standard_atmosphere("us1976"), [0.0, 8000.0], 0.0)
    >>> (air[:, :3] * 1e9).round(2).tolist()
    [[0.0, -967.15, 0.0], [0.0, 154.8, -182.09]]
    """
    h = np.asarray(h, dtype=np.float64)
    t_m, p, vapour = profile.state(h)
    dryness = 1.0 - VAPOUR_DEFICIT * vapour
    partials = _index_partials(profile.index, t_m * dryness, p, vapour)
    by_t, by_log_p, by_fraction = partials
    weights = interpolation_weights(profile.layers.edge, profile.gravity.geopotential_height(h))
    log_pressure = log_pressure_jacobian(profile, h, anchor_height_m)
    through_pressure = by_log_p[:, None] * log_pressure
    by_virtual = through_pressure + (by_t * dryness)[:, None] * weights
    at_fixed_virtual = by_fraction - VAPOUR_DEFICIT * t_m * by_t
    blocks = [
        by_virtual,
        by_log_p,
        at_fixed_virtual[:, None] * weights,
    ]
    return np.column_stack(blocks)


def log_pressure_jacobian(
    profile: Profile,
    h: ArrayLike,
    anchor_height_m: float,
) -> Array:
    """Derivatives (n, m + 1) of ln p at heights by T_M at the m + 1 edges [1/K].

    Arguments and rows of NaN as in `air_jacobian`.

    A degree more over the lowest 11 km raises the pressure above them by 0.6 %:

    >>> from unbend.atmosphere import standard_atmosphere
    >>> rows = log_pressure_jacobian(standard_atmosphere("us1976"), [11000.0], 0.0)
    >>> rows.sum(axis=1).round(5).tolist()
    [0.00601]
    """
    h = np.asarray(h, dtype=np.float64)
    if not profile.bottom_m <= anchor_height_m <= profile.top_m:
        raise messages.reference_height_outside_profile(
            height_m=anchor_height_m, where=profile.extent
        )
    is_outside = profile.layer_of(h) < 0
    height = profile.gravity.geopotential_height(h)
    height = np.where(is_outside, np.nan, height)
    anchor = profile.gravity.geopotential_height(anchor_height_m)
    _, gradient = inverse_temperature_integral(
        profile.layers.edge,
        profile.layers.edge_temperature,
        np.append(height, anchor),
    )
    from_bottom = gradient[:-1]
    anchor_from_bottom = gradient[-1]
    jacobian = profile.constant * (anchor_from_bottom - from_bottom)
    return np.where(np.isnan(height)[:, None], np.nan, jacobian)


def _index_partials(
    index: IndexModel,
    t: Array,
    p: Array,
    vapour_share: Array,
) -> tuple[Array, Array, Array]:
    """(n,) dN/dT [1/K], dN/d ln p and dN/d(e/p), each with the other two of T, p, e/p constant.

    ``t`` [K], ``p`` [Pa], ``vapour_share`` e/p: (n,).
    """
    steps = np.append(np.arange(-4.0, 0.0), np.arange(1.0, 5.0))[:, None]
    temperatures = t * (1.0 + _TEMPERATURE_STEP * steps)
    pressures = p * (1.0 + _PRESSURE_STEP * steps)
    fractions = vapour_share + _VAPOUR_STEP * steps

    by_temperature = index.refractivity(temperatures, p, vapour_share * p)
    by_pressure = index.refractivity(t, pressures, vapour_share * pressures)
    by_fraction = index.refractivity(t, p, fractions * p)
    return (
        _central_difference(by_temperature, _TEMPERATURE_STEP) / t,
        _central_difference(by_pressure, _PRESSURE_STEP),
        _central_difference(by_fraction, _VAPOUR_STEP),
    )


def _central_difference(values: Array, step: float) -> Array:
    """(n,) derivatives from ``values`` (8, n) at -4, ..., -1, 1, ..., 4 steps from the point."""
    above = values[4:]
    below = values[3::-1]
    return np.asarray(_STENCIL @ (above - below) / step)


def plane_rule(h_c: float, h_g: float, steps: int) -> tuple[Array, Array]:
    """Heights [m] and weights, so that the weighted sum of N there is R/tan zeta in the plane.

    R/tan zeta is the mean of N over the height minus N_c at the camera (Gyer 1996, Eq. 24), by
    ``steps`` trapezia from the ground at ``h_g`` to a camera at ``h_c`` [m above sea level].
    """
    h = np.linspace(h_g, h_c, steps + 1)
    weight = np.full(h.size, 1.0 / steps)
    weight[[0, -1]] *= 0.5
    weight[-1] -= 1.0  # N_c
    return h, weight


@dataclass(frozen=True, eq=False)
class ProfileCovariance:
    """Covariance of the parameters of a profile with k edges of layers.

    ``matrix`` C: (2k + 1, 2k + 1), of T_M at the edges [K], ln p at the geopotential height
    ``anchor_m`` [m'], and e/p at the edges, in this order. A quantity with derivatives g by these
    parameters has sigma^2 = g^T C g.
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
        """Height above sea level [m] of the anchor, where the matrix has ln p."""
        return float(self.profile.gravity.height(self.anchor_m))

    def sigma_temperature(self, h: ArrayLike) -> Array:
        """One sigma of temperature [K] at heights ``h`` (n,) [m above sea level]."""
        h = _as_column(h)
        weights = self._weights(h)
        t_m, _, vapour = self.profile.state(h)
        by_t_m = 1.0 - VAPOUR_DEFICIT * vapour
        by_log_p = np.zeros(h.size)
        by_vapour = -VAPOUR_DEFICIT * t_m
        blocks = [
            by_t_m[:, None] * weights,
            by_log_p,
            by_vapour[:, None] * weights,
        ]
        return self.sigma_of(np.column_stack(blocks))

    def sigma_log_pressure(self, h: ArrayLike) -> Array:
        """One sigma of ln p, that is sigma_p/p, at heights ``h`` (n,) [m above sea level]."""
        by_virtual = self.log_pressure_by_virtual(_as_column(h))
        by_log_p = np.ones(by_virtual.shape[0])
        by_vapour = np.zeros(by_virtual.shape)
        blocks = [by_virtual, by_log_p, by_vapour]
        return self.sigma_of(np.column_stack(blocks))

    def sigma_vapour_pressure(self, h: ArrayLike) -> Array:
        """One sigma of vapour pressure [Pa] at heights ``h`` (n,) [m above sea level]."""
        h = _as_column(h)
        _, p, vapour = self.profile.state(h)
        e = vapour * p
        log_p_by_virtual = self.log_pressure_by_virtual(h)
        by_virtual = e[:, None] * log_p_by_virtual
        by_vapour = p[:, None] * self._weights(h)
        blocks = [by_virtual, e, by_vapour]
        return self.sigma_of(np.column_stack(blocks))

    def sigma_refractivity(self, h: ArrayLike) -> Array:
        """One sigma of n - 1 at heights ``h`` (n,) [m above sea level]."""
        gradient = self.refractivity_gradient(_as_column(h))
        return self.sigma_of(gradient)

    def refractivity_gradient(self, h: Array) -> Array:
        """(n, 2k + 1) derivatives of n - 1 at heights (n,) [m] by the quantities of ``matrix``."""
        return air_jacobian(self.profile, h, self.anchor_height_m)

    def relative_sigma(self, h_c: float, h_g: float) -> float:
        """sigma_R/R of rays from a camera at ``h_c`` to the ground at ``h_g`` [m], to first order.

        Computed in the plane (`plane_rule`); for rays below 75 degrees the ratio differs by less
        than 1 % of itself. It is the sigma of the scale factor of R that a whole flight shares.
        """
        h, weight = plane_rule(h_c, h_g, RAY_STEPS)
        r = float(weight @ self.profile.refractivity(h))
        gradient = weight @ self.refractivity_gradient(h)
        variance = gradient @ self.matrix @ gradient
        return float(np.sqrt(variance)) / abs(r)

    def _weights(self, h: Array) -> Array:
        """(n, k) weights of the edges in the interpolation to heights (n,) [m above sea level]."""
        height = self.profile.gravity.geopotential_height(h)
        return interpolation_weights(self.profile.layers.edge, height)

    def log_pressure_by_virtual(self, h: Array) -> Array:
        """(n, k) derivatives of ln p at heights (n,) [m] by T_M at the edges [1/K]."""
        return log_pressure_jacobian(self.profile, h, self.anchor_height_m)

    def sigma_of(self, gradient: Array) -> Array:
        """One sigma of quantities whose derivatives (n, 2k + 1) are in the order of ``matrix``."""
        variance = np.einsum("ij,ij->i", gradient @ self.matrix, gradient)
        return np.asarray(np.sqrt(variance))


def _as_column(h: ArrayLike) -> Array:
    """Heights as an array (n,), (1,) for a single height."""
    return np.atleast_1d(np.asarray(h, dtype=np.float64))
