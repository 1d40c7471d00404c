"""How likely an assignment of events to images is, by tie points and by positions in EXIF."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from unbend.block.image_rays import ImageRays, Orientations, orientations_of, straightened
from unbend.block.intersection import Intersection, intersect, point_heights
from unbend.flight.stations import Stations
from unbend.geodesy import principal_radii, wrapped
from unbend.refraction.camera.camera import Camera
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.tie_points import TiePoints, tie_rays
from unbend.units import Array, Integers, Mask

Likelihood = Callable[[Integers], float]
"""Natural logarithm of the likelihood of an assignment: (k,) the row of the event of each image,
-1 for an image without an event."""

TIES = "tie points"
"""The name of the likelihood by tie points, in the evidence for an assignment."""

FEWEST_POINTS = 10  # tie points: fewer decide nothing
DECIDING_POINTS = 200  # tie points: 800 rays show a shift by a factor of e^3000
RANKING_POINTS = 50  # tie points, by which many assignments are ranked
FEWEST_MEET = 0.5  # share of the points whose rays meet at least under a right assignment
POOREST_FIT = 5.0  # residuals over their sigmas, at most under a right assignment
FEWEST_WRITTEN = 3  # images with a position: fewer decide nothing
WRITTEN_SHARE = 0.5  # of the images: so many must have a position
USABLE_STATIONS = 0.9  # share of the events that must have a usable station
CONTRADICTED_SHARE = 0.5  # an image is contradicted if so many of its rays meet no other ray
FEWEST_RAYS = 4  # an image with fewer rays is judged as if it had so many
POSITION_M = 10.0  # sigma of a position in EXIF
COMMON_M = 5.0  # sigma of an offset that all positions share
DELAY_S = 1.0  # sigma of a delay that all positions share: a receiver's last fix is as old
OUTLIER = 25.0  # squared residual in sigmas: a position costs no more
FEWEST_STATIONS = 3  # the velocity of a station needs its neighbours
ITERATIONS = 4  # of the robust fit of what positions share


def joint_likelihood(likelihoods: Iterable[Likelihood]) -> Likelihood:
    """The sum of several independent log likelihoods, as one function of an assignment (k,)."""
    parts = tuple(likelihoods)

    def of_assignment(event: Integers) -> float:
        """The sum of all parts."""
        return sum(likelihood(event) for likelihood in parts)

    return of_assignment


@dataclass(frozen=True, eq=False)
class TieLikelihood:
    """Log likelihood of assignments (k,) of events to images, by tie points.

    event_orientations : position and attitude of the camera at each event.
    rays : rays of some tie points, by which the likelihood is computed.
    all_rays : rays of all tie points.
    """

    event_orientations: Orientations
    rays: ImageRays
    all_rays: ImageRays

    def intersected(self, event: Integers) -> Intersection:
        """The points at which `rays` meet under an assignment (k,)."""
        orientations = self.event_orientations.assigned(event)
        rays = straightened(orientations, self.rays)
        return intersect(orientations, rays)

    def __call__(self, event: Integers) -> float:
        """The log likelihood of an assignment (k,); 0 without rays."""
        if self.rays.point.size == 0:
            return 0.0
        return self.intersected(event).log_likelihood

    def share_met(self, events: Integers) -> Array:
        """(c,) share of 50 points whose rays meet, for each of several assignments (c, k).

        The points are intersected one by one, so that more rays meet than in `intersected`, where
        all points share the errors of the stations.
        """
        points = evenly_spaced_of(np.unique(self.rays.point), RANKING_POINTS)
        rays = self.rays.of_points(points)
        assignment_count = events.shape[0]
        event_count = self.event_orientations.camera.size
        # One row of orientations for each event, and a last one without an orientation. An image
        # without an event (-1) takes the last row: -1 % (event_count + 1) is event_count.
        each_event = np.append(np.arange(event_count), -1)
        orientations = self.event_orientations.assigned(each_event)
        row = events[:, rays.image] % (event_count + 1)
        # Each assignment has point numbers of its own, so that its rays meet only each other.
        first_point = points.size * np.arange(assignment_count)
        point_number = np.searchsorted(points, rays.point)
        point = point_number + first_point[:, None]
        sigma_rad = np.broadcast_to(rays.sigma_rad, point.shape)
        stacked = ImageRays(
            image=row.ravel(),
            point=point.ravel(),
            direction=np.tile(rays.direction, (assignment_count, 1)),
            sigma_rad=sigma_rad.ravel(),
        )
        heights_m = point_heights(orientations, stacked).h_m
        heights_of_assignments = heights_m.reshape(assignment_count, -1)
        return np.asarray(np.isfinite(heights_of_assignments).mean(axis=1))

    def across(self, images: Integers) -> TieLikelihood:
        """The likelihood by the tie points that appear in ``images`` and in other images too.

        ``images`` are rows of the images.
        """
        rays = self.all_rays
        is_inside = np.isin(rays.image, images)
        points_inside = rays.point[is_inside]
        points_outside = rays.point[~is_inside]
        shared = np.intersect1d(points_inside, points_outside)
        return replace(self, rays=rays.of_points(shared))

    def contradicted(self, event: Integers) -> Integers:
        """Rows of the images whose rays do not fit the other images under an assignment (k,).

        At least half of the rays of such an image, and at least two, meet no ray of another image.
        Images without an orientation are left out.
        """
        orientations = self.event_orientations.assigned(event)
        rays = self.all_rays
        intersection = intersect(orientations, straightened(orientations, rays))
        row_of_point = np.searchsorted(intersection.point, rays.point)
        is_point_used = intersection.used[row_of_point]
        is_lost = intersection.bad | ~is_point_used
        ray_count = np.bincount(rays.image, minlength=event.size)
        lost_count = np.bincount(rays.image[is_lost], minlength=event.size)
        limit = CONTRADICTED_SHARE * np.maximum(ray_count, FEWEST_RAYS)
        is_contradicted = lost_count >= limit
        has_orientation = np.isfinite(orientations.centre_m[:, 0])
        return np.flatnonzero(is_contradicted & has_orientation)

    def fits(self, event: Integers) -> bool:
        """Whether rays meet under the best assignment (k,), as they should under a right one.

        If not, something else than the assignment is wrong, and tie points decide nothing.
        """
        intersection = self.intersected(event)
        share_met = intersection.used.mean()
        if share_met < FEWEST_MEET:
            return False
        return bool(intersection.sigma_factor < POOREST_FIT)


def evenly_spaced_of(values: Integers, most: int) -> Integers:
    """At most ``most`` of ``values`` (n,), evenly spaced, with the first and the last."""
    evenly = np.linspace(0, values.size - 1, most)
    rows = np.unique(evenly.astype(int))
    return np.asarray(values[rows])


def tie_likelihood(
    ties: TiePoints, images: CameraImages, camera: Camera, stations: Stations
) -> TieLikelihood | None:
    """The likelihood by the tie points of one camera; None with few points or few usable stations.

    ``stations`` are those of all events of the camera, in the order of the events.
    """
    camera_of_image = np.full(images.name.shape, "camera", object)  # any name: there is only one
    rays = tie_rays(ties, images.name, camera_of_image, {"camera": camera})
    points = np.unique(rays.point)
    if points.size < FEWEST_POINTS:
        return None
    needed = max(2.0, USABLE_STATIONS * len(stations))  # a point needs two stations
    if stations.ok.sum() < needed:
        return None
    all_rays = replace(rays, height_m=None)
    deciding_points = evenly_spaced_of(points, DECIDING_POINTS)
    return TieLikelihood(
        event_orientations=orientations_of(stations),
        rays=all_rays.of_points(deciding_points),
        all_rays=all_rays,
    )


@dataclass(frozen=True, eq=False)
class PositionLikelihood:
    """Log likelihood of assignments (k,) of events to images, by the positions in EXIF.

    A position has a sigma of 10 m; an error beyond five sigmas costs as much as one of five sigmas.
    All positions share an offset with a sigma of 5 m to north and to east, and a delay with a sigma
    of 1 s, because a receiver writes its last fix. Along one line of flight positions therefore
    decide nothing; along lines to and fro they do.

    is_written : (k,) which images have a position in EXIF.
    written_m : (k, 2) that position, north and east.
    flown_m, velocity_m_s : (m, 2) position and velocity of the camera at each event, north and
        east.
    """

    is_written: Mask
    written_m: Array
    flown_m: Array
    velocity_m_s: Array

    def __call__(self, event: Integers) -> float:
        """The log likelihood of an assignment (k,), at the likeliest common offset and delay."""
        has_event = event >= 0
        rows = np.flatnonzero(self.is_written & has_event)
        north_m = self.flown_m[event[rows], 0]
        rows = rows[np.isfinite(north_m)]
        # Residuals (2 n,), in sigmas of a position: north and east of the first image, then of the
        # next. Their derivatives (2 n, 3) are by the errors that all positions share, each in its
        # own sigmas: delay, offset to the north, offset to the east.
        events = event[rows]
        difference_m = self.written_m[rows] - self.flown_m[events]
        residual = difference_m.ravel() / POSITION_M
        design = np.zeros((rows.size, 2, 3))
        moved_m = self.velocity_m_s[events] * DELAY_S
        design[:, :, 0] = moved_m / POSITION_M
        design[:, 0, 1] = COMMON_M / POSITION_M
        design[:, 1, 2] = COMMON_M / POSITION_M
        design = design.reshape(-1, 3)
        shared = shared_errors(residual, design)
        remaining = squares_of_pairs(residual - design @ shared)
        cost_of_positions = np.minimum(remaining, OUTLIER).sum()
        cost_of_shared = np.square(shared).sum()
        # The position of an image without an event, or with an event at an unknown place, costs as
        # much as an outlier: otherwise the assignment with the fewest events would be likeliest.
        written_count = int(self.is_written.sum())
        without_event = written_count - rows.size
        cost = cost_of_positions + cost_of_shared + without_event * OUTLIER
        return -0.5 * float(cost)


def shared_errors(residual: Array, design: Array) -> Array:
    """(3,) errors that all positions share, each in its own sigmas, fitted without outliers.

    ``residual`` (2 n,) has north and east of each position in turn, in sigmas of a position;
    ``design`` (2 n, 3) has its derivatives by the shared errors. Least squares, in which each
    shared error is also observed to be 0 with a sigma of 1.
    """
    shared = np.zeros(3)
    limit = 4.0 * OUTLIER  # at first, before anything is fitted
    for _ in range(ITERATIONS):
        squares = squares_of_pairs(residual - design @ shared)
        is_near = np.repeat(squares < limit, 2)
        limit = OUTLIER
        normal = design[is_near].T @ design[is_near] + np.eye(3)  # 1 for each observed 0
        right_side = design[is_near].T @ residual[is_near]
        shared = np.asarray(np.linalg.solve(normal, right_side), np.float64)
    return shared


def squares_of_pairs(values: Array) -> Array:
    """(n,) sums of the squares of each two successive ``values`` (2 n,)."""
    pairs = np.square(values).reshape(-1, 2)
    return np.asarray(pairs.sum(axis=1))


def position_likelihood(
    images: CameraImages, files: ImageTimes | None, stations: Stations
) -> PositionLikelihood | None:
    """The likelihood by positions in EXIF; None if few images or few events have a position.

    ``stations`` are those of all events of the camera, in the order of the events; ``files`` has
    the positions, if image files are known. Metres count from the median latitude and the first
    longitude of the stations.
    """
    if files is None or len(stations) < FEWEST_STATIONS:
        return None
    # The last element is for an image without a file, whose row is -1.
    position_of_file = np.append(files.position, [[np.nan] * 3], axis=0)
    position = position_of_file[images.file]
    is_written = np.isfinite(position[:, 0])
    needed = max(FEWEST_WRITTEN, WRITTEN_SHARE * is_written.size)
    if is_written.sum() < needed:
        return None
    if stations.ok.sum() < USABLE_STATIONS * len(stations):
        return None
    is_ok = stations.ok
    latitude = np.median(stations.lat_rad[is_ok])
    longitude = stations.lon_rad[is_ok][0]
    meridian, prime_vertical = principal_radii(np.array([latitude]))
    metres_per_rad = np.array([meridian[0], prime_vertical[0] * np.cos(latitude)])

    def local_m(lat_rad: Array, lon_rad: Array) -> Array:
        """(n, 2) metres to the north and east of the origin, also across 180 degrees."""
        north_rad = lat_rad - latitude
        east_rad = wrapped(lon_rad - longitude)
        from_origin = np.stack([north_rad, east_rad], axis=1)
        return np.asarray(from_origin * metres_per_rad)

    flown_m = local_m(stations.lat_rad, stations.lon_rad)
    written_m = local_m(position[:, 0], position[:, 1])
    # Where times repeat or fall back no time passes, and the velocity counts as zero.
    seconds = np.maximum.accumulate((stations.time_ns - stations.time_ns[0]) * 1e-9)
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity = np.gradient(flown_m, seconds, axis=0)
    return PositionLikelihood(
        is_written=is_written,
        written_m=written_m,
        flown_m=flown_m,
        velocity_m_s=np.nan_to_num(
            velocity,
            posinf=0.0,
            neginf=0.0,
        ),
    )
