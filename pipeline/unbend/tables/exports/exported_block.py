"""The block of a run as a bundle adjustment starts from it: stations, image and object points.

All are in one Cartesian frame: x east, y north, z up at its origin. Nothing is projected to a map,
and no earth curvature is applied.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from unbend.block.image_rays import MINIMUM_ANGLE_RAD
from unbend.flight.rotations import matrices_of
from unbend.flight.stations import Stations
from unbend.geodesy import enu_from_ecef
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import straight_reach
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import NO_PROGRESS, ExportProgress, FinishedRun
from unbend.tables.exports.export_frames import can_be_placed
from unbend.tables.exports.footprints import StationsInFrame, placed_stations, stations_in_one_frame
from unbend.units import Array, Integers, Mask, Names

EARTH_RADIUS_M = 6.371e6  # for the distance to the ground, which only weights the rays

_COLUMNS = ["point", "x_corrected_px", "y_corrected_px", "h_g_m", "status"]
_SCHEMA = pa.schema(
    {
        "image": pa.int32(),
        "point": pa.string(),
        "x_corrected_px": pa.float64(),
        "y_corrected_px": pa.float64(),
        "h_g_m": pa.float64(),
    }
)


class ImagePointsByPoint(NamedTuple):
    """Image points (r,) of a block, sorted by their points (p,).

    Those of the k-th point are entries ``begin[k]`` to ``begin[k + 1]``, in the order of images.
    ``image_point`` (r,) is the number of the image point in the block, ``image`` (r,) that of its
    image, ``number_in_image`` (r,) counts from 0 in each image. ``begin`` is (p + 1,).
    """

    image_point: Integers
    begin: Integers
    image: Integers
    number_in_image: Integers


@dataclass(frozen=True, eq=False)
class ExportedBlock:
    """Images (n,), their image points (r,) image by image, and points (p,).

    ``image`` (n,) are the names of the images, ``camera`` (n,) their numbers in ``cameras``,
    ``frame`` has their projection centres; ``rotation`` (n, 3, 3) turns from the frame to the
    camera. The image points of the i-th image are ``first_image_point[i]`` to
    ``first_image_point[i + 1]``, in the order of the run. ``x_px``, ``y_px`` (r,) are free of
    refraction, in COLMAP's pixels; ``point`` (r,) is the number of the point.

    ``point_name`` (p,) are the names of the points, ``images_of_point`` (p,) in how many images
    each was measured. Points of several images come first: ``point_m`` (t, 3) are the positions of
    these, where their rays meet, or else end on the ground; (0, 3) for a format without object
    points.
    """

    cameras: dict[str, Camera]
    image: Names
    camera: Integers
    frame: StationsInFrame
    rotation: Array
    first_image_point: Integers
    point: Integers
    x_px: Array
    y_px: Array
    point_name: pa.StringArray
    images_of_point: Integers
    point_m: Array
    progress: ExportProgress = NO_PROGRESS

    def images(self) -> Iterator[tuple[int, Camera, slice]]:
        """The number from 0, the camera and the slice of image points of each image."""
        cameras = [*self.cameras.values()]
        first = self.first_image_point.tolist()
        self.progress.start("images of the block", self.camera.size)
        for image, number in enumerate(self.camera.tolist()):
            image_points = slice(first[image], first[image + 1])
            yield image, cameras[number], image_points
            self.progress.advance(1)

    def image_points_by_point(self) -> ImagePointsByPoint:
        """The image points, sorted by their points."""
        order = np.argsort(self.point, kind="stable")
        image = np.repeat(np.arange(self.image.size), np.diff(self.first_image_point))[order]
        return ImagePointsByPoint(
            image_point=order,
            begin=np.append(0, np.cumsum(self.images_of_point)),
            image=image,
            number_in_image=order - self.first_image_point[image],
        )

    @property
    def translation_m(self) -> Array:
        """(n, 3) translations t: R X + t brings a position X in the frame to the camera's axes."""
        return np.asarray(-np.einsum("nij,nj->ni", self.rotation, self.frame.position_m))


def ideal_coordinates(
    camera: Camera,
    x_px: Array,
    y_px: Array,
) -> tuple[Array, Array]:
    """Image coordinates u, v (n,) without distortion, in units of the principal distance.

    NaN where the distortion cannot be inverted. Corrected points may be a little outside the image:
    the camera is extended by an image on each side, because `Camera.rays` covers only the image.
    """
    width = camera.width_px
    height = camera.height_px
    wider_camera = replace(
        camera,
        width_px=3 * width,
        height_px=3 * height,
        cx_px=camera.cx_px + width,
        cy_px=camera.cy_px + height,
    )
    u, v, _ = wider_camera.rays(x_px + width, y_px + height)
    return u, v


