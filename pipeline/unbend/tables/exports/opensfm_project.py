"""OpenSfM's and ODM's files: tracks.csv, reconstruction.json, camera_models.json, reference_lla.

Lengths in images are in units of the longer side, counted from the image's centre, which is the
corner of pixels (w/2, h/2) of COLMAP's: a pixel (0, 0) of OpenSfM's is the centre of the upper left
one. Image points have nine decimals (OpenSfM itself writes six: 0.007 px at 14,000 px), good to
1e-5 px up to 20,000 px. The frame is topocentric about reference_lla, east, north, up. Names of
images and cameras are those of the run; tracks are numbers, as the ids of `colmap_files`.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.camera.opencv_fisheye import OpenCVFisheye
from unbend.tables.exports.colmap_files import opencv_coefficients, point_ids
from unbend.tables.exports.export_frames import (
    OF_COMPUTER_VISION,
    ExportFrame,
    PixelFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import block_of, refuse_names
from unbend.tables.exports.format import ExportFormat, FinishedRun, Values

_BROWN = ("k1", "k2", "p1", "p2", "k3")


def opensfm_camera(camera: Camera, name: str) -> dict[str, Any]:
    """A camera as in camera_models.json: brown, or fisheye_opencv."""
    longer = max(camera.width_px, camera.height_px)
    fisheye = isinstance(camera.distortion, OpenCVFisheye)
    known = dict.fromkeys(_BROWN, 0.0) | (
        camera.distortion._asdict()
        if fisheye
        else opencv_coefficients(camera, name, "OpenSfM", _BROWN)
    )
    return {
        "projection_type": "fisheye_opencv" if fisheye else "brown",
        "width": camera.width_px, "height": camera.height_px,
        "focal_x": camera.fx_px / longer, "focal_y": camera.fy_px / longer,
        "c_x": (camera.cx_px - 0.5 * camera.width_px) / longer,
        "c_y": (camera.cy_px - 0.5 * camera.height_px) / longer,
    } | known  # fmt: skip


def write_project(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """The four files of a project with one reconstruction."""
    block = block_of(run, ledger)
    refuse_names(block.image, r"[\t\r\n]", "OpenSfM")
    ids = point_ids(block, folder)
    cameras = {name: opensfm_camera(camera, name) for name, camera in block.cameras.items()}
    origin = block.frame.origin_deg.tolist()
    reference = dict(zip(("latitude", "longitude", "altitude"), origin, strict=True))
    for name, content in (("camera_models", cameras), ("reference_lla", reference)):
        (folder / f"{name}.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    # image, point, place in the image, x, y, scale, colour; segmentation and instance: none
    with (folder / "tracks.csv").open("w", encoding="utf-8") as file:
        file.write("OPENSFM_TRACKS_VERSION_v2\n")
        for i, camera, here in block.images():
            longer = max(camera.width_px, camera.height_px)
            x = (block.x_px[here] - 0.5 * camera.width_px) / longer
            y = (block.y_px[here] - 0.5 * camera.height_px) / longer
            rest = f"{1.0 / longer:.9f}\t128\t128\t128\t-1\t-1\n"
            for k, (p, a, b) in enumerate(zip(ids[block.point[here]], x, y, strict=True)):
                file.write(f"{block.image[i]}\t{p}\t{k}\t{a:.9f}\t{b:.9f}\t{rest}")
    turned = Rotation.from_matrix(block.rotation).as_rotvec()
    moved, sigma = block.moved_m, np.sqrt(block.frame.covariance_m2[:, 0, 0])
    shots = {
        image: {
            "rotation": turned[i].tolist(), "translation": moved[i].tolist(),
            "camera": [*cameras][block.camera[i]], "orientation": 1, "scale": 1.0,
            "gps_position": block.frame.position_m[i].tolist(), "covariance": [], "merge_cc": 0,
            "vertices": [], "faces": [],
        } | ({} if np.isnan(sigma[i]) else {"gps_dop": float(sigma[i])})
        for i, image in enumerate(block.image)
    }  # fmt: skip
    head = {"cameras": cameras, "reference_lla": reference, "shots": shots}
    with (folder / "reconstruction.json").open("w", encoding="utf-8") as file:
        file.write("[" + json.dumps(head)[:-1] + ', "points": {')
        for p, place in enumerate(block.point_m.tolist()):
            point = {"color": [128.0, 128.0, 128.0], "coordinates": place}
            file.write(f'{"," * (p > 0)}\n"{ids[p]}": {json.dumps(point)}')
        file.write("}}]\n")
    return int(block.point.size)


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """East, north, up at reference_lla, rotation vectors, lengths of the image's longer side."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_vector", OF_COMPUTER_VISION),
        pixels=PixelFrame("centre of the image", ("right", "down"), "longer side of the image"),
    )


FORMATS = (
    ExportFormat(
        "opensfm", "a block for OpenSfM or ODM: a folder with tracks and reconstruction", "",
        write_project, frame_of_block, marked=("tracks.csv",),
        use=(
            "OpenSfM and ODM correct neither refraction nor earth curvature: nothing must be "
            "switched off in them; keep the calibration fixed (optimize_camera_parameters: no, "
            "ODM: --use-fixed-camera-params)"
        ),
    ),
)  # fmt: skip
