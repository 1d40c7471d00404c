"""Bundler's reconstruction, undistorted and centred: the way into Metashape.

Image points count from the image's centre, x to the right, y up, in pixels; cameras look along -z.
Bundler has a focal length f, k1 and k2, and no principal point. So the points are written as an
ideal camera sees them: f is the principal distance along x, the principal point is in the middle,
(w/2, h/2) in COLMAP's pixels, and k1 = k2 = 0. That works for any distortion. ``calibration.json``
has the ideal camera and the camera that the images were taken with, the air in its lens included;
the latter is also written as Metashape's calibration, a file for each camera. Points that were
measured in one image only are left out.
"""

import json
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unbend.messages import Ledger
from unbend.refraction.camera import model_of
from unbend.refraction.camera.brown_conrady import BrownConrady
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import ExportFormat, FinishedRun, Values
from unbend.tables.exports.export_frames import (
    PHOTOGRAMMETRIC_AXES,
    ExportFrame,
    PixelFrame,
    angles_of_block,
    block_positions,
)
from unbend.tables.exports.exported_block import (
    ExportedBlock,
    add_counts_written,
    block_of,
    ideal_coordinates,
    refuse_names,
)
from unbend.tables.exports.metashape_calibration import name_of_file, write_metashape
from unbend.units import PPM, Array, Integers


def write_bundler(run: FinishedRun, _: Values, folder: Path, ledger: Ledger) -> int:
    """Write bundle.out (v0.3), list.txt with the images in its order, and the calibrations.

    Returns the number of image points written.
    """
    block = block_of(run, ledger)
    refuse_names(block.image, r"[\s\"]", "Bundler")
    xy = _ideal_image_points(block)
    points_with_xy = block.point[np.isfinite(xy[:, 0])]
    views_of_point = np.bincount(points_with_xy, minlength=block.images_of_point.size)
    tied = np.flatnonzero(views_of_point > 1)  # the points that are written
    written = int(views_of_point[tied].sum())
    add_counts_written(block, ledger, image_points=written, points=tied.size)
    report_unwritten(block, written, ledger)
    with (folder / "bundle.out").open("w", encoding="utf-8") as file:
        file.write(f"# Bundle file v0.3\n{block.image.size} {tied.size}\n")
        file.writelines(_lines_of_cameras(block))
        file.writelines(_lines_of_points(block, xy, tied))
    (folder / "list.txt").write_text("\n".join(block.image) + "\n", encoding="utf-8")
    _write_calibrations(run, block, folder)
    return written


def _write_calibrations(run: FinishedRun, block: ExportedBlock, folder: Path) -> None:
    """Write calibration.json, and Metashape's XML of each camera that Metashape supports."""
    calibrations = {}
    files: list[str] = []
    for number, (name, camera) in enumerate(block.cameras.items()):
        lens_change = _lens_change(run, name)
        taken_with = replace(
            camera,
            fx_px=camera.fx_px * (1.0 + lens_change),
            fy_px=camera.fy_px * (1.0 + lens_change),
        )
        file = _unused_name(f"taken_with_{name_of_file(name)}", files)
        is_written = write_metashape(taken_with, folder / file)
        if is_written:
            files.append(file)
        calibrations[name] = {
            "written": _ideal_camera(camera),
            "taken_with": _original_camera(taken_with, lens_change),
            "metashape": file if is_written else None,
            "images": block.image[block.camera == number].tolist(),
        }
    text = json.dumps(calibrations, indent=1) + "\n"
    (folder / "calibration.json").write_text(text, encoding="utf-8")


def _unused_name(name: str, files: Collection[str]) -> str:
    """``name``.xml, with underscores before the ending until it is not among ``files``.

    Upper and lower case count as equal: some file systems do not distinguish them.
    """
    in_use = {file.lower() for file in files}
    while f"{name}.xml".lower() in in_use:
        name += "_"
    return f"{name}.xml"


def report_unwritten(block: ExportedBlock, written: int, ledger: Ledger) -> None:
    """Add to the ledger how many image points of the block are not among the ``written`` ones.

    They are the only one of their object point, or cannot be undistorted.
    """
    single = int(np.sum(block.images_of_point[block.point] < 2))
    if single:
        not_written = messages.single_points_not_written(
            where="observations",
            count=single,
            total=block.point.size,
        )
        ledger.add(not_written)
    beyond = int(block.point.size) - single - written
    if beyond:
        ledger.add(messages.points_beyond_distortion(where="observations", count=beyond))


