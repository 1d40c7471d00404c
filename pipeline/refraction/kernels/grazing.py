"""Rays that turn above the ground and meet a height twice: which crossing an observation means.

Without a slant range the near one is taken, and the observation is `beyond_grazing`.
"""

import math

from pipeline.refraction.kernels.jit import jit
from pipeline.refraction.kernels.subtended import (
    LOWEST_TERRAIN_M,
    angle_to,
    chord2,
    excess,
    piece,
    subtended,
    subtended_through_turn,
)
from pipeline.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, OK


@jit
def crossing_meant(table, ray, angle, h_g, distance):  # type: ignore[no-untyped-def]
    """R_c [rad] and status of a ray to h_g, of which ``angle`` is R_c at the near crossing.

    ``distance`` is the slant range [m] that decides between two crossings; NaN where unknown.
    """
    h_c, r_e = ray.h_c, ray.r_e
    # At the camera's own height the far crossing of a level ray is the near one.
    if not (h_g < h_c or (h_g == h_c and ray.cos_c > 1e-9)):
        return angle, OK
    # Whether the ray turns above the ground, and so meets heights below h_c twice. The straight
    # line's lowest point lies deeper than the ray's, by less than a fifth in any air in which n
    # falls with height; a line that goes far below the floor needs no further test.
    floor = max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))
    depth = h_c - floor + 100.0
    if (r_e + h_c) * ray.cos_c * ray.cos_c > 2.0 * (1.0 + ray.sin_c) * depth:
        return angle, OK
    if not excess(table, ray, piece(table.edge, floor), floor) < 0.0:
        return angle, OK
    if not distance > 0.0:
        return angle, BEYOND_GRAZING
    # The crossing whose slant range is nearer to the one that was given.
    theta = subtended(table, ray, h_g, h_c, False)
    around = subtended_through_turn(table, ray)
    far = math.sqrt(chord2(ray, around - theta, h_g))
    if abs(far - distance) < abs(math.sqrt(chord2(ray, theta, h_g)) - distance):
        return angle_to(ray, around - theta, h_g), FAR_BRANCH
    return angle, OK