def refuse_names(
    names: Iterable[str],
    pattern: str,
    program: str,
) -> None:
    """Refuse (MissionError EXPORT-NAMES) a name in which the regular expression matches.

    ``pattern`` is for characters that separate columns in files of ``program``.
    """
    for name in names:
        if re.search(pattern, name) is None:
            continue
        raise messages.name_with_separator(where="observations", name=name, program=program)


def block_of(
    run: FinishedRun,
    ledger: Ledger,
    *,
    intersect: bool = True,
    names_origin_on_ellipsoid: bool = False,
) -> ExportedBlock:
    """The block of a run, in one pass over its parts; in memory some 70 bytes an observation.

    ``intersect`` : compute object points; False for formats without them.
    ``names_origin_on_ellipsoid`` : the note on the frame (EXPORT-FRAME) names the origin at height
    0, because the writer adds its height to z. The block is the same.

    Left out as losses (EXPORT-LEFT-OUT) are images without a usable station with their
    observations, observations of another status than ok, and repeated observations of a point in an
    image. Refuses (MissionError) a run without a placed station (EXPORT-NO-STATIONS), and stations
    of a camera that the run does not define (EXPORT-CAMERA).
    """
    rows = _stations_of_block(run, ledger)
    stations = run.stations
    frame = stations_in_one_frame(run, rows)
    points = read_image_points(run, rows, ledger)
    camera_names = list(dict.fromkeys(stations.camera[rows]))
    number_of_camera = {name: number for number, name in enumerate(camera_names)}
    images_of_point = np.bincount(points.point, minlength=len(points.name))
    point_order = np.argsort(images_of_point < 2, kind="stable")  # points of several images first
    object_points = int(np.sum(images_of_point > 1)) if intersect else 0
    block = ExportedBlock(
        cameras={name: run.cameras[name].camera for name in camera_names},
        image=stations.image[rows],
        camera=np.array([number_of_camera[name] for name in stations.camera[rows]]),
        frame=frame,
        rotation=matrices_of(frame.quaternion),
        first_image_point=np.searchsorted(points.image, np.arange(rows.size + 1)),
        point=np.argsort(point_order)[points.point],  # numbers in the new order
        x_px=run.pixels.to_colmap(points.x),
        y_px=run.pixels.to_colmap(points.y),
        point_name=points.name.take(pa.array(point_order)),
        images_of_point=images_of_point[point_order],
        point_m=np.empty((object_points, 3)),
        progress=run.progress,
    )
    if intersect:
        _fill_object_points(block, stations.rows(rows), points.h_g_m, ledger)
    lat, lon, height_of_origin = frame.origin_deg.tolist()
    if names_origin_on_ellipsoid:
        height_of_origin = 0.0
    ledger.add(messages.block_frame(where="stations.parquet", lat=lat, lon=lon, h=height_of_origin))
    return block


def add_counts_of_block(block: ExportedBlock, ledger: Ledger) -> None:
    """Add to the ledger that a written file has all image points of a block."""
    add_counts_written(
        block,
        ledger,
        image_points=block.point.size,
        points=block.images_of_point.size,
    )


def add_counts_written(
    block: ExportedBlock,
    ledger: Ledger,
    *,
    image_points: int,
    points: int,
) -> None:
    """Add to the ledger how many image points, points and images a written file has."""
    ledger.add(
        messages.points_written(
            where="observations",
            count=image_points,
            points=points,
            images=block.image.size,
        )
    )


def _fill_object_points(
    block: ExportedBlock,
    stations: Stations,
    h_g_m: Array,
    ledger: Ledger,
) -> None:
    """Compute the positions of the object points, and write them into ``block.point_m``.

    ``stations`` are those of the block's images, ``h_g_m`` (r,) heights of the ground above sea
    level at the image points. Points on the ground are added to the ledger.
    """
    enu_of_station = enu_from_ecef(stations.lat_rad, stations.lon_rad)
    up = enu_of_station[:, 2] @ block.frame.enu_from_ecef.T
    block.point_m[:], is_intersected = intersected(block, up, stations.h_msl_m, h_g_m)
    on_ground = int(np.sum(~is_intersected))
    if on_ground:
        ledger.add(messages.points_on_ground(where="observations", count=on_ground))


