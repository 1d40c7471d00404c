"""Heights of points from their rays alone, each point by itself, the stations held."""

from dataclasses import dataclass

import numpy as np

from pipeline.block.image_rays import (
    MINIMUM_ANGLE_RAD,
    ImageRays,
    Indices,
    Mask,
    Orientations,
    sorted_rays,
)
from pipeline.geodesy import enu_from_ecef, geodetic_of_ecef
from pipeline.units import Array

LARGEST_MISS = 6.0
"""A point has no height whose rays miss it by more than this many times what their sigmas say."""


@dataclass(frozen=True, eq=False)
class PointHeights:
    """Heights of points above the ellipsoid [m] and their standard deviations, (p,) each.

    NaN where ``few`` (fewer than two rays with a station), ``narrow`` (all within the minimum
    angle, or behind a camera) or ``apart`` (the rays miss each other) says why. ``index`` (r,) is
    the point of each ray in the order they came; ``position_m`` (p, 3) is earth-centred.
    """

    h_m: Array
    sigma_m: Array
    position_m: Array
    index: Indices
    few: Mask
    narrow: Mask
    apart: Mask


def point_heights(
    orientations: Orientations, rays: ImageRays, *, minimum_angle_rad: float = MINIMUM_ANGLE_RAD
) -> PointHeights:
    """The heights at which the rays of each point meet best.

    Least squares under the covariance that the sigmas of pixels and stations give each ray; rays of
    one point are of different images, so those are independent. ``sigma_m`` is what these sigmas
    give the height, enlarged where the rays miss by more than they say. The time goes with the
    number of rays.
    """
    r, points = sorted_rays(orientations, rays), np.unique(rays.point)
    good, position = r.oriented, r.positions(r.oriented)
    count, angle = r.sums(good * 1), r.angles(good)
    _, A, J, y = r.derivatives(orientations, position, good)
    weight = np.linalg.inv(np.eye(2) + J @ np.swapaxes(J, 1, 2))
    right = np.swapaxes(A, 1, 2) @ weight
    normal = r.sums(right @ A)
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += (1e-12 * trace + (trace == 0.0))[:, None, None] * np.eye(3)
    step = np.linalg.solve(normal, r.sums(right @ y[..., None]))[..., 0]
    position = position + step
    miss = y - np.einsum("rij,rj->ri", A, step[r.index])
    square = r.sums(np.einsum("ri,rij,rj->r", miss, weight, miss))
    factor = np.sqrt(square / np.maximum(2 * count - 3, 1))
    lat, lon, h = geodetic_of_ecef(*(position + r.origin).T)
    up = enu_from_ecef(lat, lon)[:, 2]
    variance = np.sum(up * np.linalg.solve(normal, up[..., None])[..., 0], axis=1)
    line = position[r.index] - r.centre
    behind = r.sums(good & (np.sum(line * r.direction, axis=1) <= 0.0)) > 0
    few = count < 2
    narrow = ~few & ((angle < minimum_angle_rad) | behind)
    apart = ~few & ~narrow & (factor > LARGEST_MISS)
    unknown = few | narrow | apart
    return PointHeights(
        h_m=np.where(unknown, np.nan, h),
        sigma_m=np.where(unknown, np.nan, np.sqrt(variance) * np.maximum(1.0, factor)),
        position_m=np.where(unknown[:, None], np.nan, position + r.origin),
        index=np.searchsorted(points, rays.point),
        few=few,
        narrow=narrow,
        apart=apart,
    )
