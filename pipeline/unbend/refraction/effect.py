"""The air of a flight, and R in it beside R in the standard, with sigma."""

import math
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.adjusted_profile import Adjustment
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.atmosphere.series.time_windows import TimeWindow
from unbend.refraction.ray import refraction_angle
from unbend.refraction.uncertainty.sensitivity import sensitivity
from unbend.units import DEGREE

ANGLES_DEG = (45.0, 75.0)

_LEAST_CLIMB_M = 1.0


@dataclass(frozen=True)
class Effect:
    """R of one ray in two airs [rad]; ``sigma_rad`` is NaN where the air has no covariance."""

    nadir_deg: float
    h_c_m: float
    h_g_m: float
    r_c_rad: float
    standard_rad: float
    sigma_rad: float = math.nan

    @property
    def factor(self) -> float:
        """R over that of the standard: the scale factor that a whole flight shares."""
        return self.r_c_rad / self.standard_rad

    @property
    def sigma_factor(self) -> float:
        """One sigma of the factor."""
        return abs(self.sigma_rad / self.standard_rad)


@dataclass(frozen=True, eq=False)
class FlightAir:
    """The air of the whole flight, the profile of each exposure, and what it does to R.

    ``windows`` are the parts that were estimated by themselves, none where one profile is enough.
    """

    adjustment: Adjustment
    series: ProfileSeries
    windows: tuple[TimeWindow, ...] = ()
    effects: tuple[Effect, ...] = ()


def effects_on_r(
    air: Profile, standard: Profile, covariance: ProfileCovariance | None, h_c: float, h_g: float
) -> tuple[Effect, ...]:
    """R at some nadir angles in an air and in the standard; none where no ray looks down.

    ``covariance`` of ``air`` gives sigma^2 = g^T C g with the derivatives g of `sensitivity`.
    Heights of camera and ground are above sea level [m]; angles are `ANGLES_DEG`.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976")
    >>> [round(e.factor, 3) for e in effects_on_r(air, air, None, 3000.0, 0.0)]
    [1.0, 1.0]
    """
    if not h_c > h_g + _LEAST_CLIMB_M:
        return ()
    zeta = np.asarray(ANGLES_DEG) * DEGREE
    ours, theirs = (refraction_angle(each, h_c, h_g, zeta) for each in (air, standard))
    sigma = np.full(zeta.shape, np.nan)
    if covariance is not None:
        s = sensitivity(air, h_c, h_g, zeta, anchor_height_m=covariance.anchor_height_m)
        sigma = covariance.sigma_of(s.gradient)
    return tuple(
        Effect(float(a), h_c, h_g, float(r), float(t), float(s))
        for a, r, t, s in zip(ANGLES_DEG, ours, theirs, sigma, strict=True)
        if np.isfinite(r) and np.isfinite(t)
    )
