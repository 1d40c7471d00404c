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
    OF_COMPUTER_VISION,
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
    """A camera as in camera_models.json: brown, or fisheye_opencv."""
    longer = max(camera.width_px, camera.height_px)
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
        "focal_x": camera.fx_px / longer,
        "focal_y": camera.fy_px / longer,
        "c_x": (camera.cx_px - 0.5 * camera.width_px) / longer,
        "c_y": (camera.cy_px - 0.5 * camera.height_px) / longer,
        **coefficients,
    }


def write_project(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """The four files of a project with one reconstruction."""
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
    """The image points: image, point, place in the image, x, y, scale, colour.

    And segmentation and instance, of which there is none: -1.
    """
    with path.open("w", encoding="utf-8") as file:
        file.write("OPENSFM_TRACKS_VERSION_v2\n")
        for i, camera, here in block.images():
            image = block.image[i]
            longer = max(camera.width_px, camera.height_px)
            x = (block.x_px[here] - 0.5 * camera.width_px) / longer
            y = (block.y_px[here] - 0.5 * camera.height_px) / longer
            places = zip(ids[block.point[here]], x, y, strict=True)
            ending = f"{1.0 / longer:.9f}\t128\t128\t128\t-1\t-1\n"
            for keypoint, (point, x_point, y_point) in enumerate(places):
                place = f"{keypoint}\t{x_point:.9f}\t{y_point:.9f}"
                file.write(f"{image}\t{point}\t{place}\t{ending}")


def _shots(block: ExportedBlock) -> dict[str, dict[str, Any]]:
    """The images as a reconstruction has them, by their names."""
    cameras = [*block.cameras]
    rotation = Rotation.from_matrix(block.rotation).as_rotvec()
    translation = block.moved_m
    sigma_m = np.sqrt(block.frame.covariance_m2[:, 0, 0])
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
    """A list of one reconstruction, with its points behind what the ``head`` has."""
    separator = ""
    with path.open("w", encoding="utf-8") as file:
        file.write("[" + json.dumps(head)[:-1] + ', "points": {')
        for number, place in zip(ids, block.point_m.tolist(), strict=False):
            point = {"color": [128.0, 128.0, 128.0], "coordinates": place}
            file.write(f'{separator}\n"{number}": {json.dumps(point)}')
            separator = ","
        file.write("}}]\n")


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """East, north, up at reference_lla, rotation vectors, lengths of the image's longer side."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_vector", OF_COMPUTER_VISION),
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
