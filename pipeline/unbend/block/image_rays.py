"""Rays of image points, sorted by their points: what does not change while points move.

Exterior orientations of images and the straight rays that they measured become positions of the
points (least squares of the angles across the rays), and derivatives of what the rays miss them by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.atmosphere import Profile, standard_atmosphere
from unbend.flight.stations import Stations
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef
from unbend.refraction import refraction_angle
from unbend.units import Array, Integers, Mask, Names

MINIMUM_ANGLE_RAD = float(np.radians(3.0))
"""Least angle between two rays of a point that is used."""

LOWEST_GROUND_M = -600.0  # below every shore: rays that meet deeper are not straightened
SMALLEST_COSINE = 0.05  # of the nadir angle of rays that are straightened: up to 87 degrees

UNKNOWN_SIGMAS = (3.0, 3.0, 6.0, np.radians(1.0), np.radians(1.0), np.radians(3.0))
"""East, north, up [m], tilts and yaw [rad] of a station that does not say: judgement."""
LEAST_SIGMAS = (1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6)
"""The same of a station that states 0."""

NO_ROTATION = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z that stand for an unknown attitude
NEAREST_M = 1e-3  # added to distances: no point is divided by zero
RIDGE = 1e-12  # of the trace, added to normal equations of points: rays may be parallel


@dataclass(frozen=True, eq=False)
class Orientations:
    """Exterior orientation of images; (s,) arrays, NaN centres where there is none.

    ``centre_m`` (s, 3) earth-centred (WGS84); ``camera_from_ecef`` and ``enu_from_ecef``
    (s, 3, 3); ``sigma`` (s, 6) of east, north, up [m] and of rotations about these axes [rad].
    """

    camera: Names
    centre_m: Array
    camera_from_ecef: Array
    enu_from_ecef: Array
    sigma: Array

    def assigned(self, row: Integers) -> Orientations:
        """Orientations of images (k,), each that of a row, or none for -1: a hypothesis."""
        has_row = row[:, None] >= 0
        centre = np.where(has_row, self.centre_m[row], np.nan)
        return Orientations(
            camera=self.camera[row],
            centre_m=centre,
            camera_from_ecef=self.camera_from_ecef[row],
            enu_from_ecef=self.enu_from_ecef[row],
            sigma=self.sigma[row],
        )

    def turned(self, rotation: Array, camera: str) -> Orientations:
        """With one camera turned by a rotation vector [rad] in its own frame (mount angles)."""
        turn = Rotation.from_rotvec(rotation).as_matrix()
        of_camera = (self.camera == camera)[:, None, None]
        turned = np.where(of_camera, turn @ self.camera_from_ecef, self.camera_from_ecef)
        return replace(self, camera_from_ecef=turned)

    def turns_of(self, camera: str) -> Array:
        """(s, 6, 3) what a unit of `turned` is to the stations of a camera, as `sigma`."""
        change = np.zeros((self.camera.size, 6, 3))
        ecef_from_camera = np.swapaxes(self.camera_from_ecef, 1, 2)
        change[:, 3:] = self.enu_from_ecef @ ecef_from_camera
        change[self.camera != camera] = 0.0
        return change


def orientations_of(
    stations: Stations, unknown_sigmas: tuple[float, ...] = UNKNOWN_SIGMAS
) -> Orientations:
    """Orientations of stations, NaN where not ok; a sigma not stated is ``unknown_sigmas``'.

    One that is stated as 0 is 1 mm or 1 microradian: residuals are counted in units of it. Heights
    count from mean sea level where only that is known: rays meet as well.
    """
    h_ellipsoid_m = stations.h_ellipsoid_m
    h_m = np.where(np.isfinite(h_ellipsoid_m), h_ellipsoid_m, stations.h_msl_m)
    centre_m = ecef_of_geodetic(stations.lat_rad, stations.lon_rad, h_m)
    lat_rad = np.nan_to_num(stations.lat_rad)
    lon_rad = np.nan_to_num(stations.lon_rad)
    axes = enu_from_ecef(lat_rad, lon_rad)
    has_attitude = np.all(np.isfinite(stations.quaternion), axis=1)
    usable = stations.ok & has_attitude
    w_x_y_z = np.where(usable[:, None], stations.quaternion, NO_ROTATION)
    x_y_z_w = w_x_y_z[:, [1, 2, 3, 0]]
    camera_from_enu = Rotation.from_quat(x_y_z_w).as_matrix()
    sigma_of_axes = [
        stations.sigma_horizontal_m,
        stations.sigma_horizontal_m,
        stations.sigma_height_m,
        stations.sigma_tilt_rad,
        stations.sigma_tilt_rad,
        stations.sigma_yaw_rad,
    ]
    sigma = np.stack(sigma_of_axes, axis=1)
    sigma = np.where(np.isfinite(sigma), sigma, unknown_sigmas)
    return Orientations(
        camera=stations.camera,
        centre_m=np.where(usable[:, None], centre_m, np.nan),
        camera_from_ecef=camera_from_enu @ axes,
        enu_from_ecef=axes,
        sigma=np.maximum(sigma, LEAST_SIGMAS),
    )


@dataclass(frozen=True, eq=False)
class ImageRays:
    """Straight rays (r,): row of the image, number of the point, direction in the camera.

    ``direction`` (r, 3) with the camera's x right, y down, z forward, unit length;
    ``sigma_rad`` (r,) or one: the pixel's, across the ray. ``height_m`` (r,) given height of the
    point above the ellipsoid, NaN where unknown, with ``sigma_height_m``.
    """

    image: Integers
    point: Integers
    direction: Array
    sigma_rad: float | Array
    height_m: Array | None = None
    sigma_height_m: float = 1.0

    def of_points(self, points: Integers) -> ImageRays:
        """The rays of some points."""
        keep = np.isin(self.point, points)
        height_m = None
        if self.height_m is not None:
            height_m = self.height_m[keep]
        return ImageRays(
            image=self.image[keep],
            point=self.point[keep],
            direction=self.direction[keep],
            sigma_rad=np.broadcast_to(self.sigma_rad, keep.shape)[keep],
            height_m=height_m,
            sigma_height_m=self.sigma_height_m,
        )


@dataclass(frozen=True, eq=False)
class RayMisses:
    """What rays miss points by, in sigmas of their pixels, and what changes it.

    Rays that are not good have zeros.
    """

    sigma: Array  # (r,) of the rays [rad]
    miss: Array  # (r, 2)
    point_derivatives: Array  # (r, 2, 3) derivatives by the position of the point [m]
    station_derivatives: Array  # (r, 2, 6) by the errors of the station, in units of their sigmas


@dataclass(frozen=True, eq=False)
class SortedRays:
    """Rays sorted by their points: (r, ...) arrays of what does not change while points move."""

    order: Integers
    image: Integers
    index: Integers  # which point
    start: Integers  # (p,) the first ray of each point
    sigma: Array
    oriented: Mask
    centre: Array  # (r, 3) from `origin`
    direction: Array  # (r, 3) earth-centred
    across: Array  # (r, 2, 3) unit vectors along the image's x and y, across the ray
    origin: Array
    height: Array  # (p,) given, NaN where unknown
    sigma_height: float

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """(p, ...) sums over the rays of each point."""
        return np.asarray(np.add.reduceat(values, self.start, axis=0))

    @cached_property
    def squares(self) -> tuple[Array, Array]:
        """(r, 3, 3) sums of the squares of ``across``, and their products with the centres."""
        square = np.swapaxes(self.across, 1, 2) @ self.across
        return square, np.einsum("rij,rj->ri", square, self.centre)

    def positions(self, good: Mask) -> Array:
        """(p, 3) points by least squares of the angles across their good rays."""
        square, moment = self.squares
        too_few = self.sums(good * 1.0) < 2
        distance = np.ones(self.sigma.shape)
        for _ in range(3):  # the weights follow from the distances
            weight = np.where(good, (self.sigma * distance) ** -2.0, 0.0)
            normal = self.sums(weight[:, None, None] * square)
            size = np.trace(normal, axis1=1, axis2=2) + too_few
            normal += RIDGE * size[:, None, None] * np.eye(3)
            right = self.sums(weight[:, None] * moment)
            position = np.linalg.solve(normal, right[..., None])[..., 0]
            line = position[self.index] - self.centre
            distance = np.linalg.norm(line, axis=1) + NEAREST_M
        return np.asarray(position, np.float64)

    def angles(self, good: Mask) -> Array:
        """(p,) largest angle [rad] between two good rays, by going twice to the farthest."""
        no_ray = 2.0  # larger than any cosine
        reference = self.direction[self.start[self.index]]
        for _ in range(2):
            cosine = np.sum(reference * self.direction, axis=1)
            cosine = np.where(good, cosine, no_ray)
            least = np.minimum.reduceat(cosine, self.start)
            farthest = np.flatnonzero(cosine == least[self.index])
            points = np.arange(self.start.size)
            first = np.searchsorted(self.index[farthest], points)
            reference = self.direction[farthest[first]][self.index]
        largest = np.arccos(np.clip(least, -1.0, 1.0))
        return np.where(least < no_ray, largest, 0.0)

    def misses(self, orientations: Orientations, position: Array, good: Mask) -> RayMisses:
        """What good rays miss points (p, 3) by, and what changes it."""
        line = position[self.index] - self.centre
        distance = np.linalg.norm(line, axis=1) + NEAREST_M
        toward_point = line / distance[:, None]
        enu_from_ecef_of_ray = orientations.enu_from_ecef[self.image]
        sigma_of_station = orientations.sigma[self.image]
        # A rotation is linear up to the square of its angle, which is added to the pixel's sigma.
        variance = sigma_of_station[:, 3:] ** 2
        along = np.einsum("rij,rj->ri", enu_from_ecef_of_ray, toward_point) ** 2
        curved = np.sum(variance * along, axis=1) * np.sum(variance * (1.0 - along), axis=1)
        sigma = np.hypot(self.sigma, np.sqrt(curved / 8.0))
        weight = np.where(good, 1.0 / sigma, 0.0)[:, None, None]
        point_derivatives = weight * self.across / distance[:, None, None]
        turned = -np.cross(self.across, toward_point[:, None, :])  # across @ [toward_point]x
        to_enu = np.swapaxes(enu_from_ecef_of_ray, 1, 2)
        station_derivatives = np.concatenate(
            [-point_derivatives @ to_enu, (weight * turned) @ to_enu], axis=2
        )
        station_derivatives *= sigma_of_station[:, None, :]
        miss = -np.einsum("rij,rj->ri", weight * self.across, toward_point)
        return RayMisses(
            sigma=sigma,
            miss=miss,
            point_derivatives=point_derivatives,
            station_derivatives=station_derivatives,
        )


def axes_across(direction: Array) -> Array:
    """(r, 2, 3) unit vectors along the image's x and y, across rays in the camera (r, 3)."""
    x = np.array([1.0, 0.0, 0.0]) - direction[:, :1] * direction
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x /= np.maximum(length, 1e-9)
    y = np.cross(direction, x)
    return np.stack([x, y], axis=1)


