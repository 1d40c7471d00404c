"""Single rays, and the air in which their angles are known to 40 digits."""

import numpy as np

from tests.physics.ray_on_sphere import ray_angle_sphere
from tests.refraction.images import RADIUS
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import profile_from_table
from unbend.geodesy import lambert_gravity
from unbend.refraction import bend, ray_table, refraction_angle
from unbend.units import ARCSEC

AIR = standard_atmosphere("us1976", index="gyer")
TABLE = ray_table(AIR)


def inversions():
    """A profile of 400 thin layers with sharp inversions and moisture between them."""
    low = np.arange(-450.0, 12_000.0, 31.7)
    high = np.arange(12_000.0, 45_000.0, 1700.0)
    h = np.append(low, high)
    t = np.maximum(292.0 - 6.5e-3 * h, 217.0)
    t += 9.0 / (1.0 + np.exp(-(h - 800.0) / 15.0))
    t += 2.0 * np.sin(h / 70.0) * (h < 5000.0)
    e = 1400.0 * np.exp(-(h + 450.0) / 2000.0)
    e *= 1.0 + 0.3 * np.sin(h / 110.0)
    p = 101_325.0 * np.exp(-h / 8200.0)
    return profile_from_table(
        h,
        t,
        p,
        e,
        gravity=lambert_gravity(0.9),
    )


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


def arcsec(profile, h_c, h_g, zeta):
    """R_c of the kernel."""
    return refraction_angle(profile, h_c, h_g, zeta) / ARCSEC


def integrated_arcsec(profile, h_c, h_g, zeta):
    """R_c of an independent ODE."""

    def index(h):
        return 1.0 + float(profile.refractivity(h))

    kinks = profile.break_heights_m.tolist()
    return ray_angle_sphere(index, h_c, h_g, zeta, RADIUS, breaks=kinks) / ARCSEC
