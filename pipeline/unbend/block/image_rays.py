"""Rays of image points, sorted by their points: what does not change while points move.

Exterior orientations of images and the straight rays that they measured become positions of the
points (least squares of the angles across the rays), and derivatives of what the rays miss them by.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unbend.atmosphere import standard_atmosphere
from unbend.flight.stations import Stations
from unbend.geodesy import ecef_of_geodetic, enu_from_ecef, geodetic_of_ecef
from unbend.refraction import refraction_angle
from unbend.units import Array, Integers, Mask, Names

MINIMUM_ANGLE_RAD = float(np.radians(3.0))
"""Least angle between two rays of a point that is used."""

_LOWEST_GROUND_M = -600.0
_standard_atmosphere = lru_cache(1)(standard_atmosphere)

UNKNOWN_SIGMAS = (3.0, 3.0, 6.0, np.radians(1.0), np.radians(1.0), np.radians(3.0))
"""East, north, up [m], tilts and yaw [rad] of a station that does not say: judgement."""
_LEAST_SIGMAS = (1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6)


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
        camera, centre, *rest = (getattr(self, field.name)[row] for field in fields(self))
        return Orientations(camera, np.where(row[:, None] >= 0, centre, np.nan), *rest)

    def turned(self, rotation: Array, camera: str) -> Orientations:
        """With one camera turned by a rotation vector [rad] in its own frame (mount angles)."""
        turn = Rotation.from_rotvec(rotation).as_matrix()
        own = (self.camera == camera)[:, None, None]
        turned = np.where(own, turn @ self.camera_from_ecef, self.camera_from_ecef)
        return replace(self, camera_from_ecef=turned)

    def turns_of(self, camera: str) -> Array:
        """(s, 6, 3) what a unit of `turned` is to the stations of a camera, as `sigma`."""
        change = np.zeros((self.camera.size, 6, 3))
        change[:, 3:] = self.enu_from_ecef @ np.swapaxes(self.camera_from_ecef, 1, 2)
        change[self.camera != camera] = 0.0
        return change


def orientations_of(
    stations: Stations, unknown_sigmas: tuple[float, ...] = UNKNOWN_SIGMAS
) -> Orientations:
    """Orientations of stations, NaN where not ok; a sigma not stated is ``unknown_sigmas``'.

    One that is stated as 0 is 1 mm or 1 microradian: residuals are counted in units of it. Heights
    count from mean sea level where only that is known: rays meet as well.
    """
    lat, lon, h = stations.lat_rad, stations.lon_rad, stations.h_ellipsoid_m
    centre = ecef_of_geodetic(lat, lon, np.where(np.isfinite(h), h, stations.h_msl_m))
    axes = enu_from_ecef(np.nan_to_num(lat), np.nan_to_num(lon))
    usable = stations.ok & np.all(np.isfinite(stations.quaternion), axis=1)
    q = np.where(usable[:, None], stations.quaternion, [1.0, 0.0, 0.0, 0.0])
    tilt, horizontal = stations.sigma_tilt_rad, stations.sigma_horizontal_m
    level = [horizontal, horizontal, stations.sigma_height_m]
    sigma = np.stack([*level, tilt, tilt, stations.sigma_yaw_rad], axis=1)
    return Orientations(
        camera=stations.camera,
        centre_m=np.where(usable[:, None], centre, np.nan),
        camera_from_ecef=Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() @ axes,
        enu_from_ecef=axes,
        sigma=np.maximum(np.where(np.isfinite(sigma), sigma, unknown_sigmas), _LEAST_SIGMAS),
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
        image, point = self.image[keep], self.point[keep]
        sigma = np.broadcast_to(self.sigma_rad, keep.shape)[keep]
        height = None if self.height_m is None else self.height_m[keep]
        return ImageRays(image, point, self.direction[keep], sigma, height, self.sigma_height_m)


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
        distance, (square, moment) = np.ones(self.sigma.shape), self.squares
        few = self.sums(good * 1.0) < 2
        for _ in range(3):
            weight = np.where(good, (self.sigma * distance) ** -2.0, 0.0)
            normal = self.sums(weight[:, None, None] * square)
            size = np.trace(normal, axis1=1, axis2=2) + few
            normal += 1e-12 * size[:, None, None] * np.eye(3)
            right = self.sums(weight[:, None] * moment)
            position = np.linalg.solve(normal, right[..., None])[..., 0]
            distance = np.linalg.norm(position[self.index] - self.centre, axis=1) + 1e-3
        return np.asarray(position, np.float64)

    def angles(self, good: Mask) -> Array:
        """(p,) largest angle [rad] between two good rays, by going twice to the farthest."""
        reference = self.direction[self.start[self.index]]
        for _ in range(2):
            cosine = np.where(good, np.sum(reference * self.direction, axis=1), 2.0)
            least = np.minimum.reduceat(cosine, self.start)
            farthest = np.flatnonzero(cosine == least[self.index])
            ray = farthest[np.searchsorted(self.index[farthest], np.arange(self.start.size))]
            reference = self.direction[ray][self.index]
        return np.where(least < 2.0, np.arccos(np.clip(least, -1.0, 1.0)), 0.0)

    def derivatives(
        self, o: Orientations, position: Array, good: Mask
    ) -> tuple[Array, Array, Array, Array]:
        """What good rays miss points by, in sigmas of their pixels, and what changes it.

        Returns the sigmas (r,) [rad], and the derivatives by the point (r, 2, 3) [m] and by the
        errors of the station (r, 2, 6) in units of their sigmas, and the misses (r, 2).
        """
        line = position[self.index] - self.centre
        distance = np.linalg.norm(line, axis=1) + 1e-3
        u = line / distance[:, None]
        # A rotation is linear up to the square of its angle, which is added to the pixel's sigma.
        enu, angles = o.enu_from_ecef[self.image], o.sigma[self.image, 3:] ** 2
        along = np.einsum("rij,rj->ri", enu, u) ** 2
        curved = np.sum(angles * along, axis=1) * np.sum(angles * (1.0 - along), axis=1)
        curved = np.sqrt(curved / 8.0)
        sigma = np.hypot(self.sigma, curved)
        weight = np.where(good, 1.0 / sigma, 0.0)[:, None, None]
        A = weight * self.across / distance[:, None, None]
        turned = -np.cross(self.across, u[:, None, :])  # across @ [u]x
        to_enu = np.swapaxes(enu, 1, 2)
        J = np.concatenate([-A @ to_enu, (weight * turned) @ to_enu], axis=2)
        J *= o.sigma[self.image, None, :]
        return sigma, A, J, -np.einsum("rij,rj->ri", weight * self.across, u)


def axes_across(direction: Array) -> Array:
    """(r, 2, 3) unit vectors along the image's x and y, across rays in the camera (r, 3)."""
    x = np.array([1.0, 0.0, 0.0]) - direction[:, :1] * direction
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    return np.stack([x, np.cross(direction, x)], axis=1)


