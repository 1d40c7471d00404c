"""Bundler's reconstruction, undistorted and centred: the way into Metashape.

Image points count from the image's centre, x to the right, y up, in pixels; cameras look along -z.
Bundler has a focal length f, k1 and k2, and no principal point. So the points are those of an ideal
camera, f the principal distance along x, the principal point in the middle and k1 = k2 = 0: that
holds every distortion. ``calibration.json`` beside it has the ideal camera and the one that the
images were taken with. Where a program counts its pixels from drops out: the middle is (w/2, h/2)
of COLMAP's. Points that were measured in one image only are left out.
"""

import json
from pathlib import Path

import numpy as np

from unbend.messages import Ledger
from unbend.refraction.camera import model_of
from unbend.tables.exports import messages
from unbend.tables.exports.export_frames import (
    PHOTOGRAMMETRIC,
    ExportFrame,
    PixelFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import block_of, ideal_coordinates, refuse_names
from unbend.tables.exports.format import ExportFormat, FinishedRun, Values


def write_bundler(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """bundle.out (v0.3), list.txt with the images in its order, calibration.json."""
    block = block_of(run, ledger)
    refuse_names(block.image, r"[\s\"]", "Bundler")
    cameras = list(block.cameras.values())
    xy = np.full((block.point.size, 2), np.nan)
    for _i, own, here in block.images():
        u, v = ideal_coordinates(own, block.x_px[here], block.y_px[here])
        xy[here] = np.stack([own.fx_px * u, -own.fx_px * v], axis=1)
    seen = np.isfinite(xy[:, 0])
    count = np.bincount(block.point[seen], minlength=block.count.size)
    missing = int(np.sum(~seen | (count[block.point] < 2)))
    if missing:
        ledger.add(messages.points_left_out(where="observations", count=missing))
    to_bundler = np.diag([1.0, -1.0, -1.0])
    order, begin, images = block.of_points()
    tied = np.flatnonzero(count > 1)
    with (folder / "bundle.out").open("w", encoding="utf-8") as file:
        file.write(f"# Bundle file v0.3\n{block.image.size} {tied.size}\n")
        for camera, turn, move in zip(block.camera, block.rotation, block.moved_m, strict=True):
            rows = [[cameras[camera].fx_px, 0.0, 0.0], *to_bundler @ turn, to_bundler @ move]
            file.writelines(" ".join(repr(float(n)) for n in row) + "\n" for row in rows)
        for p in tied:
            views = [
                f"{image} {row - block.first[image]} {xy[row, 0]!s} {xy[row, 1]!s}"
                for row, image in zip(order[begin[p] : begin[p + 1]],
                                      images[begin[p] : begin[p + 1]], strict=True) if seen[row]
            ]  # fmt: skip
            place = " ".join(map(str, block.point_m[p]))
            file.write(f"{place}\n128 128 128\n{len(views)} {' '.join(views)}\n")
    (folder / "list.txt").write_text("\n".join(block.image) + "\n", encoding="utf-8")
    calibrations = {
        name: {
            "written": {"f_px": camera.fx_px, "k1": 0.0, "k2": 0.0, "cx_px": 0.0, "cy_px": 0.0},
            "taken_with": {key: getattr(camera, key) for key in camera.__dataclass_fields__}
            | {
                "model": model_of(type(camera.distortion)).__name__.rpartition(".")[2],
                "distortion": camera.distortion._asdict(),
                "pixel_origin": "corner",
            },
            "images": block.image[block.camera == number].tolist(),
        }
        for number, (name, camera) in enumerate(block.cameras.items())
    }
    text = json.dumps(calibrations, indent=1) + "\n"
    (folder / "calibration.json").write_text(text, encoding="utf-8")
    return int(block.point.size) - missing


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """East, north, up at the origin, rotation matrices, pixels from the image's centre."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_matrix", PHOTOGRAMMETRIC),
        pixels=PixelFrame("centre of the image", ("right", "up"), "px"),
    )


FORMATS = (
    ExportFormat(
        "bundler", "a block for Metashape: Bundler's folder, undistorted and centred", "",
        write_bundler, frame_of_block, marked=("bundle.out",),
        use="Metashape has no switch for refraction; adjust there with f fixed and k1, k2 and all "
        "other coefficients at zero, and give the images their own calibration (calibration.json) "
        "after that",
    ),
)  # fmt: skip
