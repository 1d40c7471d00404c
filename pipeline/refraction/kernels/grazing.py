"""Rays near grazing: which crossing of a height is meant, and the bending of nearly level rays."""

import math

from pipeline.refraction.kernels.jit import entry, jit
from pipeline.refraction.kernels.subtended import (
    LOWEST_TERRAIN_M,
    angle_to,
    chord2,
    excess,
    piece,
    ray_at,
    subtended,
    subtended_through_turn,
)
from pipeline.refraction.status_codes import BEYOND_GRAZING, FAR_BRANCH, MISSES_GROUND, OK


@jit
def crosses_once(table, ray, h_g):  # type: ignore[no-untyped-def]
    """Whether a ray meets a height once only, or is so steep that this needs no further test."""
    h_c, r_e = ray.h_c, ray.r_e
    # At the camera's own height the far crossing of a level ray is the near one.
    if not (h_g < h_c or (h_g == h_c and ray.cos_c > 1e-9)):
        return True
    # Whether the ray turns above the ground, and so meets heights below h_c twice. The straight
    # line's lowest point lies deeper than the ray's, by less than a fifth in any air in which n
    # falls with height; a line that goes far below the floor needs no further test.
    floor = max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))
    depth = h_c - floor + 100.0
    return (r_e + h_c) * ray.cos_c * ray.cos_c > 2.0 * (1.0 + ray.sin_c) * depth


@jit
def crossing_meant(table, ray, angle, h_g, distance):  # type: ignore[no-untyped-def]
    """R_c [rad] and status of a ray to h_g, of which ``angle`` is R_c at the near crossing.

    A ray that turns above the ground meets a height twice. ``distance`` is the slant range [m] that
    decides which crossing is meant; NaN where unknown: the near one, status `BEYOND_GRAZING`.
    """
    h_c = ray.h_c
    if crosses_once(table, ray, h_g):
        return angle, OK
    floor = max(table.edge[0], min(LOWEST_TERRAIN_M, h_g))
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


@jit
def bend_by_subtended(table, ray, h_g):  # type: ignore[no-untyped-def]
    """R_c from the subtended angle (Gyer 1996, Eq. 11, 12, 15), good at and beyond grazing."""
    h_c = ray.h_c
    if h_g > h_c and ray.cos_c > 0.0:  # down through P_90 and up again
        theta = subtended_through_turn(table, ray) + subtended(table, ray, h_c, h_g, False)
    else:
        low, high = min(h_c, h_g), max(h_c, h_g)
        if not excess(table, ray, piece(table.edge, low), low) >= 0.0:
            return math.nan
        theta = subtended(table, ray, low, high, False)
    return angle_to(ray, theta, h_g)


@entry(rows=2, most=100)
def bend_grazing_rays(table, rays, which, angle, status):  # type: ignore[no-untyped-def]
    """Fill ``angle`` [rad] and ``status`` for rays that `bend_rays` has left."""
    for i in which:
        h_g = rays.h_g[i]
        ray = ray_at(table, rays.h_c[i], rays.sin_c[i], rays.cos_c[i], rays.r_e[i])
        bent = angle[i]
        if math.isnan(bent):
            bent = bend_by_subtended(table, ray, h_g)
        angle[i], status[i] = math.nan, MISSES_GROUND
        if not math.isnan(bent):
            angle[i], status[i] = crossing_meant(table, ray, bent, h_g, rays.distance[i])