def sorted_rays(o: Orientations, rays: ImageRays) -> SortedRays:
    """Rays by their points, under some orientations."""
    order = np.lexsort((rays.image, rays.point))
    image, d = rays.image[order], np.nan_to_num(rays.direction[order])
    oriented = np.all(np.isfinite(o.centre_m[image]), axis=1) & np.any(d != 0.0, axis=1)
    _, start, index = np.unique(rays.point[order], return_index=True, return_inverse=True)
    rotation = o.camera_from_ecef[image]
    origin = o.centre_m[image][oriented].mean(axis=0) if np.any(oriented) else np.zeros(3)
    height = np.full(start.size, np.nan)
    if rays.height_m is not None:
        height = rays.height_m[order][start]
    return SortedRays(
        order, image, index, start, oriented=oriented,
        sigma=np.broadcast_to(rays.sigma_rad, image.shape)[order].astype(np.float64),
        centre=np.where(oriented[:, None], o.centre_m[image] - origin, 0.0),
        direction=np.einsum("rji,rj->ri", rotation, d),
        across=axes_across(d) @ rotation,
        origin=origin, height=height, sigma_height=rays.sigma_height_m,
    )  # fmt: skip


def straightened(o: Orientations, rays: ImageRays) -> ImageRays:
    """Apparent rays as the straight chords that they bend about, under some orientations.

    Refraction of us1976 (spherical, radius 6,371 km) between the heights of camera and point is
    removed: given heights, else those at which the apparent rays meet. That of a day differs by
    some 1e-5 rad at 45 degrees. What has no orientation, or no ground below it, stays.
    """
    r = sorted_rays(o, rays)
    h_c = geodetic_of_ecef(*(r.centre + r.origin).T)[2]
    height = geodetic_of_ecef(*(r.positions(r.oriented) + r.origin).T)[2]
    h_g = np.where(np.isfinite(r.height), r.height, height)[r.index]
    down = -o.enu_from_ecef[r.image, 2]
    cosine = np.sum(down * r.direction, axis=1)
    able = r.oriented & (h_g > _LOWEST_GROUND_M) & (h_g < h_c) & (cosine > 0.05)
    bend, size = np.zeros(cosine.shape), np.sqrt(np.maximum(1.0 - cosine**2, 1e-30))
    air = _standard_atmosphere("us1976")  # one object, which is tabulated once
    angle = np.arccos(np.clip(cosine[able], -1.0, 1.0))
    bend[able] = np.nan_to_num(refraction_angle(air, h_c[able], h_g[able], angle))
    toward = (down - cosine[:, None] * r.direction) / size[:, None]
    straight = r.direction * np.cos(bend)[:, None] + toward * np.sin(bend)[:, None]
    direction = np.empty(rays.direction.shape)
    direction[r.order] = np.einsum("rij,rj->ri", o.camera_from_ecef[r.image], straight)
    kept = np.zeros(able.shape, np.bool_)
    kept[r.order] = able
    return replace(rays, direction=np.where(kept[:, None], direction, rays.direction))
