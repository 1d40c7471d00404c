"""Refraction over a plane, in the simulator's air and in others."""

import numpy as np

from unbend.simulate.flight import FIELD_LAT_RAD
from unbend.simulate.true_air import true_air

TRUE_AIR = true_air(FIELD_LAT_RAD)


def true_refractivity(h_m):
    return TRUE_AIR.n(h_m) - 1.0


def plane_factor(refractivity, h_g, h_c):
    """R / tan(zeta) in the plane: the sphere takes 0.1 % away at 45 degrees.

    Mean of n along the way minus n at the camera (Gyer 1996, Eq. 24).
    """
    h_m = np.linspace(h_g, h_c, 3001)
    n = refractivity(h_m)
    between = 0.5 * (n[1:] + n[:-1])
    return float(np.mean(between) - n[-1])
