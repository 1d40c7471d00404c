"""Compare given heights of tie points with the heights at which their rays meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from unbend.block.image_rays import ImageRays
from unbend.block.intersection import Intersection
from unbend.block.possible_mistakes import EXPLAINED_SIGMAS, StatedMission
from unbend.units import Array

MIN_GIVEN_HEIGHTS = 10  # fewer cannot tell a wrong zero from wrong points
SIGMA_OF_MAD = 1.4826  # sigmas of a normal distribution in its median absolute deviation
WILD_SIGMAS = 6.0  # heights that are farther from the median of all do not count
LARGEST_SCATTER = 0.03  # of the flying height: allowed error of a given height
WORSE_THAN_FLAT = 1.1  # of the relief: given heights that scatter more are useless
FLAT = 0.002  # of the flying height: smaller scatters are not compared with the relief
FAR_SHARE = 0.9  # quantile: a tenth of the points is farther


def with_usable_heights(mission: StatedMission, intersection: Intersection) -> StatedMission:
    """The mission with its usable given heights, and their standard deviation.

    Usable are heights within `WILD_SIGMAS` of the median difference to the rays. The standard
    deviation is the larger one of the stated and of the scatter of these differences. With fewer
    than `MIN_GIVEN_HEIGHTS` the mission stays as it is. ``intersection`` is that of the rays alone.
    """
    rays = mission.rays(mission.cameras, {})
    if rays.height_m is None:
        return mission
    off_m = heights_of_points(rays, rays.height_m) - intersection.geodetic[2]
    if np.isfinite(off_m).sum() < MIN_GIVEN_HEIGHTS:
        return mission
    from_middle_m = np.abs(off_m - np.nanmedian(off_m))
    scatter_m = SIGMA_OF_MAD * float(np.nanmedian(from_middle_m))
    sigma_m = max(mission.sigma_height_m, scatter_m)
    usable = from_middle_m <= WILD_SIGMAS * np.hypot(sigma_m, intersection.sigma_height_m)
    points = intersection.point[usable].tolist()
    return replace(mission, sigma_height_m=sigma_m, heights_of=tuple(points))


def scattered_heights(
    mission: StatedMission, intersection: Intersection, sigma_factor: float
) -> str:
    """The sentence on given heights that do not belong to their points; empty if they fit.

    They do not fit if a tenth of them is farther from where the rays meet than 3 % of the flying
    height, and than the sigmas times ``sigma_factor`` (residuals of the rays over their sigmas)
    explain. Or if they scatter more about the rays than one height for all points does, as heights
    of another place.
    """
    rays = mission.rays(mission.cameras, {})
    if rays.height_m is None or mission.one_height or not intersection.used.any():
        return ""
    met_m = intersection.geodetic[2]
    off_m = heights_of_points(rays, rays.height_m) - met_m
    has_height = np.isfinite(off_m)
    off_m = off_m[has_height]
    if off_m.size < MIN_GIVEN_HEIGHTS:
        return ""
    flying_height_m = intersection.flying_height_m
    station_sigma_m = np.nanmedian(intersection.orientations.sigma[:, 2])
    shared_sigma_m = np.hypot(mission.sigma_heights_m, station_sigma_m)
    sigma_m = float(shared_sigma_m + np.nanmedian(intersection.sigma_height_m))
    explained_m = max(1.0, sigma_factor) * (EXPLAINED_SIGMAS * sigma_m)
    allowed_m = max(LARGEST_SCATTER * flying_height_m, explained_m)
    far_m = float(np.quantile(np.abs(off_m), FAR_SHARE))
    far = (
        f"given heights of a tenth of {off_m.size} points are {far_m:.0f} m or more from the "
        "intersection of their rays, expected "
    )
    likely = (
        ": these are not heights, holes in the data are filled with a number, or the heights are "
        "of other points or another place"
    )
    if far_m > allowed_m:
        return f"{far}within {allowed_m:.0f} m{likely}"
    relief_m = scatter_of(met_m[has_height])
    if scatter_of(off_m) > max(WORSE_THAN_FLAT * relief_m, FLAT * flying_height_m):
        return (
            f"{far}nearer than one height for all points, which is within {relief_m:.0f} m{likely}"
        )
    return ""


def heights_of_points(rays: ImageRays, height_m: Array) -> Array:
    """(p,) the given height of each point: that of its first ray in ``height_m`` (r,)."""
    _, first_ray = np.unique(rays.point, return_index=True)
    return height_m[first_ray]


def scatter_of(values: Array) -> float:
    """The distance from the median that a tenth of the known values exceeds; infinite for few."""
    finite_values = values[np.isfinite(values)]
    if finite_values.size < MIN_GIVEN_HEIGHTS:
        return np.inf
    from_median = np.abs(finite_values - np.median(finite_values))
    return float(np.quantile(from_median, FAR_SHARE))
