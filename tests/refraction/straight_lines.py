"""Where straight lines meet a sphere, with 40 digits."""

import mpmath as mp

from tests.refraction.images import RADIUS


def crossing(h_c, h_g, zeta, far=False):
    """East and up [m] of where a straight line reaches a height, by its quadratic equation."""
    r_c = mp.mpf(RADIUS) + h_c
    r_g = mp.mpf(RADIUS) + h_g
    middle = r_c * mp.cos(zeta)
    square = middle**2 - (r_c**2 - r_g**2)
    half = mp.sqrt(square)
    if not far:
        half = -half
    along = middle + half
    east = along * mp.sin(zeta)
    up = -along * mp.cos(zeta)
    return mp.matrix([east, up])


def metres_apart(
    h_c,
    h_g,
    first,
    second,
    far=False,
):
    """Distance between where straight lines at two nadir angles [rad] reach a height."""
    with mp.workdps(40):
        start = crossing(h_c, h_g, first, far)
        end = crossing(h_c, h_g, second, far)
        return float(mp.norm(end - start))