def _ideal_image_points(block: ExportedBlock) -> Array:
    """(r, 2) undistorted x right, y up [px] from the principal point; NaN without an inverse.

    Both in units of fx: Bundler has one focal length.
    """
    xy = np.full((block.point.size, 2), np.nan)
    for _i, camera, image_points in block.images():
        u, v = ideal_coordinates(camera, block.x_px[image_points], block.y_px[image_points])
        xy[image_points] = np.stack([camera.fx_px * u, -camera.fx_px * v], axis=1)
    return xy


def _lines_of_cameras(block: ExportedBlock) -> Iterator[str]:
    """Five lines for each image: f, k1 and k2; the rotation in three; the translation."""
    cameras = list(block.cameras.values())
    to_bundler = np.diag([1.0, -1.0, -1.0])  # from y down, z forward to y up, z backward
    for number, rotation, translation_m in zip(
        block.camera, block.rotation, block.translation_m, strict=True
    ):
        rows = [
            [cameras[number].fx_px, 0.0, 0.0],
            *to_bundler @ rotation,
            to_bundler @ translation_m,
        ]
        for row in rows:
            yield " ".join(repr(float(value)) for value in row) + "\n"


def _lines_of_points(
    block: ExportedBlock,
    xy: Array,
    tied: Integers,
) -> Iterator[str]:
    """Three lines for each point: position; colour; number of views, and the views.

    A view is the number of the image, the number of the image point in it, x and y. ``xy`` (r, 2)
    are the image points of the block, NaN for those that are not written; ``tied`` (t,) are the
    numbers of the points to write.
    """
    by_point = block.image_points_by_point()
    for point in tied:
        views = []
        for k in range(by_point.begin[point], by_point.begin[point + 1]):
            x, y = xy[by_point.image_point[k]]
            if np.isfinite(x):
                views.append(f"{by_point.image[k]} {by_point.number_in_image[k]} {x!s} {y!s}")
        position = " ".join(map(str, block.point_m[point]))
        yield f"{position}\n128 128 128\n{len(views)} {' '.join(views)}\n"


def _lens_change(run: FinishedRun, name: str) -> float:
    """The median relative change of a camera's principal distance by the air in its lens.

    0 without a usable station of the camera.
    """
    changes_px = run.exposures.changes_px[run.usable_rows(name)]
    if not changes_px.size:
        return 0.0
    return float(np.median(changes_px)) / run.cameras[name].camera.fx_px


def _ideal_camera(camera: Camera) -> dict[str, float]:
    """The ideal camera of bundle.out; its principal point counts from the image's centre."""
    return {
        "f_px": camera.fx_px,
        "k1": 0.0,
        "k2": 0.0,
        "cx_px": 0.0,
        "cy_px": 0.0,
    }


def _original_camera(camera: Camera, lens_change: float) -> dict[str, Any]:
    """The camera that the images were taken with, for calibration.json.

    ``camera`` has the principal distance with the air in the lens: the run removed this change
    from the image points, but the images still have it. ``lens_change`` is that change, relative
    to the calibrated principal distance.
    """
    taken_with = {key: getattr(camera, key) for key in camera.__dataclass_fields__}
    taken_with["lens_change_ppm"] = lens_change / PPM
    taken_with["model"] = model_of(type(camera.distortion)).__name__.rpartition(".")[2]
    taken_with["distortion"] = camera.distortion._asdict()
    if isinstance(camera.distortion, BrownConrady):
        taken_with["coefficients"] = "OpenCV's: Metashape exchanges p1 and p2"
    taken_with["pixel_origin"] = "corner"
    return taken_with


def frame_of_block(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of bundle.out: east, north, up at the origin, pixels from the image's centre."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_matrix", PHOTOGRAMMETRIC_AXES),
        pixels=PixelFrame("centre of the image", ("right", "up"), "px"),
    )


FORMATS = (
    ExportFormat(
        "bundler",
        "a block for Metashape: Bundler's folder, undistorted and centred",
        "",
        write_bundler,
        frame_of_block,
        marked=("bundle.out",),
        use="Metashape has no switch for refraction; adjust there with f fixed and k1, k2 and all "
        "other coefficients at zero, and give the images their own calibration "
        "(taken_with_<camera>.xml) after that",
    ),
)