def _stations_of_block(run: FinishedRun, ledger: Ledger) -> Integers:
    """(n,) the rows of the stations that can be placed; the others are a loss.

    Refuses a run without any (EXPORT-NO-STATIONS), and one of an undefined camera (EXPORT-CAMERA).
    """
    lacking = "usable position, attitude and ellipsoidal height"
    rows = placed_stations(run, can_be_placed(run.stations), lacking, ledger)
    if rows.size == 0:
        raise messages.no_station_placed(where="stations.parquet", lacking=lacking)
    undefined = set(run.stations.camera[rows]) - run.cameras.keys()
    for camera in sorted(undefined):
        raise messages.camera_uncalibrated(where="stations.parquet", camera=camera)
    return rows


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Image points (r,) sorted by image, in the order of the run in each.

    ``image``, ``point`` : numbers of image and point; ``x``, ``y`` : corrected, in pixels of the
    run; ``h_g_m`` : height of the ground above sea level. ``name`` (p,) are the points' names.
    """

    image: NDArray[np.int32]
    point: NDArray[np.int32]
    x: Array
    y: Array
    h_g_m: Array
    name: pa.StringArray


def read_image_points(run: FinishedRun, images: Integers, ledger: Ledger) -> ImagePoints:
    """The image points of the images of a block; ``images`` (n,) are the rows of their stations.

    If a point is repeated in an image, its first row is kept. Rows that are left out are a loss.
    """
    number_of_station = np.full(len(run.stations) + 1, -1, np.int32)
    # The last element stays -1: index -1 is that of an observation without a station.
    number_of_station[images] = np.arange(images.size)
    table, total = _usable_rows(run, number_of_station)
    coded_names = table["point"].chunk(0)
    table = table.set_column(1, "point", coded_names.indices)
    image = table["image"].to_numpy()
    point = table["point"].to_numpy()
    image_and_point = image * np.int64(len(coded_names.dictionary)) + point
    _, kept = np.unique(image_and_point, return_index=True)
    kept.sort(kind="stable")  # fast where images come one by one
    if kept.size < total:
        left_out = messages.observations_left_out(
            where="observations",
            count=total - kept.size,
            total=total,
            unusable=total - image.size,
            again=image.size - kept.size,
        )
        ledger.add(left_out)
    by_image = np.argsort(image[kept], kind="stable")
    table = table.take(kept[by_image])
    return ImagePoints(
        image=table["image"].to_numpy(),
        point=table["point"].to_numpy(),
        x=table["x_corrected_px"].to_numpy(),
        y=table["y_corrected_px"].to_numpy(),
        h_g_m=table["h_g_m"].to_numpy(),
        name=coded_names.dictionary,
    )


def _usable_rows(
    run: FinishedRun,
    number_of_station: NDArray[np.int32],
) -> tuple[pa.Table, int]:
    """The observations that a block uses, and how many were read.

    Used are those of status ok, with a point, in an image of the block. ``number_of_station``
    (s + 1,) is the number of each station's image in the block, -1 for images that are left out and
    for the last element. The table has the columns of `_SCHEMA` in one chunk each, points as a
    dictionary.
    """
    total = 0
    tables = [_SCHEMA.empty_table()]
    for station, part in run.observations(_COLUMNS):
        total += part.num_rows
        image = pa.array(number_of_station[station])
        is_ok = pc.equal(part["status"], "ok")
        has_point = part["point"].is_valid()
        has_image = pc.greater(image, -1)
        is_usable = pc.and_(pc.and_(is_ok, has_point), has_image)
        columns = part.append_column("image", image).select(_SCHEMA.names)
        usable = columns.filter(is_usable)
        tables.append(usable.cast(_SCHEMA))
    pool = pa.default_memory_pool()
    pool.release_unused()  # otherwise the pool keeps as much memory as the block takes
    table = pa.concat_tables(tables)
    tables.clear()
    table = table.set_column(1, "point", table["point"].dictionary_encode())
    pool.release_unused()
    return table.combine_chunks(), total


def intersected(
    block: ExportedBlock,
    up: Array,
    h_c: Array,
    h_g: Array,
) -> tuple[Array, Mask]:
    """(t, 3) positions of the object points, and (t,) whether their rays intersect.

    Rays intersect if the least squares of the angles across them determine the point well (two rays
    of equal length: more than 3 degrees apart), and it is nearer to the ground than the cameras
    are. Other points are at the mean of where their rays reach the ground. ``up`` (n, 3) is the
    vertical of each image in the block's frame, ``h_c`` (n,) the height of its camera, ``h_g`` (r,)
    that of the ground at the image points, both above sea level [m].
    """
    sums = _RaySums.of_points(len(block.point_m))
    for i, camera, image_points in block.images():
        ray = _image_rays(block, camera, image_points) @ block.rotation[i]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        reach_m = straight_reach(
            h_c[i],
            h_g[image_points],
            -ray @ up[i],
            radius=EARTH_RADIUS_M,
            far=False,
        )
        sums.add(block.frame.position_m[i], block.point[image_points], ray, reach_m)
    rays_of_point = np.maximum(sums.rays, 1)
    ground = sums.ground / rays_of_point
    distance = sums.distance / rays_of_point
    position, are_apart = _least_squares(sums.normal, sums.right)
    # A position behind the cameras is farther from the ground than the cameras are.
    from_ground = np.linalg.norm(position - ground, axis=1)
    is_before_cameras = from_ground < distance[:, 0]
    is_intersected = are_apart & is_before_cameras
    return np.where(is_intersected[:, None], position, ground), is_intersected


@dataclass(frozen=True, eq=False)
class _RaySums:
    """Sums over the rays of each point (t,).

    ``normal`` (t, 3, 3) and ``right`` (t, 3) are the normal equations for the position with the
    least squares of the angles across the rays, and their right sides; ``ground`` (t, 3) sums where
    the rays reach the ground, ``distance`` (t, 1) how far from the cameras [m]; ``rays`` (t, 1)
    counts the rays.
    """

    normal: Array
    right: Array
    ground: Array
    distance: Array
    rays: Array

    @classmethod
    def of_points(cls, points: int) -> "_RaySums":
        """Zero sums for a number of points."""
        return cls(
            normal=np.zeros((points, 3, 3)),
            right=np.zeros((points, 3)),
            ground=np.zeros((points, 3)),
            distance=np.zeros((points, 1)),
            rays=np.zeros((points, 1)),
        )

    def add(
        self,
        centre: Array,
        point: Integers,
        ray: Array,
        reach_m: Array,
    ) -> None:
        """Add the rays of an image to the sums of their points.

        ``centre`` (3,) : of the projection. ``point`` (m,) : the number of each ray's point, no
        number twice; rays of other points than those of the sums are left out. ``ray`` (m, 3) :
        unit vectors. ``reach_m`` (m,) : distance to the ground; rays with NaN are left out.
        """
        is_used = (point < len(self.normal)) & np.isfinite(reach_m)
        point = point[is_used]
        ray = ray[is_used]
        reach_m = reach_m[is_used, None]
        across_ray = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        weighted = across_ray / reach_m[:, :, None] ** 2
        self.normal[point] += weighted
        self.right[point] += weighted @ centre
        self.rays[point] += 1
        self.ground[point] += centre + reach_m * ray
        self.distance[point] += reach_m


def _image_rays(block: ExportedBlock, camera: Camera, image_points: slice) -> Array:
    """(n, 3) directions (u, v, 1) of the image points of an image, in the frame of its camera."""
    u, v = ideal_coordinates(camera, block.x_px[image_points], block.y_px[image_points])
    return np.stack([u, v, np.ones(u.size)], axis=1)


def _least_squares(normal: Array, right: Array) -> tuple[Array, Mask]:
    """(t, 3) solutions of normal equations, and (t,) whether their rays are far enough apart.

    For two rays of equal length these are 3 degrees. The solution means nothing where they are not:
    there ``normal`` (t, 3, 3) is overwritten by unit matrices, because it may be singular.
    """
    # Two rays at an angle a have (1 - cos a) / 4 of the trace as the least eigenvalue.
    part_of_trace = 0.25 * (1.0 - np.cos(MINIMUM_ANGLE_RAD))
    least = part_of_trace * np.trace(normal, axis1=1, axis2=2)
    are_apart = np.linalg.eigvalsh(normal)[:, 0] > least
    normal[~are_apart] = np.eye(3)
    solution = np.linalg.solve(normal, right[:, :, None])
    return np.asarray(solution[:, :, 0]), np.asarray(are_apart)
