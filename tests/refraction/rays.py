"""Single rays, and the air in which their angles are known to 40 digits."""

import math

import numpy as np

from tests.physics.ray_on_sphere import ray_angle_sphere
from tests.refraction.images import RADIUS
from unbend.atmosphere import standard_atmosphere
from unbend.refraction import bend, ray_table, refraction_angle
from unbend.units import ARCSEC

AIR = standard_atmosphere("us1976", index="gyer")
TABLE = ray_table(AIR)


def bent(table, h_c, h_g, zeta, radius=RADIUS, **options):
    """R_c and status of `bend`, by the nadir angle [rad]."""
    sine = np.sin(zeta)
    cosine = np.cos(zeta)
    return bend(
        table,
        h_c,
        h_g,
        sine,
        cosine,
        radius=radius,
        **options,
    )


def touching_angle(profile, h_c, h_g=0.0):
    """Nadir angle [rad] of the ray that just touches a height, by default sea level."""
    n_c, n_g = 1.0 + profile.refractivity([h_c, h_g])
    return math.asin(n_g * (RADIUS + h_g) / (n_c * (RADIUS + h_c)))


def arcsec(profile, h_c, h_g, zeta):
    """R_c of the kernel."""
    return refraction_angle(profile, h_c, h_g, zeta) / ARCSEC


def integrated_arcsec(profile, h_c, h_g, zeta):
    """R_c of an independent ODE."""

    def index(h):
        return 1.0 + float(profile.refractivity(h))

    kinks = profile.break_heights_m.tolist()
    return ray_angle_sphere(index, h_c, h_g, zeta, RADIUS, breaks=kinks) / ARCSEC
