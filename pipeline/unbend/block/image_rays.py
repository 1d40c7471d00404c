"""Rays of image points, sorted by their points, and the points where they meet.

From the exterior orientations of images and their straight rays: positions of the points (least
squares of the angles across the rays), the misses (angles between a ray and its point), and the
derivatives of the misses.

Shapes: s stations (images), r rays, p points.
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
"""A point is used if two of its rays have at least this angle."""

LOWEST_GROUND_M = -600.0  # below every shore: rays that meet deeper are not straightened
SMALLEST_COSINE = 0.05  # of the nadir angle: rays beyond 87 degrees are not straightened

UNKNOWN_SIGMAS = (3.0, 3.0, 6.0, np.radians(1.0), np.radians(1.0), np.radians(3.0))
"""Of a station without sigmas, by judgement: east, north, up [m], two tilts and yaw [rad]."""
LEAST_SIGMAS = (1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6)
"""Lower limits of the same, for a station that states 0: misses are divided by sigmas."""

NO_ROTATION = (1.0, 0.0, 0.0, 0.0)  # w, x, y, z in the place of an unknown attitude
NEAREST_M = 1e-3  # added to distances, so that none is zero
RIDGE = 1e-12  # of the trace, added to the diagonal of normal equations: rays may be parallel


@dataclass(frozen=True, eq=False)
class Orientations:
    """Exterior orientations of images."""

    camera: Names  # (s,)
    centre_m: Array  # (s, 3) projection centres, earth-centred (WGS84); NaN without orientation
    camera_from_ecef: Array  # (s, 3, 3) to the camera: x right, y down, z forward
    enu_from_ecef: Array  # (s, 3, 3) to east, north, up at the image
    sigma: Array  # (s, 6) of east, north, up [m], and of rotations about these axes [rad]

    def assigned(self, row: Integers) -> Orientations:
        """Orientations (k,) taken from the rows ``row`` (k,) of this; none where a row is -1."""
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
        """The orientations with one camera turned by a rotation vector (3,) [rad] in its frame."""
        turn = Rotation.from_rotvec(rotation).as_matrix()
        of_camera = (self.camera == camera)[:, None, None]
        turned = np.where(of_camera, turn @ self.camera_from_ecef, self.camera_from_ecef)
        return replace(self, camera_from_ecef=turned)

    def turns_of(self, camera: str) -> Array:
        """(s, 6, 3) change of each station, along the axes of ``sigma``, if a camera is turned.

        Column i is the change by 1 rad about axis i of the camera (`turned`); 0 for other cameras.
        """
        change = np.zeros((self.camera.size, 6, 3))
        ecef_from_camera = np.swapaxes(self.camera_from_ecef, 1, 2)
        change[:, 3:] = self.enu_from_ecef @ ecef_from_camera
        change[self.camera != camera] = 0.0
        return change


def orientations_of(
    stations: Stations, unknown_sigmas: tuple[float, ...] = UNKNOWN_SIGMAS
) -> Orientations:
    """Orientations of stations; none (NaN centres) for stations that are not ok.

    Sigmas that are not stated are ``unknown_sigmas`` (6,), in the order of `UNKNOWN_SIGMAS`; all
    are at least `LEAST_SIGMAS`. Where only heights above mean sea level are known, they are used in
    the place of ellipsoidal ones: the rays meet as well.
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
    """Rays of image points, in any order."""

    image: Integers  # (r,) row of the image in `Orientations`
    point: Integers  # (r,) number of the point
    direction: Array  # (r, 3) unit vectors in the camera: x right, y down, z forward
    sigma_rad: float | Array  # (r,) or one: of a pixel, across the ray
    height_m: Array | None = None  # (r,) given height of the point above the ellipsoid, or NaN
    sigma_height_m: float = 1.0  # of a given height

    def of_points(self, points: Integers) -> ImageRays:
        """The rays of some points, by the numbers of these."""
        return self.rows(np.isin(self.point, points))

    def rows(self, keep: Mask) -> ImageRays:
        """The rays that a mask (r,) selects."""
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
    """Angles between rays and their points along x and y, in sigmas, and their derivatives.

    Rays that are not good have zeros.
    """

    sigma: Array  # (r,) of the rays across [rad]
    miss: Array  # (r, 2) ray minus direction to the point
    point_derivatives: Array  # (r, 2, 3) derivatives by the position of the point [m]
    station_derivatives: Array  # (r, 2, 6) by the errors of the station, in units of their sigmas


