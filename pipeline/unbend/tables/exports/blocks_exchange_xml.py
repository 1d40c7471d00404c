"""BlocksExchange XML for ContextCapture, iTwin Capture Modeler and others that read it.

Pixels count from the centre of the upper left one, half a pixel from COLMAP's. Poses turn from
east, north, up at the origin to the camera (x right, y down, z forward). Heights in the reference
system, ``ENU:latitude,longitude``, count from the ellipsoid. P1 belongs to r2 + 2 x2: the other way
round than in OpenCV. A camera is a photogroup; tie points have their names. Points that were
measured in one image only are left out.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports import messages
from unbend.tables.exports.colmap_files import opencv_coefficients
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, Values
from unbend.tables.exports.export_frames import (
    CENTRE_PIXELS,
    COMPUTER_VISION_AXES,
    ExportFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import ExportedBlock, add_counts_written, block_of
from unbend.units import Array

_HALF_PIXEL = 0.5  # from the centre of the upper left pixel to its corner
_PROGRAM = "BlocksExchange"
_OPENCV_NAMES = {"K1": "k1", "K2": "k2", "K3": "k3", "P1": "p2", "P2": "p1"}
"""OpenCV's names of the coefficients, by the names in the format."""


def plain_coefficients(camera: Camera, name: str, program: str) -> dict[str, float]:
    """OpenCV's k1, k2, k3, p1, p2 of a camera, by these names; 0 for those that it does not have.

    Refuses (MissionError EXPORT-DISTORTION) a fisheye, and a camera with other coefficients.
    ``name`` of the camera and ``program`` are for the message.
    """
    where = f"cameras.{name}"
    if isinstance(camera.distortion, OpenCVFisheye):
        raise messages.distortion_unknown(where=where, name=name, beyond="fisheye", program=program)
    supported = ("k1", "k2", "k3", "p1", "p2")
    zeros = dict.fromkeys(supported, 0.0)
    return zeros | opencv_coefficients(camera, name, program, supported)


