"""Refraction angles R in the air of a flight and in the standard atmosphere, with sigma."""

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

ANGLES_DEG = (45.0, 75.0)  # nadir angles of the rays that are compared

_MIN_HEIGHT_ABOVE_GROUND_M = 1.0  # below it the camera is taken as on the ground


@dataclass(frozen=True)
class Effect:
    """The refraction angle of one ray in the air of a flight and in the standard atmosphere."""

    nadir_deg: float  # apparent nadir angle at the camera
    h_c_m: float  # height of the camera above sea level
    h_g_m: float  # height of the ground above sea level
    r_c_rad: float  # R in the air of the flight
    standard_rad: float  # R in the standard atmosphere
    sigma_rad: float = math.nan  # one sigma of ``r_c_rad``, NaN where the air has no covariance

    @property
    def factor(self) -> float:
        """R in the air of the flight divided by R in the standard atmosphere."""
        return self.r_c_rad / self.standard_rad

    @property
    def sigma_factor(self) -> float:
        """One sigma of `factor`."""
        return abs(self.sigma_rad / self.standard_rad)


@dataclass(frozen=True, eq=False)
class FlightAir:
    """The air of a flight, the profile of each exposure, and the effect of the air on R."""

    adjustment: Adjustment  # the air of the whole flight
    series: ProfileSeries  # the profile of each exposure
    # Parts of the flight with an estimate of their own; empty where one profile is enough.
    windows: tuple[TimeWindow, ...] = ()
    effects: tuple[Effect, ...] = ()  # of the air of the whole flight


def effects_on_r(
    air: Profile, standard: Profile, covariance: ProfileCovariance | None, h_c: float, h_g: float
) -> tuple[Effect, ...]:
    """R at the nadir angles `ANGLES_DEG` in ``air`` and in the ``standard`` atmosphere.

    Angles without R in one of the two are left out; so the result is empty where the camera is not
    above the ground. ``h_c``, ``h_g`` are the heights of camera and ground above sea level [m].
    The ``covariance`` C of ``air`` gives sigma^2 = g^T C g with the derivatives g of `sensitivity`.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976")
    >>> [round(e.factor, 3) for e in effects_on_r(air, air, None, 3000.0, 0.0)]
    [1.0, 1.0]
    """
    is_above_ground = h_c > h_g + _MIN_HEIGHT_ABOVE_GROUND_M
    if not is_above_ground:
        return ()
    zeta = np.asarray(ANGLES_DEG) * DEGREE
    r_air = refraction_angle(air, h_c, h_g, zeta)
    r_standard = refraction_angle(standard, h_c, h_g, zeta)
    sigma = np.full(zeta.shape, np.nan)
    if covariance is not None:
        derivatives = sensitivity(air, h_c, h_g, zeta, anchor_height_m=covariance.anchor_height_m)
        sigma = covariance.sigma_of(derivatives.gradient)
    effects = []
    for k, nadir_deg in enumerate(ANGLES_DEG):
        if not (np.isfinite(r_air[k]) and np.isfinite(r_standard[k])):
            continue
        effect = Effect(
            nadir_deg=nadir_deg,
            h_c_m=h_c,
            h_g_m=h_g,
            r_c_rad=float(r_air[k]),
            standard_rad=float(r_standard[k]),
            sigma_rad=float(sigma[k]),
        )
        effects.append(effect)
    return tuple(effects)
