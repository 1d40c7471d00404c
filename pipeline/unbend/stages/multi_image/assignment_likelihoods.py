"""How likely an assignment of events to images is, by tie points and by positions in EXIF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from unbend.block.image_rays import ImageRays, Orientations, orientations_of, straightened
from unbend.block.intersection import Intersection, intersect, point_heights
from unbend.flight.stations import Stations
from unbend.geodesy import principal_radii
from unbend.refraction.camera.camera import Camera
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import Array, Integers, Mask

Likelihood = Callable[[Integers], float]
"""Natural logarithm of the likelihood of an assignment: (k,) rows of events, -1 for none."""

FEWEST_POINTS = 10
TIE_POINTS = 200  # 800 rays show a shift by a factor of e^3000
POINTS_AT_FIRST = 50  # whose rays rank many assignments
FEWEST_MEET = 0.5  # share of the points whose rays meet at all
POOREST_FIT = 5.0  # residuals over what the stations' sigmas say
USABLE_STATIONS = 0.9
CONTRADICTED_SHARE = 0.5  # of the rays of an image, which meet no other
FEWEST_RAYS = 4  # of an image that is judged by that share
POSITION_M = 10.0  # sigma of a position in EXIF
COMMON_M = 5.0  # and of what all share
DELAY_S = 1.0  # a receiver's last fix
OUTLIER = 25.0  # square of sigmas, beyond which a position costs no more
FEWEST_STATIONS = 3
ITERATIONS = 4  # of the robust fit of what positions share


@dataclass(frozen=True, eq=False)
class TieLikelihood:
    """Log likelihood of assignments (k,) of events to images by ``rays``, some of ``every`` one."""

    of_events: Orientations
    rays: ImageRays
    every: ImageRays

    def intersected(self, event: Integers) -> Intersection:
        """The points of the rays under an assignment."""
        orientations = self.of_events.assigned(event)
        return intersect(orientations, straightened(orientations, self.rays))

    def __call__(self, event: Integers) -> float:
        return self.intersected(event).log_likelihood if self.rays.point.size else 0.0

    def share_met(self, events: Integers) -> Array:
        """(c,) share of some points whose rays meet under assignments (c, k); more than jointly."""
        points = np.unique(self.rays.point)
        some = evenly_spaced_of(points, POINTS_AT_FIRST)
        rays = self.rays.of_points(some)
        count = self.of_events.camera.size
        assignments = events.shape[0]
        shape = assignments, rays.image.size
        # The points of each assignment are points of their own.
        point = np.searchsorted(some, rays.point) + some.size * np.arange(assignments)[:, None]
        stacked = ImageRays(
            events[:, rays.image].ravel() % (count + 1),
            point.ravel(),
            np.broadcast_to(rays.direction, (*shape, 3)).reshape(-1, 3),
            np.broadcast_to(rays.sigma_rad, shape).ravel(),
        )
        of_all = self.of_events.assigned(np.append(np.arange(count), -1))
        found = point_heights(of_all, stacked)
        return np.asarray(np.isfinite(found.h_m).reshape(assignments, -1).mean(axis=1))

    def across(self, images: Integers) -> TieLikelihood:
        """That by the points which some of the images show, and others too."""
        inside = np.isin(self.every.image, images)
        both = np.intersect1d(self.every.point[inside], self.every.point[~inside])
        return replace(self, rays=self.every.of_points(both))

    def contradicted(self, event: Integers) -> Integers:
        """The images, by their rows, half of whose rays meet those of no others."""
        orientations = self.of_events.assigned(event)
        every = self.every
        found = intersect(orientations, straightened(orientations, every))
        unused = ~found.used[np.searchsorted(found.point, every.point)]
        seen = np.bincount(every.image, minlength=event.size)
        lost = np.bincount(every.image[found.bad | unused], minlength=event.size)
        most = CONTRADICTED_SHARE * np.maximum(seen, FEWEST_RAYS)
        return np.flatnonzero((lost >= most) & np.isfinite(orientations.centre_m[:, 0]))

    def fits(self, event: Integers) -> bool:
        """Whether rays meet at all under the best assignment: else something else is wrong."""
        found = self.intersected(event)
        return bool(found.used.mean() >= FEWEST_MEET and found.sigma_factor < POOREST_FIT)


def evenly_spaced_of(values: Integers, most: int) -> Integers:
    """At most so many of some values, evenly spaced among them."""
    rows = np.unique(np.linspace(0, values.size - 1, most).astype(int))
    return np.asarray(values[rows])


def tie_likelihood(
    ties: TiePoints, images: CameraImages, camera: Camera, stations: Stations
) -> TieLikelihood | None:
    """Likelihood by the tie points of one camera; None where these or usable events are few."""
    of_camera = np.full(images.name.shape, "camera", object)
    rays = tie_rays(ties, images.name, of_camera, {"camera": camera})
    points = np.unique(rays.point)
    usable = stations.ok.sum() >= max(2.0, USABLE_STATIONS * len(stations))
    if points.size < FEWEST_POINTS or not usable:
        return None
    rays = replace(rays, height_m=None)
    some = rays.of_points(evenly_spaced_of(points, TIE_POINTS))
    return TieLikelihood(orientations_of(stations), some, rays)


@dataclass(frozen=True, eq=False)
class PositionLikelihood:
    """Log likelihood of assignments by the positions in the images.

    The positions err by 10 m each, at most five times that, and together by 5 m and a delay of
    1 s: a receiver's last fix. Along one line they decide nothing; along lines to and fro they do.

    ``written_m`` (k, 2) of the images, where they have one (``has``); ``flown_m`` and
    ``velocity_m_s`` (m, 2) of the events; north and east.
    """

    has: Mask
    written_m: Array
    flown_m: Array
    velocity_m_s: Array

    def __call__(self, event: Integers) -> float:
        rows = np.flatnonzero(self.has & (event >= 0))
        rows = rows[np.isfinite(self.flown_m[event[rows], 0])]
        off = (self.written_m[rows] - self.flown_m[event[rows]]).ravel() / POSITION_M
        # What all positions share: a delay along the way, and an offset to north and east.
        design = np.tile(np.eye(3)[1:], (rows.size, 1)) * COMMON_M / POSITION_M
        design[:, 0] = self.velocity_m_s[event[rows]].ravel() * DELAY_S / POSITION_M
        shared = np.zeros(3)
        limit = 4.0 * OUTLIER
        for _ in range(ITERATIONS):
            near = np.repeat(squares_of_pairs(off - design @ shared) < limit, 2)
            limit = OUTLIER
            normal = design[near].T @ design[near] + np.eye(3)
            shared = np.linalg.solve(normal, design[near].T @ off[near])
        left = squares_of_pairs(off - design @ shared)
        without = int(self.has.sum()) - rows.size
        cost = np.minimum(left, OUTLIER).sum() + np.square(shared).sum() + without * OUTLIER
        return -0.5 * float(cost)


def squares_of_pairs(values: Array) -> Array:
    """(n,) sums of the squares of pairs (2 n,)."""
    return np.asarray(np.square(values).reshape(-1, 2).sum(axis=1))


def position_likelihood(
    images: CameraImages, files: ImageTimes | None, stations: Stations
) -> PositionLikelihood | None:
    """Likelihood by the positions in the images; None where few images have one."""
    if files is None or len(stations) < FEWEST_STATIONS:
        return None
    position = np.append(files.position, [[np.nan] * 3], axis=0)[images.file]
    has = np.isfinite(position[:, 0])
    enough = has.sum() >= max(3.0, 0.5 * has.size)
    if not enough or stations.ok.sum() < USABLE_STATIONS * len(stations):
        return None
    latitude = np.median(stations.lat_rad[stations.ok])
    longitude = np.median(stations.lon_rad[stations.ok])
    meridian, vertical = principal_radii(np.array([latitude]))
    metres = np.array([meridian[0], vertical[0] * np.cos(latitude)])
    origin = [latitude, longitude]
    flown_m = (np.stack([stations.lat_rad, stations.lon_rad], axis=1) - origin) * metres
    seconds = np.maximum.accumulate((stations.time_ns - stations.time_ns[0]) * 1e-9)
    with np.errstate(invalid="ignore", divide="ignore"):  # pulses that repeat
        velocity = np.gradient(flown_m, seconds, axis=0)
    return PositionLikelihood(
        has=has,
        written_m=(position[:, :2] - origin) * metres,
        flown_m=flown_m,
        velocity_m_s=np.nan_to_num(velocity, posinf=0.0, neginf=0.0),
    )