def write_blocks_exchange(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """Write the block as one file; returns the number of image points in it."""
    block = block_of(run, ledger, names_origin_on_ellipsoid=True)
    single = int(np.sum(block.images_of_point[block.point] < 2))
    written = int(block.point.size) - single
    add_counts_written(block, ledger, image_points=written, points=len(block.point_m))
    if single:
        not_written = messages.single_points_not_written(
            where="observations",
            count=single,
            total=block.point.size,
        )
        ledger.add(not_written)
    lat, lon, height = block.frame.origin_deg.tolist()
    with path.open("w", encoding="utf-8") as file:
        file.write(
            '<?xml version="1.0" encoding="utf-8"?>\n<BlocksExchange version="2.1">\n'
            "<SpatialReferenceSystems><SRS><Id>0</Id><Name>east, north, up</Name>"
            f"<Definition>ENU:{lat!r},{lon!r}</Definition></SRS></SpatialReferenceSystems>\n"
            f"<Block><Name>{escape(run.mission)}</Name><SRSId>0</SRSId>\n<Photogroups>\n"
        )
        for number, (name, camera) in enumerate(block.cameras.items()):
            file.write(f"<Photogroup><Name>{escape(name)}</Name>{interior(camera, name)}\n")
            file.writelines(photos(block, number, height))
            file.write("</Photogroup>\n")
        file.write("</Photogroups>\n<ControlPoints/>\n<TiePoints>\n")
        file.writelines(tie_points(block, height))
        file.write("</TiePoints>\n</Block>\n</BlocksExchange>\n")
    return written


def interior(camera: Camera, name: str) -> str:
    """The elements of a camera's size and calibration; refuses different fx and fy.

    ``name`` of the camera is for the message.
    """
    if camera.fx_px != camera.fy_px:
        raise messages.distortion_unknown(
            where=f"cameras.{name}", name=name, beyond="different fx and fy", program=_PROGRAM
        )
    coefficients = plain_coefficients(camera, name, _PROGRAM)
    distortion = "".join(
        f"<{tag}>{coefficients[opencv_name]!r}</{tag}>"
        for tag, opencv_name in _OPENCV_NAMES.items()
    )
    principal_x = camera.cx_px - _HALF_PIXEL
    principal_y = camera.cy_px - _HALF_PIXEL
    return (
        f"<ImageDimensions><Width>{camera.width_px}</Width><Height>{camera.height_px}</Height>"
        "</ImageDimensions><CameraModelType>Perspective</CameraModelType>"
        f"<FocalLengthPixels>{camera.fx_px!r}</FocalLengthPixels>"
        "<CameraOrientation>XRightYDown</CameraOrientation>"
        f"<PrincipalPoint><x>{principal_x!r}</x><y>{principal_y!r}</y></PrincipalPoint>"
        f"<Distortion>{distortion}</Distortion>"
    )


def photos(block: ExportedBlock, camera: int, origin_height_m: float) -> Iterator[str]:
    """The elements of the photos of a camera, a number of ``block.cameras``.

    Their ids count from 1 in the order of the block's images. ``origin_height_m`` : of the block's
    origin, above the ellipsoid.
    """
    for image in np.flatnonzero(block.camera == camera).tolist():
        matrix = ""
        for i, row in enumerate(block.rotation[image].tolist()):
            for j, value in enumerate(row):
                matrix += f"<M_{i}{j}>{value!r}</M_{i}{j}>"
        centre = coordinates(block.frame.position_m[image], origin_height_m)
        yield (
            f"<Photo><Id>{image + 1}</Id><ImagePath>{escape(str(block.image[image]))}</ImagePath>"
            f"<Pose><Rotation>{matrix}</Rotation><Center>{centre}</Center></Pose></Photo>\n"
        )


def tie_points(block: ExportedBlock, origin_height_m: float) -> Iterator[str]:
    """The elements of the object points, each with the measurements of its image points.

    ``origin_height_m`` : of the block's origin, above the ellipsoid.
    """
    by_point = block.image_points_by_point()
    for point, position_m in enumerate(block.point_m):
        measurements = ""
        for k in range(by_point.begin[point], by_point.begin[point + 1]):
            image_point = by_point.image_point[k]
            x = float(block.x_px[image_point]) - _HALF_PIXEL
            y = float(block.y_px[image_point]) - _HALF_PIXEL
            photo = int(by_point.image[k]) + 1
            measurements += (
                f"<Measurement><PhotoId>{photo}</PhotoId><x>{x!r}</x><y>{y!r}</y></Measurement>"
            )
        name = escape(block.point_name[point].as_py())
        position = coordinates(position_m, origin_height_m)
        yield (
            f"<TiePoint><Name>{name}</Name><Position>{position}</Position>{measurements}"
            "</TiePoint>\n"
        )


def coordinates(position_m: Array, origin_height_m: float) -> str:
    """The elements x, y, z of a position (3,) in the block's frame; z counts from the ellipsoid.

    ``origin_height_m`` : of the block's origin, above the ellipsoid.
    """
    x, y, z = position_m.tolist()
    return f"<x>{x!r}</x><y>{y!r}</y><z>{z + origin_height_m!r}</z>"


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of the file: east, north, up, matrices, and pixels from their centres.

    The origin is that of the block, moved along its vertical to the ellipsoid: z counts from there.
    """
    positions = block_positions(run.stations)
    if positions.origin is not None:
        on_ellipsoid = replace(positions.origin, h_ellipsoid_m=0.0)
        positions = replace(positions, origin=on_ellipsoid)
    return ExportFrame(
        positions=positions,
        angles=angles_of_block("rotation_matrix", COMPUTER_VISION_AXES),
        pixels=CENTRE_PIXELS,
    )


FORMATS = (
    ExportFormat(
        "blocksexchange",
        "a block as BlocksExchange XML, for ContextCapture and iTwin",
        ".xml",
        write_blocks_exchange,
        frame_of_block,
        marked=("",),
        use=(
            "ContextCapture corrects neither refraction nor earth curvature: nothing must be "
            "switched off in it; keep the optical properties of the photogroups"
        ),
    ),
)
