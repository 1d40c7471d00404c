"""The block of a run as a bundle adjustment starts from it: stations, image and object points.

All in one local frame. Nothing is projected to a map and no earth curvature is applied: the frame
is Cartesian, x east, y north, z up at its origin.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

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
from unbend.tables.exports.footprints import OneFrame, placed_stations, stations_in_one_frame
from unbend.units import Array, Integers, Mask, Names

EARTH_RADIUS_M = 6.371e6  # only for the distance at which rays are weighted

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


@dataclass(frozen=True, eq=False)
class ExportedBlock:
    """Images (n,), their image points (r,) image by image, and points (p,).

    ``frame`` has the projection centres of the images, ``rotation`` (n, 3, 3) turns from it to the
    camera; ``camera`` (n,) numbers ``cameras``. ``first`` (n + 1,) is the first image point of each
    image; those of an image stand in the order of the run. ``x_px``, ``y_px`` (r,) are free of
    refraction, in COLMAP's pixels; ``point`` (r,) numbers the points, of which those that were
    measured in ``count`` > 1 images come first: of these ``point_m`` (t, 3) is where their rays
    meet, or end on the ground, where a format has object points.
    """

    cameras: dict[str, Camera]
    image: Names
    camera: Integers
    frame: OneFrame
    rotation: Array
    first: Integers
    point: Integers
    x_px: Array
    y_px: Array
    name: pa.StringArray
    count: Integers
    point_m: Array
    progress: ExportProgress = NO_PROGRESS

    def images(self) -> Iterator[tuple[int, Camera, slice]]:
        """Number, camera and image points of each image."""
        cameras = [*self.cameras.values()]
        first = self.first.tolist()
        self.progress.start("images of the block", self.camera.size)
        for image, number in enumerate(self.camera.tolist()):
            image_points = slice(first[image], first[image + 1])
            yield image, cameras[number], image_points
            self.progress.advance(1)

    def image_points_by_point(self) -> tuple[Integers, Integers, Integers]:
        """Image points by their points (r,), where each begins (p + 1,), and their images (r,)."""
        order = np.argsort(self.point, kind="stable")
        begin = np.append(0, np.cumsum(self.count))
        image = np.repeat(np.arange(self.image.size), np.diff(self.first))
        return order, begin, image[order]

    @property
    def moved_m(self) -> Array:
        """(n, 3) translations from the frame to the cameras."""
        return np.asarray(-np.einsum("nij,nj->ni", self.rotation, self.frame.position_m))


def ideal_coordinates(
    camera: Camera,
    x_px: Array,
    y_px: Array,
) -> tuple[Array, Array]:
    """Image coordinates (n,) without distortion [principal distances]; NaN beyond the camera's.

    Corrected points may lie a little outside the image.
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
    """Refuse (MissionError EXPORT-NAMES) names in which a regular expression is found."""
    for name in names:
        if re.search(pattern, name) is None:
            continue
        raise messages.name_with_separator(where="observations", name=name, program=program)


def block_of(
    run: FinishedRun,
    ledger: Ledger,
    *,
    intersect: bool = True,
) -> ExportedBlock:
    """The block of a run, in one pass over its parts; memory holds some 70 bytes an observation.

    Without object points where the format has none (``intersect``).
    Left out as losses (EXPORT-LEFT-OUT) are images without a usable station, and observations of
    them, of another status than ok, and of a point a second time in its image. Refuses
    (MissionError) a run of which no station is placed (EXPORT-NO-STATIONS), and a camera that it
    does not define (EXPORT-CAMERA).
    """
    rows = _stations_of_block(run, ledger)
    stations = run.stations
    frame = stations_in_one_frame(run, rows)
    points = read_image_points(run, rows, ledger)
    camera_names = list(dict.fromkeys(stations.camera[rows]))
    number_of_camera = {name: number for number, name in enumerate(camera_names)}
    images_of_point = np.bincount(points.point, minlength=len(points.name))
    tied_first = np.argsort(images_of_point < 2, kind="stable")
    tied_points = int(np.sum(images_of_point > 1)) if intersect else 0
    block = ExportedBlock(
        cameras={name: run.cameras[name].camera for name in camera_names},
        image=stations.image[rows],
        camera=np.array([number_of_camera[name] for name in stations.camera[rows]]),
        frame=frame,
        rotation=matrices_of(frame.quaternion),
        first=np.searchsorted(points.image, np.arange(rows.size + 1)),
        point=np.argsort(tied_first)[points.point],
        x_px=run.pixels.to_colmap(points.x),
        y_px=run.pixels.to_colmap(points.y),
        name=points.name.take(pa.array(tied_first)),
        count=images_of_point[tied_first],
        point_m=np.empty((tied_points, 3)),
        progress=run.progress,
    )
    if intersect:
        _fill_object_points(block, stations.rows(rows), points.h_g_m, ledger)
    lat, lon, h = frame.origin_deg.tolist()
    ledger.add(messages.block_frame(where="stations.parquet", lat=lat, lon=lon, h=h))
    return block


