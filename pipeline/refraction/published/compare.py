"""Each published method against the spherical ray, over camera height and nadir angle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.profile import Profile
from pipeline.refraction.ray import DEFAULT_RADIUS_M, METHODS, refraction_angle

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Refraction angles of several methods in the same air over one ground.

    ``exact_rad`` (h, z) is the spherical form at ``h_c_m`` (h,) and ``nadir_angle_rad`` (z,);
    ``error_rad`` (m, h, z) is method minus exact, NaN where the method is not defined.
    """

    methods: tuple[str, ...]
    h_c_m: Array
    h_g_m: float
    nadir_angle_rad: Array
    exact_rad: Array
    error_rad: Array

    def good_to(self, limit_rad: float) -> Array:
        """(m, h) the largest nadir angle [rad] up to which a method errs by no more than a limit.

        Counts angles of the table: all up to this one are within the limit. NaN where the method
        is not defined at all; -1 where it is outside already at the first angle.
        """
        within = np.logical_and.accumulate(np.abs(self.error_rad) <= limit_rad, axis=2)
        count = within.sum(axis=2)
        angle = np.append(self.nadir_angle_rad, -1.0)[count - 1]
        return np.where(np.isfinite(self.error_rad).any(axis=2), angle, np.nan)


def compare_methods(
    profile: Profile,
    h_c: Array,
    h_g: float,
    nadir_angle: Array,
    *,
    methods: tuple[str, ...] = METHODS[1:],
    radius: float = DEFAULT_RADIUS_M,
) -> Comparison:
    """Errors of refraction methods against ``spherical``.

    Parameters
    ----------
    profile : the air; its index should be that of the papers' light (``gyer``), or the errors
        hold its difference from 0.589 um too.
    h_c, h_g : heights of cameras (h,) and ground above sea level [m].
    nadir_angle : (z,) apparent nadir angles [rad], ascending.
    radius : of the sphere [m].

    The reference is good to 1e-9 arcsec.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> angles = np.arange(0.0, 86.0) * DEGREE
    >>> found = compare_methods(air, np.array([3000.0]), 0.0, angles, methods=("plane", "manual"))
    >>> (found.good_to(0.1 * ARCSEC) / DEGREE).round().tolist()
    [[74.0], [6.0]]
    """
    angles = np.asarray(nadir_angle, dtype=np.float64)
    heights = np.asarray(h_c, dtype=np.float64)
    at = (profile, heights[:, None], h_g, angles[None, :], radius)
    exact = refraction_angle(*at)
    error = np.stack([refraction_angle(*at, method) - exact for method in methods])
    return Comparison(methods, heights, h_g, angles, exact, error)