def sorted_rays(orientations: Orientations, rays: ImageRays) -> SortedRays:
    """Rays by their points, under some orientations."""
    order = np.lexsort((rays.image, rays.point))
    image = rays.image[order]
    in_camera = np.nan_to_num(rays.direction[order])
    centre_m = orientations.centre_m[image]
    has_centre = np.all(np.isfinite(centre_m), axis=1)
    oriented = has_centre & np.any(in_camera != 0.0, axis=1)
    origin = np.zeros(3)
    if np.any(oriented):
        origin = centre_m[oriented].mean(axis=0)
    _, start, index = np.unique(rays.point[order], return_index=True, return_inverse=True)
    height = np.full(start.size, np.nan)
    if rays.height_m is not None:
        height = rays.height_m[order][start]
    camera_from_ecef = orientations.camera_from_ecef[image]
    return SortedRays(
        order=order,
        image=image,
        index=index,
        start=start,
        sigma=np.broadcast_to(rays.sigma_rad, image.shape)[order].astype(np.float64),
        oriented=oriented,
        centre=np.where(oriented[:, None], centre_m - origin, 0.0),
        direction=np.einsum("rji,rj->ri", camera_from_ecef, in_camera),
        across=axes_across(in_camera) @ camera_from_ecef,
        origin=origin,
        height=height,
        sigma_height=rays.sigma_height_m,
    )


