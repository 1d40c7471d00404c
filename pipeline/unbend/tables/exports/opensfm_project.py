"""OpenSfM's and ODM's files: tracks.csv, reconstruction.json, camera_models.json, reference_lla.

Lengths in images are in units of the longer side, counted from the image's centre, which is the
corner of pixels (w/2, h/2) of COLMAP's: a pixel (0, 0) of OpenSfM's is the centre of the upper left
one. Image points have nine decimals (OpenSfM itself writes six: 0.007 px at 14,000 px), good to
1e-5 px up to 20,000 px. The frame is topocentric about reference_lla, east, north, up. Names of
images and cameras are those of the run; tracks are numbers, as the ids of `colmap_files`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports.colmap_files import opencv_coefficients, point_ids
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, Values
from unbend.tables.exports.export_frames import (
    COMPUTER_VISION_AXES,
    ExportFrame,
    PixelFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import (
    ExportedBlock,
    add_counts_of_block,
    block_of,
    refuse_names,
)
from unbend.units import Integers

_BROWN = ("k1", "k2", "p1", "p2", "k3")


def opensfm_camera(camera: Camera, name: str) -> dict[str, Any]:
    """A camera as in camera_models.json: brown, or fisheye_opencv.

    Refuses (MissionError EXPORT-DISTORTION) a distortion that brown does not have; ``name`` of the
    camera is for the message.
    """
    longer_side_px = max(camera.width_px, camera.height_px)
    coefficients = dict.fromkeys(_BROWN, 0.0)
    if isinstance(camera.distortion, OpenCVFisheye):
        projection = "fisheye_opencv"
        coefficients |= camera.distortion._asdict()
    else:
        projection = "brown"
        coefficients |= opencv_coefficients(camera, name, "OpenSfM", _BROWN)
    return {
        "projection_type": projection,
        "width": camera.width_px,
        "height": camera.height_px,
        "focal_x": camera.fx_px / longer_side_px,
        "focal_y": camera.fy_px / longer_side_px,
        "c_x": (camera.cx_px - 0.5 * camera.width_px) / longer_side_px,
        "c_y": (camera.cy_px - 0.5 * camera.height_px) / longer_side_px,
        **coefficients,
    }


def write_project(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """Write the four files of a project with one reconstruction; the number of image points."""
    block = block_of(run, ledger)
    add_counts_of_block(block, ledger)
    refuse_names(block.image, r"[\t\r\n]", "OpenSfM")
    ids = point_ids(block, folder)
    cameras = {name: opensfm_camera(camera, name) for name, camera in block.cameras.items()}
    latitude, longitude, altitude = block.frame.origin_deg.tolist()
    reference = {
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
    }
    _write_json(folder / "camera_models.json", cameras)
    _write_json(folder / "reference_lla.json", reference)
    _write_tracks(block, ids, folder / "tracks.csv")
    head = {
        "cameras": cameras,
        "reference_lla": reference,
        "shots": _shots(block),
    }
    _write_reconstruction(head, block, ids, folder / "reconstruction.json")
    return int(block.point.size)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def _write_tracks(block: ExportedBlock, ids: Integers, path: Path) -> None:
    """Write tracks.csv, a line for each image point.

    Columns: image, point, number in the image, x, y, scale, red, green, blue, and -1 for each of
    segmentation and instance, which the run does not have. ``ids`` (p,) of the points.
    """
    with path.open("w", encoding="utf-8") as file:
        file.write("OPENSFM_TRACKS_VERSION_v2\n")
        for i, camera, image_points in block.images():
            image = block.image[i]
            longer_side_px = max(camera.width_px, camera.height_px)
            x = (block.x_px[image_points] - 0.5 * camera.width_px) / longer_side_px
            y = (block.y_px[image_points] - 0.5 * camera.height_px) / longer_side_px
            ids_and_xy = zip(ids[block.point[image_points]], x, y, strict=True)
            one_pixel = 1.0 / longer_side_px  # the scale
            ending = f"{one_pixel:.9f}\t128\t128\t128\t-1\t-1\n"
            for keypoint, (point, x_point, y_point) in enumerate(ids_and_xy):
                file.write(f"{image}\t{point}\t{keypoint}\t{x_point:.9f}\t{y_point:.9f}\t{ending}")


def _shots(block: ExportedBlock) -> dict[str, dict[str, Any]]:
    """The shots of reconstruction.json, by the names of the images."""
    cameras = [*block.cameras]
    rotation = Rotation.from_matrix(block.rotation).as_rotvec()
    translation = block.translation_m
    sigma_m = np.sqrt(block.frame.covariance_m2[:, 0, 0])  # to the east
    shots = {}
    for i, image in enumerate(block.image):
        shot = {
            "rotation": rotation[i].tolist(),
            "translation": translation[i].tolist(),
            "camera": cameras[block.camera[i]],
            "orientation": 1,
            "scale": 1.0,
            "gps_position": block.frame.position_m[i].tolist(),
            "covariance": [],
            "merge_cc": 0,
            "vertices": [],
            "faces": [],
        }
        if not np.isnan(sigma_m[i]):
            shot["gps_dop"] = float(sigma_m[i])
        shots[image] = shot
    return shots


def _write_reconstruction(
    head: Mapping[str, Any],
    block: ExportedBlock,
    ids: Integers,
    path: Path,
) -> None:
    """Write a list of one reconstruction: the keys of ``head``, then ``points``.

    ``ids`` (p,) of the points. Points are written one by one, because all at once fill the memory.
    """
    separator = ""
    with path.open("w", encoding="utf-8") as file:
        file.write("[" + json.dumps(head)[:-1] + ', "points": {')
        # Ids of points without a position are at the end, and not used.
        for point_id, position in zip(ids, block.point_m.tolist(), strict=False):
            point = {"color": [128.0, 128.0, 128.0], "coordinates": position}
            file.write(f'{separator}\n"{point_id}": {json.dumps(point)}')
            separator = ","
        file.write("}}]\n")


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of a project: at reference_lla, pixels in units of the image's longer side."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_vector", COMPUTER_VISION_AXES),
        pixels=PixelFrame("centre of the image", ("right", "down"), "longer side of the image"),
    )


FORMATS = (
    ExportFormat(
        "opensfm",
        "a block for OpenSfM or ODM: a folder with tracks and reconstruction",
        "",
        write_project,
        frame_of_block,
        marked=("tracks.csv",),
        use="OpenSfM and ODM correct neither refraction nor earth curvature: nothing must be "
        "switched off in them; keep the calibration fixed (optimize_camera_parameters: no, "
        "ODM: --use-fixed-camera-params)",
    ),
)
