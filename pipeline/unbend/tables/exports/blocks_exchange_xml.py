"""BlocksExchange XML for ContextCapture, iTwin Capture Modeler and others that read it.

Pixels count from the centre of the upper left one, half a pixel from COLMAP's. Poses turn from
east, north, up at the origin to the camera (x right, y down, z forward); the reference system is
``ENU:latitude,longitude``, whose heights count from the ellipsoid. P1 belongs to r2 + 2 x2: the
other way round than in OpenCV. A camera is a photogroup; tie points have their names. Points that
were measured in one image only are left out.
"""

from collections.abc import Iterator
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
    OF_COMPUTER_VISION,
    ExportFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import ExportedBlock, add_counts_written, block_of
from unbend.units import Array

_HALF_PIXEL = 0.5  # from the centre of the upper left pixel to its corner
_PROGRAM = "BlocksExchange"
_NAMES = {"K1": "k1", "K2": "k2", "K3": "k3", "P1": "p2", "P2": "p1"}
"""Coefficients of the format, and what OpenCV calls each."""


def plain_coefficients(camera: Camera, name: str, program: str) -> dict[str, float]:
    """k1, k2, k3, p1, p2 of a camera; refuses one that has others."""
    where = f"cameras.{name}"
    if isinstance(camera.distortion, OpenCVFisheye):
        raise messages.distortion_unknown(where=where, name=name, beyond="fisheye", program=program)
    holds = ("k1", "k2", "k3", "p1", "p2")
    return dict.fromkeys(holds, 0.0) | opencv_coefficients(camera, name, program, holds)


def write_blocks_exchange(run: FinishedRun, _: Values, path: Path, ledger: Ledger) -> int:
    """One file with the block; the number of measurements."""
    block = block_of(run, ledger)
    single = int(np.sum(block.count[block.point] < 2))
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
    """Size and calibration of a camera; refuses one whose pixels are not square."""
    if camera.fx_px != camera.fy_px:
        raise messages.distortion_unknown(
            where=f"cameras.{name}", name=name, beyond="different fx and fy", program=_PROGRAM
        )
    plain = plain_coefficients(camera, name, _PROGRAM)
    coefficients = "".join(
        f"<{tag}>{plain[name_here]!r}</{tag}>" for tag, name_here in _NAMES.items()
    )
    x = camera.cx_px - _HALF_PIXEL
    y = camera.cy_px - _HALF_PIXEL
    return (
        f"<ImageDimensions><Width>{camera.width_px}</Width><Height>{camera.height_px}</Height>"
        "</ImageDimensions><CameraModelType>Perspective</CameraModelType>"
        f"<FocalLengthPixels>{camera.fx_px!r}</FocalLengthPixels>"
        "<CameraOrientation>XRightYDown</CameraOrientation>"
        f"<PrincipalPoint><x>{x!r}</x><y>{y!r}</y></PrincipalPoint>"
        f"<Distortion>{coefficients}</Distortion>"
    )


def photos(block: ExportedBlock, camera: int, origin_height_m: float) -> Iterator[str]:
    """The photos of a camera, numbered from 1 in the order of the block."""
    for row in np.flatnonzero(block.camera == camera).tolist():
        turn = block.rotation[row].tolist()
        matrix = "".join(f"<M_{i}{j}>{turn[i][j]!r}</M_{i}{j}>" for i in range(3) for j in range(3))
        centre = coordinates(block.frame.position_m[row], origin_height_m)
        yield (
            f"<Photo><Id>{row + 1}</Id><ImagePath>{escape(str(block.image[row]))}</ImagePath>"
            f"<Pose><Rotation>{matrix}</Rotation><Center>{centre}</Center></Pose></Photo>\n"
        )


def tie_points(block: ExportedBlock, origin_height_m: float) -> Iterator[str]:
    """The object points with their measurements."""
    order, begin, images = block.image_points_by_point()
    for point, place in enumerate(block.point_m):
        seen = []
        for entry in range(begin[point], begin[point + 1]):
            row = order[entry]
            x = float(block.x_px[row]) - _HALF_PIXEL
            y = float(block.y_px[row]) - _HALF_PIXEL
            photo = int(images[entry]) + 1
            seen.append(
                f"<Measurement><PhotoId>{photo}</PhotoId><x>{x!r}</x><y>{y!r}</y></Measurement>"
            )
        name = escape(block.name[point].as_py())
        position = coordinates(place, origin_height_m)
        yield (
            f"<TiePoint><Name>{name}</Name><Position>{position}</Position>{''.join(seen)}"
            "</TiePoint>\n"
        )


def coordinates(place_m: Array, origin_height_m: float) -> str:
    """A place in the block's frame as x, y and z, of which z counts from the ellipsoid."""
    x, y, z = place_m.tolist()
    return f"<x>{x!r}</x><y>{y!r}</y><z>{z + origin_height_m!r}</z>"


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """East, north, up at the origin, rotation matrices, pixels from the centre of the first."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_matrix", OF_COMPUTER_VISION),
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
