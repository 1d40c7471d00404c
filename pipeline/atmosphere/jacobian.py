"""How the air of a profile answers to the temperatures, pressure and humidity it is made of.

The layers are linear in T_M and in e/p between their edges, with pressure by Eq. 52-53 of Gyer 1996
from one anchor (`pipeline.atmosphere.profile.stack_layers`). With phi_k the hat function of edge k,

    T_M(H) = sum of phi_k T_k,   ln p(H) = ln p(anchor) - (G M0 / R*) * integral of dH / T_M,

so that d ln p(H) / d T_k = (G M0 / R*) * integral from the anchor to H of phi_k / T_M^2 dH: see
`pipeline.atmosphere.hypsometry.column`. Layers must meet in T_M, as `stack_layers` makes them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.atmosphere.hypsometry import column, hats
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.refractive_index import IndexModel
from pipeline.errors import PhysicsError
from pipeline.units import VAPOUR_DEFICIT

Array = NDArray[np.float64]

# Of the index formula itself, so that a new one is still one function: central differences of
# eighth order. N is a rational function of T, p and e/p whose poles are far away, so that long
# steps are exact: with these the derivatives keep 13 digits.
_STENCIL = np.array([4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0])
_TEMPERATURE_STEP = 0.007  # of T
_PRESSURE_STEP = 0.05  # of p
_VAPOUR_STEP = 0.05  # of e/p


@dataclass(frozen=True, eq=False)
class AirJacobian:
    """Derivatives of N = n - 1 at heights with respect to what the profile is made of.

    Parameters
    ----------
    d_temperature : (n, m + 1) with respect to T_M at the m + 1 edges of the layers [1/K], e/p held,
        pressure following by hydrostatics from the anchor.
    d_log_pressure : (n,) with respect to ln p at the anchor; one height is as good as another.
    d_vapour : (n, m + 1) with respect to e/p at the edges, T_M held (so pressure stays).

    A thermometer measures T = T_M (1 - 0.378 e/p). With x_k for e/p at edge k, the derivative with
    respect to T_k at fixed x_k is that for T_M,k divided by (1 - 0.378 x_k); the one with respect
    to x_k at fixed T_k is ``d_vapour`` + ``d_temperature`` * 0.378 T_M,k / (1 - 0.378 x_k).
    """

    d_temperature: Array
    d_log_pressure: Array
    d_vapour: Array

    @property
    def gradient(self) -> Array:
        """(n, 2m + 3) all of them, in the order of `ProfileCovariance.matrix`."""
        return np.column_stack([self.d_temperature, self.d_log_pressure, self.d_vapour])


def air_jacobian(profile: Profile, h: ArrayLike, anchor_height_m: float) -> AirJacobian:
    """Derivatives of the refractivity with respect to the edges of the layers.

    Parameters
    ----------
    profile : m layers.
    h : (n,) heights [m above sea level]; rows of heights outside the profile are NaN.
    anchor_height_m : where pressure stays as it is when temperatures change [m above sea level].

    Raises `PhysicsError` for an anchor outside the profile. Against
    30-digit arithmetic 3e-13 of the largest derivative.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> air = air_jacobian(standard_atmosphere("us1976"), [0.0, 8000.0], 0.0)
    >>> (air.d_temperature[:, :3] * 1e9).round(2).tolist()
    [[0.0, -967.15, 0.0], [0.0, 154.8, -182.09]]
    """
    h = np.asarray(h, dtype=np.float64)
    t_m, p, vapour = profile.state(h)
    dryness = 1.0 - VAPOUR_DEFICIT * vapour
    by_t, by_log_p, by_vapour = _index_partials(profile.index, t_m * dryness, p, vapour)
    weights = hats(profile.layers.edge, profile.gravity.geopotential_height(h))
    log_pressure = log_pressure_jacobian(profile, h, anchor_height_m)
    return AirJacobian(
        by_log_p[:, None] * log_pressure + (by_t * dryness)[:, None] * weights,
        by_log_p,
        (by_vapour - VAPOUR_DEFICIT * t_m * by_t)[:, None] * weights,
    )


def log_pressure_jacobian(profile: Profile, h: ArrayLike, anchor_height_m: float) -> Array:
    """d ln p / d T_M at the edges of the layers [1/K], (n, m + 1); arguments as `air_jacobian`.

    A degree more over the lowest 11 km raises the pressure above them by 0.6 %:

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> rows = log_pressure_jacobian(standard_atmosphere("us1976"), [11000.0], 0.0)
    >>> rows.sum(axis=1).round(5).tolist()
    [0.00601]
    """
    h = np.asarray(h, dtype=np.float64)
    if not profile.bottom_m <= anchor_height_m <= profile.top_m:
        raise PhysicsError(
            "PROFILE-RANGE",
            f"a reference height of {anchor_height_m:g} m leaves the profile",
            where=f"profile {profile.name}, {profile.bottom_m:.0f} to {profile.top_m:.0f} m",
            remedy="refer pressure to a height inside it",
        )
    height = profile.gravity.geopotential_height(h)
    height = np.where(profile.layer_of(h) < 0, np.nan, height)
    at = np.append(height, profile.gravity.geopotential_height(anchor_height_m))
    _, gradient = column(profile.layers.edge, profile.layers.edge_temperature, at)
    found = profile.constant * (gradient[-1] - gradient[:-1])
    return np.where(np.isnan(height)[:, None], np.nan, found)


def _index_partials(
    index: IndexModel, t: Array, p: Array, vapour: Array
) -> tuple[Array, Array, Array]:
    """dN/dT [1/K], dN/d ln p and dN/d(e/p), each with the other two of T, p and e/p held."""

    def differences(step: float, shifted: Array) -> Array:
        """``shifted`` (8, n): N at -4 ... -1, 1 ... 4 steps."""
        return np.asarray(_STENCIL @ (shifted[4:] - shifted[3::-1]) / step)

    steps = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])[:, None]
    warmer = t * (1.0 + _TEMPERATURE_STEP * steps)
    denser = p * (1.0 + _PRESSURE_STEP * steps)
    moister = vapour + _VAPOUR_STEP * steps
    return (
        differences(_TEMPERATURE_STEP, index.refractivity(warmer, p, vapour * p)) / t,
        differences(_PRESSURE_STEP, index.refractivity(t, denser, vapour * denser)),
        differences(_VAPOUR_STEP, index.refractivity(t, p, moister * p)),
    )