@dataclass(frozen=True, eq=False)
class SortedRays:
    """Rays sorted by their points, with all that does not change while points move."""

    order: Integers  # (r,) row of the sorted rays in `ImageRays`
    image: Integers  # (r,) row of the image in `Orientations`
    index: Integers  # (r,) row of the point, 0 to p - 1
    start: Integers  # (p,) row of the first ray of each point
    sigma: Array  # (r,) of the pixel, across the ray [rad]
    oriented: Mask  # (r,) the image has an orientation, and the ray a direction
    centre: Array  # (r, 3) projection centre minus ``origin`` [m], earth-centred axes
    direction: Array  # (r, 3) unit vectors, earth-centred axes
    across: Array  # (r, 2, 3) unit vectors along the image's x and y, across the ray
    origin: Array  # (3,) mean of the projection centres [m], earth-centred
    height: Array  # (p,) given height above the ellipsoid [m], NaN where unknown
    sigma_height: float  # of a given height [m]

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """(p, ...) sums of values (r, ...) over the rays of each point."""
        return np.asarray(np.add.reduceat(values, self.start, axis=0))

    @cached_property
    def squares(self) -> tuple[Array, Array]:
        """(r, 3, 3) A'A of each ray, with A = ``across``, and (r, 3) A'A times the centre."""
        square = np.swapaxes(self.across, 1, 2) @ self.across
        return square, np.einsum("rij,rj->ri", square, self.centre)

    def positions(self, good: Mask) -> Array:
        """(p, 3) positions minus ``origin`` [m] that miss the good rays least (least squares).

        Angles across the rays are minimised. The position of a point with fewer than two good rays
        has no meaning.
        """
        square, moment = self.squares
        too_few = self.sums(good * 1.0) < 2
        distance = np.ones(self.sigma.shape)
        for _ in range(3):  # weights depend on the distances of the points
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
        """(p,) about the largest angle [rad] between two good rays of each point; 0 without any.

        It is the angle of the ray that is farthest from the first one to the ray that is farthest
        from that.
        """
        no_ray = 2.0  # larger than any cosine
        reference = self.direction[self.start[self.index]]
        for _ in range(2):
            cosine = np.sum(reference * self.direction, axis=1)
            cosine = np.where(good, cosine, no_ray)
            least = np.minimum.reduceat(cosine, self.start)
            farthest = np.flatnonzero(cosine == least[self.index])
            points = np.arange(self.start.size)
            one_of_point = np.searchsorted(self.index[farthest], points)
            reference = self.direction[farthest[one_of_point]][self.index]
        largest = np.arccos(np.clip(least, -1.0, 1.0))
        return np.where(least < no_ray, largest, 0.0)

    def misses(self, orientations: Orientations, position: Array, good: Mask) -> RayMisses:
        """Misses of the good rays at points (p, 3), given minus ``origin`` [m]."""
        line = position[self.index] - self.centre
        distance = np.linalg.norm(line, axis=1) + NEAREST_M
        toward_point = line / distance[:, None]
        enu_from_ecef_of_ray = orientations.enu_from_ecef[self.image]
        sigma_of_station = orientations.sigma[self.image]
        # In second order a rotation w turns a ray d by (w d) w / 2 across: along each of two axes
        # its variance is 1/8 of the variances of w along and across d. It is added to the pixel's.
        variance = sigma_of_station[:, 3:] ** 2
        cosine2 = np.einsum("rij,rj->ri", enu_from_ecef_of_ray, toward_point) ** 2
        product = np.sum(variance * cosine2, axis=1) * np.sum(variance * (1.0 - cosine2), axis=1)
        sigma = np.hypot(self.sigma, np.sqrt(product / 8.0))
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
    """(r, 2, 3) unit vectors across rays in the camera (r, 3), nearest to the image's x and y."""
    x = np.array([1.0, 0.0, 0.0]) - direction[:, :1] * direction
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x /= np.maximum(length, 1e-9)
    y = np.cross(direction, x)
    return np.stack([x, y], axis=1)


def sorted_rays(orientations: Orientations, rays: ImageRays) -> SortedRays:
    """Rays sorted by the numbers of their points, then by images, with their orientations."""
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
    """The standard atmosphere us1976; always the same object, so that it is tabulated once."""
    return standard_atmosphere("us1976")


def straightened(orientations: Orientations, rays: ImageRays) -> ImageRays:
    """Apparent rays turned to the straight chords from camera to point.

    The refraction of us1976 (spherical, radius 6,371 km) between the heights of camera and point is
    removed; refraction on a day differs from it by some 1e-5 rad at 45 degrees. Points without a
    given height have that at which the apparent rays meet. Rays without an orientation, or without
    ground below, stay as they are.
    """
    by_point = sorted_rays(orientations, rays)
    h_c = ellipsoidal_heights(by_point.centre + by_point.origin)
    h_met = ellipsoidal_heights(by_point.positions(by_point.oriented) + by_point.origin)
    h_g = np.where(np.isfinite(by_point.height), by_point.height, h_met)[by_point.index]
    down = -orientations.enu_from_ecef[by_point.image, 2]
    cosine = np.sum(down * by_point.direction, axis=1)
    ground_below = (h_g > LOWEST_GROUND_M) & (h_g < h_c)
    is_bent = by_point.oriented & ground_below & (cosine > SMALLEST_COSINE)
    zeta_c = np.arccos(np.clip(cosine[is_bent], -1.0, 1.0))
    r_c = np.zeros(cosine.shape)
    r_c[is_bent] = np.nan_to_num(refraction_angle(usual_air(), h_c[is_bent], h_g[is_bent], zeta_c))
    straight = turned_toward(by_point.direction, down, cosine, r_c)

    camera_from_ecef = orientations.camera_from_ecef[by_point.image]
    as_given = np.argsort(by_point.order)  # from the sorted order to that of ``rays``
    direction = np.einsum("rij,rj->ri", camera_from_ecef, straight)[as_given]
    changed = is_bent[as_given]
    return replace(rays, direction=np.where(changed[:, None], direction, rays.direction))


def turned_toward(direction: Array, axis: Array, cosine: Array, angle_rad: Array) -> Array:
    """(n, 3) unit vectors ``direction`` turned by ``angle_rad`` (n,) toward unit vectors ``axis``.

    ``cosine`` (n,) is that of the angle between both.
    """
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 1e-30))
    across = (axis - cosine[:, None] * direction) / sine[:, None]
    along_direction = direction * np.cos(angle_rad)[:, None]
    along_across = across * np.sin(angle_rad)[:, None]
    return along_direction + along_across


def ellipsoidal_heights(ecef_m: Array) -> Array:
    """(n,) heights above the ellipsoid [m] of earth-centred positions (n, 3)."""
    _, _, h_m = geodetic_of_ecef(*ecef_m.T)
    return h_m
