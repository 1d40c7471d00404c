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

from unbend.block.image_rays import MINIMUM_ANGLE_RAD
from unbend.flight.rotations import matrices_of
from unbend.geodesy import enu_from_ecef
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import straight_reach
from unbend.tables.exports import messages
from unbend.tables.exports.export_frames import can_be_placed
from unbend.tables.exports.footprints import OneFrame, placed_stations, stations_in_one_frame
from unbend.tables.exports.format import NO_PROGRESS, ExportProgress, FinishedRun
from unbend.units import Array, Integers, Mask, Names

_COLUMNS = ["image", "point", "x_corrected_px", "y_corrected_px", "h_g_m", "status"]


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
        for i, number in enumerate(self.camera.tolist()):
            yield i, cameras[number], slice(first[i], first[i + 1])
            self.progress.advance(1)

    def of_points(self) -> tuple[Integers, Integers, Integers]:
        """Image points by their points (r,), where each begins (p + 1,), and their images (r,)."""
        order = np.argsort(self.point, kind="stable")
        image = np.repeat(np.arange(self.image.size), np.diff(self.first))
        return order, np.append(0, np.cumsum(self.count)), image[order]

    @property
    def moved_m(self) -> Array:
        """(n, 3) translations from the frame to the cameras."""
        return np.asarray(-np.einsum("nij,nj->ni", self.rotation, self.frame.position_m))