@lru_cache(1)
def usual_air() -> Profile:
    """us1976 as one object, which is tabulated once."""
    return standard_atmosphere("us1976")


def straightened(orientations: Orientations, rays: ImageRays) -> ImageRays:
    """Apparent rays as the straight chords that they bend about, under some orientations.

    Refraction of us1976 (spherical, radius 6,371 km) between the heights of camera and point is
    removed: given heights, else those at which the apparent rays meet. That of a day differs by
    some 1e-5 rad at 45 degrees. What has no orientation, or no ground below it, stays.
    """
    by_point = sorted_rays(orientations, rays)
    h_c = ellipsoidal_heights(by_point.centre + by_point.origin)
    met = ellipsoidal_heights(by_point.positions(by_point.oriented) + by_point.origin)
    h_g = np.where(np.isfinite(by_point.height), by_point.height, met)[by_point.index]
    down = -orientations.enu_from_ecef[by_point.image, 2]
    cosine = np.sum(down * by_point.direction, axis=1)
    ground_below = (h_g > LOWEST_GROUND_M) & (h_g < h_c)
    bends = by_point.oriented & ground_below & (cosine > SMALLEST_COSINE)
    zeta_c = np.arccos(np.clip(cosine[bends], -1.0, 1.0))
    r_c = np.zeros(cosine.shape)
    r_c[bends] = np.nan_to_num(refraction_angle(usual_air(), h_c[bends], h_g[bends], zeta_c))
    straight = turned_toward(by_point.direction, down, cosine, r_c)

    camera_from_ecef = orientations.camera_from_ecef[by_point.image]
    as_given = np.argsort(by_point.order)
    direction = np.einsum("rij,rj->ri", camera_from_ecef, straight)[as_given]
    changed = bends[as_given]
    return replace(rays, direction=np.where(changed[:, None], direction, rays.direction))


def turned_toward(direction: Array, axis: Array, cosine: Array, angle_rad: Array) -> Array:
    """(n, 3) unit vectors turned toward an axis (n, 3), to which they have a cosine (n,)."""
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 1e-30))
    across = (axis - cosine[:, None] * direction) / sine[:, None]
    along_direction = direction * np.cos(angle_rad)[:, None]
    along_across = across * np.sin(angle_rad)[:, None]
    return along_direction + along_across


def ellipsoidal_heights(ecef_m: Array) -> Array:
    """(n,) heights above the ellipsoid [m] of earth-centred positions (n, 3)."""
    _, _, h_m = geodetic_of_ecef(*ecef_m.T)
    return h_m