def add_counts_of_block(block: ExportedBlock, ledger: Ledger) -> None:
    """Add to the ledger that a written file has all image points of a block."""
    add_counts_written(
        block,
        ledger,
        image_points=block.point.size,
        points=block.count.size,
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
    """Intersect the points of a block of some stations; those on the ground are reported."""
    enu_of_station = enu_from_ecef(stations.lat_rad, stations.lon_rad)
    up = enu_of_station[:, 2] @ block.frame.enu_from_ecef.T
    block.point_m[:], met = intersected(block, up, stations.h_msl_m, h_g_m)
    on_ground = int(np.sum(~met))
    if on_ground:
        ledger.add(messages.points_on_ground(where="observations", count=on_ground))


def _stations_of_block(run: FinishedRun, ledger: Ledger) -> Integers:
    """(n,) the stations that can be placed, at least one, all of cameras that the run defines."""
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
    """Image points (r,) sorted by image: numbers of image and point, pixels, height of the ground.

    ``name`` (p,) are the names of the points. Pixels are those of the run.
    """

    image: NDArray[np.int32]
    point: NDArray[np.int32]
    x: Array
    y: Array
    h_g_m: Array
    name: pa.StringArray


def read_image_points(run: FinishedRun, images: Integers, ledger: Ledger) -> ImagePoints:
    """The image points of some stations' images, numbered in the order of ``images`` (n,).

    Of a point that is twice in an image the first row is kept; what is left out is reported.
    """
    number_of_station = np.full(len(run.stations) + 1, -1, np.int32)
    # The last one, to which -1 points, stays -1: an observation without a station.
    number_of_station[images] = np.arange(images.size)
    table, total = _usable_rows(run, number_of_station)
    coded = table["point"].chunk(0)
    table = table.set_column(1, "point", coded.indices)
    image = table["image"].to_numpy()
    point = table["point"].to_numpy()
    image_and_point = image * np.int64(len(coded.dictionary)) + point
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
        name=coded.dictionary,
    )


def _usable_rows(
    run: FinishedRun,
    number_of_station: NDArray[np.int32],
) -> tuple[pa.Table, int]:
    """Observations that are ok, with a point, of numbered images; and how many rows were read.

    ``number_of_station`` is that of the image, -1 for images that are left out. The table has the
    columns of `_SCHEMA` in one chunk each, the points as a dictionary.
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
    pool.release_unused()  # which it keeps else, as much as the block takes
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
    """(t, 3) points by least squares of the angles across their rays, and whether these meet (t,).

    Where they do not meet at 3 degrees or more it is the mean of where they reach the ground.
    ``up`` (n, 3) in the frame and ``h_c`` (n,) are those of the images, ``h_g`` (r,) heights of the
    ground, both above sea level [m].
    """
    sums = _RaySums.of_points(len(block.point_m))
    for i, camera, rows in block.images():
        ray_in_camera = _image_rays(camera, block.x_px[rows], block.y_px[rows])
        ray = ray_in_camera @ block.rotation[i]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        reach = straight_reach(
            h_c[i],
            h_g[rows],
            -ray @ up[i],
            radius=EARTH_RADIUS_M,
            far=False,
        )
        sums.add(block.frame.position_m[i], block.point[rows], ray, reach)
    images_of_point = np.maximum(block.count[: len(block.point_m), None], 1)
    ground = sums.ground / images_of_point
    distance = sums.distance / images_of_point
    position, are_apart = _least_squares(sums.normal, sums.right)
    # Behind a camera it is farther from the ground than that is.
    from_ground = np.linalg.norm(position - ground, axis=1)
    is_before_cameras = from_ground < distance[:, 0]
    met = are_apart & is_before_cameras
    return np.where(met[:, None], position, ground), met


@dataclass(frozen=True, eq=False)
class _RaySums:
    """Sums over the rays of points (t,).

    ``normal`` (t, 3, 3) and ``right`` (t, 3) are equations of the squares of the angles across the
    rays; ``ground`` (t, 3) is where these end on the ground, ``distance`` (t, 1) how far away.
    """

    normal: Array
    right: Array
    ground: Array
    distance: Array

    @classmethod
    def of_points(cls, points: int) -> "_RaySums":
        """Sums over no rays."""
        return cls(
            normal=np.zeros((points, 3, 3)),
            right=np.zeros((points, 3)),
            ground=np.zeros((points, 3)),
            distance=np.zeros((points, 1)),
        )

    def add(
        self,
        centre: Array,
        point: Integers,
        ray: Array,
        reach: Array,
    ) -> None:
        """Add the rays (n, 3) of an image with a ``reach`` (n,) [m], of those of the points (t,).

        ``centre`` (3,) is that of the projection. A point is in an image once: no index repeats.
        """
        is_used = (point < len(self.normal)) & np.isfinite(reach)
        point = point[is_used]
        ray = ray[is_used]
        reach = reach[is_used, None]
        projection = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        across = projection / reach[:, :, None] ** 2
        self.normal[point] += across
        self.right[point] += across @ centre
        self.ground[point] += centre + reach * ray
        self.distance[point] += reach


def _image_rays(camera: Camera, x_px: Array, y_px: Array) -> Array:
    """(n, 3) directions (u, v, 1) of corrected image points in the frame of the camera."""
    u, v = ideal_coordinates(camera, x_px, y_px)
    return np.stack([u, v, np.ones(u.size)], axis=1)


def _least_squares(normal: Array, right: Array) -> tuple[Array, Mask]:
    """(t, 3) solutions of normal equations, and whether two rays are 3 degrees apart (t,).

    Equations of points whose rays are not are overwritten by unit matrices.
    """
    # Two rays at an angle a have (1 - cos a) / 4 of the trace as the least eigenvalue.
    part_of_trace = 0.25 * (1.0 - np.cos(MINIMUM_ANGLE_RAD))
    least = part_of_trace * np.trace(normal, axis1=1, axis2=2)
    are_apart = np.linalg.eigvalsh(normal)[:, 0] > least
    normal[~are_apart] = np.eye(3)
    solution = np.linalg.solve(normal, right[:, :, None])
    return np.asarray(solution[:, :, 0]), np.asarray(are_apart)
