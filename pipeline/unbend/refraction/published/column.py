"""Means over the column of air between ground and camera, which the plane forms are made of."""

import math
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.atmosphere.profile import Profile
from unbend.refraction.ray_table import cut
from unbend.units import STANDARD_GRAVITY, Array, Mask

Quantity = Callable[[Profile, Array], Array]
Method = Callable[..., Array]

# Four Gauss nodes on 500 m of an exponential atmosphere err by 1e-19 of the integral.
_PIECE_M = 500.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def density(profile: Profile, h: ArrayLike) -> Array:
    """Density of the air [kg m-3] at heights ``h`` [m], by the gas law of the profile.

    rho = p M0 / (R* T_M), with the virtual temperature and the constants of the profile.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> density(standard_atmosphere("us1976"), [0.0, 10000.0]).round(4).tolist()
    [1.225, 0.4135]
    """
    gas = profile.constant / STANDARD_GRAVITY  # M0 / R* [kg K J-1]
    return np.asarray(gas * profile.pressure(h) / profile.virtual_temperature(h))


def finite(*arguments: ArrayLike) -> tuple[Array, ...]:
    """Arguments of a method as arrays of one shape, with NaN in the place of infinite values.

    Formulas pass NaN on without a warning; infinity times zero is a warning.
    """
    arrays = []
    for argument in arguments:
        numbers = np.asarray(argument, np.float64)
        arrays.append(np.where(np.isfinite(numbers), numbers, np.nan))
    return tuple(np.broadcast_arrays(*arrays))


def downward(h_c: Array, h_g: Array, zeta_c: Array) -> Mask:
    """Where a plane form is defined: rays below the horizon, the ground not above the camera."""
    return (zeta_c >= 0.0) & (zeta_c < math.pi / 2.0) & (h_c >= h_g)


def times_tangent(r: Array, h_c: Array, h_g: Array, zeta_c: Array) -> Array:
    """R_c = R tan(zeta_c) [rad] from R, ``r`` [rad at 45 degrees]; NaN where it is not defined."""
    is_usable = downward(h_c, h_g, zeta_c)
    tangent = np.tan(np.where(is_usable, zeta_c, 0.0))
    return np.where(is_usable, r * tangent, np.nan)


def at_45_degrees(plane_form: Callable[..., Array]) -> Method:
    """Decorator that makes a plane form R a method R_c = R tan(zeta_c).

    The plane form is a function of profile, h_c, h_g (arrays of one shape) and options that returns
    R [rad at 45 degrees].
    """

    @wraps(plane_form)
    def method(
        profile: Profile,
        h_c: ArrayLike,
        h_g: ArrayLike,
        zeta_c: ArrayLike,
        radius: ArrayLike,
        **options: Any,
    ) -> Array:
        h_c, h_g, zeta_c = finite(h_c, h_g, zeta_c)
        r = plane_form(profile, h_c, h_g, **options)
        return times_tangent(r, h_c, h_g, zeta_c)

    vars(method).pop("__wrapped__")  # so that help() shows the arguments of the method
    return method


class _Column(NamedTuple):
    """Integrals of a quantity over the height of a profile."""

    edge_m: Array  # (p + 1,) heights that divide the profile
    integral: Array  # (p + 1,) from the lowest of these heights to each


@lru_cache(maxsize=64)
def _column(profile: Profile, quantity: Quantity) -> _Column:
    """The `_Column` of a quantity in pieces of at most 500 m."""
    edge = cut(profile.break_heights_m, _PIECE_M)
    parts = _gauss(profile, quantity, edge[:-1], edge[1:])
    integral = np.concatenate([[0.0], np.cumsum(parts)])
    return _Column(edge, integral)


def _gauss(profile: Profile, quantity: Quantity, low: Array, high: Array) -> Array:
    """Integrals of a quantity over height from ``low`` to ``high`` [m], by four Gauss nodes."""
    half = 0.5 * (high - low)
    middle = 0.5 * (high + low)
    total = np.zeros(half.shape)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        total += weight * quantity(profile, middle + half * node)
    return half * total


def mean(profile: Profile, quantity: Quantity, h_g: Array, h_c: Array) -> Array:
    """Mean of a quantity over height between ``h_g`` and ``h_c``; its value there if h_g = h_c.

    Heights [m] are of one shape; NaN outside the profile. The integral is exact to 1e-15 of that
    from the profile's bottom.
    """
    edge, integral = _column(profile, quantity)

    def integral_up_to(h: Array) -> Array:
        inside = np.where(np.isfinite(h), h, edge[0])
        edges_up_to = np.searchsorted(edge, inside, side="right")
        piece = np.clip(edges_up_to - 1, 0, edge.size - 2)
        return np.asarray(integral[piece] + _gauss(profile, quantity, edge[piece], h))

    rise = h_c - h_g
    is_thick = rise != 0.0
    thickness = np.where(is_thick, rise, 1.0)
    mean_of_column = (integral_up_to(h_c) - integral_up_to(h_g)) / thickness
    return np.where(is_thick, mean_of_column, quantity(profile, h_c))
