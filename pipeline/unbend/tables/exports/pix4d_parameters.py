"""Pix4D's files of calibrated parameters, with image points: a folder as its ``params``.

A point X is seen at K R (X - t), so the camera has x right, y down, z forward; omega, phi, kappa
are those of photogrammetry, in degrees. All in the block's frame, east, north, up: a local
coordinate system in Pix4D, without an offset. Pixels count from the corner of the image, as
COLMAP's. Image points are listed under the name of their image without its ending.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from unbend.flight.rotations import opk_of_quaternion
from unbend.messages import Ledger
from unbend.tables.exports import messages
from unbend.tables.exports.blocks_exchange_xml import plain_coefficients
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, Values
from unbend.tables.exports.export_frames import (
    CORNER_PIXELS,
    EAST_NORTH_UP,
    ExportFrame,
    angles_of_photogrammetry,
    block_positions,
)
from unbend.tables.exports.exported_block import (
    ExportedBlock,
    add_counts_of_block,
    block_of,
    refuse_names,
)

_HEAD = (
    "fileName imageWidth imageHeight \n"
    "camera matrix K [3x3]\n"
    "radial distortion [3x1]\n"
    "tangential distortion [2x1]\n"
    "camera position t [3x1]\n"
    "camera rotation R [3x3]\n"
    "camera model m = K [R|-Rt] X\n\n"
)
_PREFIX = "unbend_"  # in the place of the project's name
_SCALE = 1.0  # of each image point: the run does not know the scale at which it was detected


def write_pix4d(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """Write the four files of a project; returns the number of image points.

    Refuses (MissionError EXPORT-NAMES) names with blanks, points that begin with -, and images
    that differ only in their endings.
    """
    block = block_of(run, ledger, intersect=False)
    add_counts_of_block(block, ledger)
    refuse_names(block.image, r"\s", "Pix4D")
    refuse_names(block.point_name.to_pylist(), r"\s|^-", "Pix4D")
    stems = [str(PurePosixPath(name).with_suffix("")) for name in block.image.tolist()]
    for stem, count in Counter(stems).items():
        if count > 1:
            raise messages.name_with_separator(where="observations", name=stem, program="Pix4D")
    cameras = folder / f"{_PREFIX}calibrated_camera_parameters.txt"
    cameras.write_text(_HEAD + "".join(parameters_of_images(block)), encoding="utf-8")
    write_external(block, folder / f"{_PREFIX}calibrated_external_camera_parameters.txt")
    (folder / f"{_PREFIX}offset.xyz").write_text("0.000 0.000 0.000\n", encoding="utf-8")
    with (folder / f"{_PREFIX}tp_pix4d.txt").open("w", encoding="utf-8") as file:
        file.writelines(lines_of_image_points(block, stems))
    return int(block.point.size)


def lines_of_image_points(block: ExportedBlock, stems: Sequence[str]) -> Iterator[str]:
    """For each image its name without ending (``stems``), lines of image points, and -99."""
    for i, _camera, image_points in block.images():
        yield f"{stems[i]}\n"
        points = block.point_name.take(block.point[image_points]).to_pylist()
        x_px = block.x_px[image_points].tolist()
        y_px = block.y_px[image_points].tolist()
        for point, x, y in zip(points, x_px, y_px, strict=True):
            yield f"{point} {x!r} {y!r} {_SCALE}\n"
        yield "-99\n"


def parameters_of_images(block: ExportedBlock) -> list[str]:
    """The text of each image: its name, size, K, distortion, position and rotation."""
    coefficients_of_cameras = [
        plain_coefficients(camera, name, "Pix4D") for name, camera in block.cameras.items()
    ]
    texts = []
    for i, camera, _image_points in block.images():
        coefficients = coefficients_of_cameras[block.camera[i]]
        rows = [
            [camera.fx_px, 0.0, camera.cx_px],
            [0.0, camera.fy_px, camera.cy_px],
            [0.0, 0.0, 1.0],
            [coefficients["k1"], coefficients["k2"], coefficients["k3"]],
            [coefficients["p1"], coefficients["p2"]],
            block.frame.position_m[i].tolist(),
            *block.rotation[i].tolist(),
        ]
        lines = [f"{block.image[i]} {camera.width_px} {camera.height_px}"]
        lines += [" ".join(map(repr, row)) for row in rows]
        texts.append("\n".join(lines) + "\n")
    return texts


def write_external(block: ExportedBlock, path: Path) -> None:
    """Write the file of X, Y, Z [m], omega, phi and kappa [deg]."""
    opk_deg = np.degrees(opk_of_quaternion(block.frame.quaternion, "omega_phi_kappa"))
    with path.open("w", encoding="utf-8") as file:
        file.write("imageName X Y Z Omega Phi Kappa\n")
        for i, name in enumerate(block.image.tolist()):
            position = " ".join(f"{value:.6f}" for value in block.frame.position_m[i])
            angles = " ".join(f"{value:.9f}" for value in opk_deg[i])
            file.write(f"{name} {position} {angles}\n")


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of the files: positions and angles at the origin, pixels from the corner."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_photogrammetry(EAST_NORTH_UP, "origin"),
        pixels=CORNER_PIXELS,
    )


FORMATS = (
    ExportFormat(
        "pix4d",
        "a block as Pix4D's calibrated parameters: a folder with tie points",
        "",
        write_pix4d,
        frame_of_block,
        marked=(f"{_PREFIX}tp_pix4d.txt",),
        use=(
            "Pix4D corrects neither refraction nor earth curvature: nothing must be switched off "
            "in it; use a local coordinate system in metres"
        ),
    ),
)