def ideal_coordinates(camera: Camera, x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """Image coordinates (n,) without distortion [principal distances]; NaN beyond the camera's.

    Corrected points may lie a little outside the image.
    """
    w, h = camera.width_px, camera.height_px
    wider = replace(
        camera, width_px=3 * w, height_px=3 * h, cx_px=camera.cx_px + w, cy_px=camera.cy_px + h
    )
    u, v, _ = wider.rays(x_px + w, y_px + h)
    return u, v


def refuse_names(names: Iterable[str], pattern: str, program: str) -> None:
    """Refuse (MissionError EXPORT-NAMES) names in which a regular expression is found."""
    for name in filter(re.compile(pattern).search, names):
        raise messages.name_with_separator(where="observations", name=name, program=program)


def block_of(run: FinishedRun, ledger: Ledger, *, intersect: bool = True) -> ExportedBlock:
    """The block of a run, in one pass over its parts; memory holds some 70 bytes an observation.

    Without object points where the format has none (``intersect``).
    Left out as losses (EXPORT-LEFT-OUT) are images without a usable station, and observations of
    them, of another status than ok, and of a point a second time in its image. Refuses
    (MissionError) a run of which no station is placed (EXPORT-NO-STATIONS), and a camera that it
    does not define (EXPORT-CAMERA).
    """
    stations, what = run.stations, "usable position, attitude and ellipsoidal height"
    rows = placed_stations(run, can_be_placed(stations), what, ledger)
    if rows.size == 0:
        raise messages.no_station_placed(where="stations.parquet", lacking=what)
    for camera in sorted(set(stations.camera[rows]) - run.cameras.keys()):
        raise messages.camera_uncalibrated(where="stations.parquet", camera=camera)
    frame = stations_in_one_frame(run, rows)
    table, names = read_image_points(run, rows, ledger)
    image, point, x, y, h_g = (column.to_numpy() for column in table.columns)
    count = np.bincount(point, minlength=len(names))
    order = np.argsort(count < 2, kind="stable")
    cameras = {name: run.cameras[name].camera for name in dict.fromkeys(stations.camera[rows])}
    block = ExportedBlock(
        cameras=cameras,
        image=stations.image[rows],
        camera=np.array([[*cameras].index(name) for name in stations.camera[rows]]),
        frame=frame,
        rotation=matrices_of(frame.quaternion),
        first=np.searchsorted(image, np.arange(rows.size + 1)),
        point=np.argsort(order)[point],
        x_px=run.pixels.to_colmap(x),
        y_px=run.pixels.to_colmap(y),
        name=names.take(pa.array(order)),
        count=count[order],
        point_m=np.empty((int(np.sum(count > 1)) if intersect else 0, 3)),
        progress=run.progress,
    )
    if intersect:
        up = enu_from_ecef(stations.lat_rad[rows], stations.lon_rad[rows])[:, 2]
        up = up @ frame.enu_from_ecef.T
        block.point_m[:], met = intersected(block, up, stations.h_msl_m[rows], h_g)
        if apart := int(np.sum(~met)):
            ledger.add(messages.points_on_ground(where="observations", count=apart))
    lat, lon, h = frame.origin_deg.tolist()
    ledger.add(messages.block_frame(where="stations.parquet", lat=lat, lon=lon, h=h))
    ledger.add(
        messages.points_written(
            where="observations", count=image.size, points=len(names), images=rows.size
        )
    )
    return block


def read_image_points(
    run: FinishedRun, images: Integers, ledger: Ledger
) -> tuple[pa.Table, pa.StringArray]:
    """Number of the image and of the point, x, y and height of the ground, sorted by image.

    ``images`` are the stations of the images. And the names of the points: of one that is twice in
    an image the first row is kept.
    """
    number, total = np.full(len(run.stations) + 1, -1, np.int32), 0
    number[images] = np.arange(images.size)
    kinds = [pa.int32(), pa.string(), *[pa.float64()] * 3]
    schema = pa.schema(list(zip(_COLUMNS[:5], kinds, strict=True)))
    tables = [schema.empty_table()]
    for station, table in run.observations(_COLUMNS[1:]):
        total += table.num_rows
        image = pa.array(number[station])
        good = pc.and_(pc.equal(table["status"], "ok"), table["point"].is_valid())
        table = table.set_column(4, "image", image).filter(pc.and_(good, pc.greater(image, -1)))
        tables.append(table.select([4, 0, 1, 2, 3]).cast(schema))
    pool = pa.default_memory_pool()
    pool.release_unused()  # which it keeps else, as much as the block takes
    table = pa.concat_tables(tables)
    tables.clear()
    table = table.set_column(1, "point", table["point"].dictionary_encode())
    pool.release_unused()
    table = table.combine_chunks()
    coded = table["point"].chunk(0)
    table = table.set_column(1, "point", coded.indices)
    image, point = table["image"].to_numpy(), table["point"].to_numpy()
    _, kept = np.unique(image * np.int64(len(coded.dictionary)) + point, return_index=True)
    kept.sort(kind="stable")  # fast where images come one by one
    if kept.size < total:
        ledger.add(
            messages.observations_left_out(
                where="observations",
                count=total - kept.size,
                total=total,
                unusable=total - image.size,
                again=image.size - kept.size,
            )
        )
    return table.take(kept[np.argsort(image[kept], kind="stable")]), coded.dictionary


def intersected(block: ExportedBlock, up: Array, h_c: Array, h_g: Array) -> tuple[Array, Mask]:
    """(t, 3) points by least squares of the angles across their rays, and whether these meet (t,).

    Where they do not meet at 3 degrees or more it is the mean of where they reach the ground.
    ``up`` (n, 3) in the frame and ``h_c`` (n,) are those of the images, ``h_g`` (r,) heights of the
    ground, both above sea level [m].
    """
    tied = len(block.point_m)
    normal, right, ground = np.zeros((tied, 3, 3)), np.zeros((tied, 3)), np.zeros((tied, 4))
    for i, camera, here in block.images():
        u, v = ideal_coordinates(camera, block.x_px[here], block.y_px[here])
        ray = np.stack([u, v, np.ones(u.size)], axis=1) @ block.rotation[i]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        reach = straight_reach(h_c[i], h_g[here], -ray @ up[i], radius=6.371e6, far=False)
        own = np.flatnonzero((block.point[here] < tied) & np.isfinite(reach))
        point, ray, reach = block.point[here][own], ray[own], reach[own, None]
        # A point is in an image once: no index repeats.
        across = (np.eye(3) - ray[:, :, None] * ray[:, None, :]) / reach[:, :, None] ** 2
        normal[point] += across
        right[point] += across @ block.frame.position_m[i]
        ground[point] += np.append(block.frame.position_m[i] + reach * ray, reach, axis=1)
    ground /= np.maximum(block.count[:tied, None], 1)
    # Two rays at an angle a have (1 - cos a) / 4 of the trace as the least eigenvalue.
    least = 0.25 * (1.0 - np.cos(MINIMUM_ANGLE_RAD)) * np.trace(normal, axis1=1, axis2=2)
    met = np.linalg.eigvalsh(normal)[:, 0] > least
    normal[~met] = np.eye(3)
    position = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    # Behind a camera it is farther from the ground than that is.
    met &= np.linalg.norm(position - ground[:, :3], axis=1) < ground[:, 3]
    return np.where(met[:, None], position, ground[:, :3]), met
