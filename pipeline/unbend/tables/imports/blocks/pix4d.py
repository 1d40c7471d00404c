"""Pix4D's calibrated parameters: the folder ``params`` of a project, or one of its files.

``..._calibrated_camera_parameters.txt`` has for each image its name and size, K, three radial and
two tangential coefficients (OpenCV's k1, k2, k3 and p1, p2), the projection centre t and the
rotation R: a point X is seen at K R (X - t), so the camera has x right, y down, z forward. t counts
from ``..._offset.xyz``. ``..._calibrated_external_camera_parameters.txt`` has X, Y, Z without
offset and omega, phi, kappa in degrees, as photogrammetry has them. Both are in the coordinate
system of ``..._wkt.prj``, angles against its grid's north. ``..._tp_pix4d.txt`` has image points:
the image's name without ending, lines of point, x, y and scale, and -99. Pixels count from the
corner of the image, as COLMAP's. Sources: Pix4D's articles on the folder and on its parameters, and
files of public projects; it was not run here.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
import pyarrow as pa

from unbend.block.known_places import KnownPlaces
from unbend.flight.rotations import matrices_of, quaternion_of_opk
from unbend.refraction.calibration import camera_of_model
from unbend.tables.imports.blocks import messages
from unbend.tables.imports.blocks.image_points import (
    CameraMakers,
    TextFile,
    oriented_images,
    quaternions_of_poses,
    rows_of_image,
)
from unbend.tables.imports.stated import read_text
from unbend.tables.imports.user_tables import OrientationTable
from unbend.units import Array

_CAMERAS = "calibrated_camera_parameters.txt"
_EXTERNAL = "calibrated_external_camera_parameters.txt"
_OFFSET = "offset.xyz"
_SYSTEM = "wkt.prj"
_TIES = "tp_pix4d.txt"
_END_OF_IMAGE = "-99"
_LAST_HEAD_LINE = "camera model"
_NUMBERS = 9 + 3 + 2 + 3 + 9  # of an image: K, radial, tangential, t, R
_LARGEST_DIFFERENCE_M = 0.01  # between both files: they have at least millimetres
_LARGEST_DIFFERENCE = 1e-4  # between their rotations: angles have six decimals of a degree


@dataclass(
    frozen=True,
    eq=False,
)
class CalibratedImage:
    """An image of the file of calibrated camera parameters, with its camera and its pose."""

    name: str
    size: tuple[int, int]  # width, height [px]
    k: Array  # (3, 3) [px]
    distortion: Array  # (5,) k1, k2, k3, p1, p2
    centre: Array  # (3,) relative to the offset of the project
    rotation: Array  # (3, 3) from the project's axes to the camera

    @property
    def interior(self) -> tuple[float, ...]:
        """Size, K and distortion, by which images of the same camera are recognised."""
        return (*self.size, *self.k.ravel().tolist(), *self.distortion.tolist())


def block_files(path: Path) -> tuple[Path, ...]:
    """The files of a project that exist; refuses a path without a file of camera parameters."""
    parameters = _existing_files(path, (_CAMERAS, _EXTERNAL))
    if not parameters:
        raise messages.file_of_pix4d_missing(
            where=path,
            name=_CAMERAS,
        )
    return (*parameters, *_existing_files(path, (_OFFSET, _SYSTEM, _TIES)))


def _existing_files(path: Path, name_endings: tuple[str, ...]) -> list[Path]:
    """The files of a project with these endings of names, as far as they exist."""
    files = [_file_of_project(path, ending) for ending in name_endings]
    return [file for file in files if file is not None]


def read_cameras(path: Path) -> CameraMakers:
    """The cameras by number, as the file has no names: 1, 2, ... in the order of first images."""
    cameras: CameraMakers = {}
    for image in _first_of_each_camera(_images(path)):
        if image.k[0, 1]:
            raise messages.calibration_unusable(
                where=path,
                coefficients="skew",
                kind="Pix4D",
            )
        focal_and_centre = [image.k[0, 0], image.k[1, 1], image.k[0, 2], image.k[1, 2]]
        parameters = [float(number) for number in (*focal_and_centre, *image.distortion)]
        name = str(len(cameras) + 1)
        cameras[name] = partial(camera_of_model, "BROWN", *image.size, parameters)
    return cameras


def read_images(path: Path) -> OrientationTable:
    """The images with their poses in the project's coordinate system.

    They are from the file of camera parameters, or without it from the external parameters. Refuses
    files that contradict each other, and centres relative to an unknown offset in a known
    coordinate system.
    """
    system = _file_of_project(path, _SYSTEM)
    crs = None
    if system is not None:
        crs = "\n".join(read_text(system)).strip() or None
    external = _external_parameters(path)
    images = _images(path)
    if not images:
        names = [*external]
        values = np.array([*external.values()]).reshape(-1, 6)
        quaternion = quaternion_of_opk(np.radians(values[:, 3:]), "omega_phi_kappa")
        table = oriented_images(names, ["1"] * len(names), values[:, :3], quaternion)
        return replace(table, crs=crs)
    interiors = [image.interior for image in _first_of_each_camera(images)]
    cameras = [str(interiors.index(image.interior) + 1) for image in images]
    names = [image.name for image in images]
    centres = np.array([image.centre for image in images]) + _offset(path, images, external, crs)
    quaternion = quaternions_of_poses(path, names, [image.rotation for image in images])
    table = oriented_images(names, cameras, centres, quaternion)
    _refuse_contradiction(path, table, external)
    return replace(table, crs=crs)


def read_places(_: Path) -> tuple[KnownPlaces, ...]:
    """No places: the positions of images before the adjustment are in files that are not read."""
    return ()


def read_rows(path: Path) -> Iterator[pa.RecordBatch]:
    """The tie points of a project, image by image."""
    file = _file_of_project(path, _TIES)
    if file is None:
        raise messages.file_of_pix4d_missing(
            where=path,
            name=_TIES,
        )
    full_names = {_without_ending(image.name): image.name for image in _images(path)}
    name = ""
    points: list[str] = []
    pixels: list[tuple[float, float]] = []
    with TextFile(file) as lines:
        for line in lines:
            fields = line.split()
            if fields == [_END_OF_IMAGE]:
                if points:
                    yield rows_of_image(full_names.get(name, name), pixels, points)
                points = []
                pixels = []
            elif len(fields) >= 3 and name and _is_number(fields[-1]):
                points.append(fields[0])
                pixels.append((float(fields[1]), float(fields[2])))
            elif line:
                name = line
    if points:
        yield rows_of_image(full_names.get(name, name), pixels, points)


def read_points(_: Path) -> tuple[pa.StringArray, Array]:
    """No points: the files of parameters have none."""
    return pa.array([], pa.string()), np.empty((0, 3))


def _file_of_project(
    path: Path,
    name_ending: str,
) -> Path | None:
    """The file of a project with an ending of its name; None if it does not exist.

    ``path`` is the project's folder, which may have only one such file, or another file of the
    project: the names of all its files have the same beginning.
    """
    if not path.is_dir():
        beginning = path.name
        for other_ending in (_CAMERAS, _EXTERNAL, _OFFSET, _SYSTEM, _TIES):
            beginning = beginning.removesuffix(other_ending)
        file = path.with_name(beginning + name_ending)
        return file if file.is_file() else None
    files = sorted(file for file in path.iterdir() if file.name.endswith(name_ending))
    if len(files) > 1:
        raise messages.several_of_pix4d(
            where=path,
            name=name_ending,
            files=len(files),
        )
    return files[0] if files else None


def _images(path: Path) -> list[CalibratedImage]:
    """The images of the file of calibrated camera parameters; none without that file."""
    file = _file_of_project(path, _CAMERAS)
    if file is None:
        return []
    images: list[CalibratedImage] = []
    with TextFile(file) as lines:
        rows = iter(lines)
        if not any(line.startswith(_LAST_HEAD_LINE) for line in rows):
            raise ValueError
        for line in rows:
            if not line:
                continue
            name, width, height = line.rsplit(maxsplit=2)
            numbers: list[float] = []
            while len(numbers) < _NUMBERS:
                numbers += map(float, next(rows, "end").split())  # at the end: not a number
            if len(numbers) > _NUMBERS:
                raise ValueError
            values = np.array(numbers)
            images.append(
                CalibratedImage(
                    name=name,
                    size=(int(width), int(height)),
                    k=values[:9].reshape(3, 3),
                    distortion=values[9:14],
                    centre=values[14:17],
                    rotation=values[17:].reshape(3, 3),
                )
            )
    return images


def _first_of_each_camera(images: list[CalibratedImage]) -> list[CalibratedImage]:
    """The first image of each camera, which is recognised by its interior orientation."""
    first: dict[tuple[float, ...], CalibratedImage] = {}
    for image in images:
        first.setdefault(image.interior, image)
    return [*first.values()]


def _external_parameters(path: Path) -> dict[str, list[float]]:
    """Image -> X, Y, Z [m] and omega, phi, kappa [deg]; empty without the file of these."""
    file = _file_of_project(path, _EXTERNAL)
    poses: dict[str, list[float]] = {}
    if file is None:
        return poses
    with TextFile(file) as lines:
        for line in lines:
            if not line or line.lower().startswith("imagename"):
                continue
            name, *fields = line.rsplit(maxsplit=6)
            if name in poses:
                raise messages.image_repeated(
                    where=file,
                    image=name,
                )
            poses[name] = [float(field) for field in fields]
            if len(fields) != 6:
                raise ValueError
    return poses


def _offset(
    path: Path,
    images: list[CalibratedImage],
    external: dict[str, list[float]],
    crs: str | None,
) -> Array:
    """(3,) the offset to add to the centres, from its file, or from the external parameters.

    Without both it is 0, and refused if the project has a coordinate system, ``crs``.
    """
    file = _file_of_project(path, _OFFSET)
    if file is not None:
        with TextFile(file) as lines:
            numbers = [float(field) for line in lines for field in line.split()]
        if len(numbers) != 3:
            raise messages.line_unreadable(
                where=file,
                line=1,
            )
        return np.array(numbers)
    in_both = [image for image in images if image.name in external]
    if in_both:
        offsets = [np.array(external[image.name][:3]) - image.centre for image in in_both]
        return np.asarray(np.median(np.array(offsets), axis=0))
    if crs is not None:
        raise messages.offset_missing(
            where=path,
            name=_OFFSET,
        )
    return np.zeros(3)


def _refuse_contradiction(
    path: Path,
    table: OrientationTable,
    external: dict[str, list[float]],
) -> None:
    """Refuse an image with a pose in ``table`` that differs from its ``external`` parameters."""
    for row, name in enumerate(table.image.tolist()):
        if name not in external:
            continue
        values = np.array(external[name])
        angles = np.radians(values[None, 3:])
        external_rotation = matrices_of(quaternion_of_opk(angles, "omega_phi_kappa"))[0]
        rotation = matrices_of(table.angles[row : row + 1])[0]
        distance_m = float(np.abs(table.position[row] - values[:3]).max())
        turned_rad = float(np.abs(rotation - external_rotation).max())  # about the angle between
        if distance_m > _LARGEST_DIFFERENCE_M or turned_rad > _LARGEST_DIFFERENCE:
            raise messages.files_of_pix4d_differ(
                where=path,
                image=name,
                away_m=distance_m,
                turned_deg=float(np.degrees(turned_rad)),
            )


def _without_ending(name: str) -> str:
    """The name of an image as the file of image points has it."""
    return str(PurePosixPath(name).with_suffix(""))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
