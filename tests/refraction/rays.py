"""Single rays, and the air in which their angles are known to 40 digits."""

from __future__ import annotations

import numpy as np

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
    return bend(table, h_c, h_g, sine, cosine, radius=radius, **options)


def arcsec(profile, h_c, h_g, zeta):
    """R_c of the kernel."""
    return refraction_angle(profile, h_c, h_g, zeta) / ARCSEC
