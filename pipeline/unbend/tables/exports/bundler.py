"""Bundler's reconstruction, undistorted and centred: the way into Metashape.

Image points count from the image's centre, x to the right, y up, in pixels; cameras look along -z.
Bundler has a focal length f, k1 and k2, and no principal point. So the points are those of an ideal
camera, f the principal distance along x, the principal point in the middle and k1 = k2 = 0: that
holds every distortion. ``calibration.json`` beside it has the ideal camera and the one that the
images were taken with, the air in its lens included; that one is a calibration of Metashape's too,
in a file for each camera. Where a program counts its pixels from drops out: the middle is (w/2,
h/2) of COLMAP's. Points that were measured in one image only are left out.
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
    PHOTOGRAMMETRIC,
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
    """bundle.out (v0.3), list.txt with the images in its order, and the calibrations."""
    block = block_of(run, ledger)
    refuse_names(block.image, r"[\s\"]", "Bundler")
    xy = _centred_points(block)
    views_of_point = np.bincount(block.point[np.isfinite(xy[:, 0])], minlength=block.count.size)
    tied = np.flatnonzero(views_of_point > 1)
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
    """calibration.json, and for each camera that Metashape can hold a calibration for it."""
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
    """The name of an XML that no other camera has: two names may differ in what files cannot."""
    in_use = {file.lower() for file in files}
    while f"{name}.xml".lower() in in_use:
        name += "_"
    return f"{name}.xml"


def report_unwritten(block: ExportedBlock, written: int, ledger: Ledger) -> None:
    """Image points that the file lacks: alone of their object point, or not to be undistorted."""
    single = int(np.sum(block.count[block.point] < 2))
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


def _centred_points(block: ExportedBlock) -> Array:
    """(r, 2) ideal image points [px] from the middle of the image, y up; NaN for none."""
    xy = np.full((block.point.size, 2), np.nan)
    for _i, camera, here in block.images():
        u, v = ideal_coordinates(camera, block.x_px[here], block.y_px[here])
        xy[here] = np.stack([camera.fx_px * u, -camera.fx_px * v], axis=1)
    return xy


def _lines_of_cameras(block: ExportedBlock) -> Iterator[str]:
    """Five lines for each image: f, k1 and k2, the rotation, the translation."""
    cameras = list(block.cameras.values())
    to_bundler = np.diag([1.0, -1.0, -1.0])
    for number, turn, move in zip(block.camera, block.rotation, block.moved_m, strict=True):
        rows = [
            [cameras[number].fx_px, 0.0, 0.0],
            *to_bundler @ turn,
            to_bundler @ move,
        ]
        for row in rows:
            yield " ".join(repr(float(value)) for value in row) + "\n"


def _lines_of_points(
    block: ExportedBlock,
    xy: Array,
    tied: Integers,
) -> Iterator[str]:
    """Three lines for each point: its place, its colour, and its views with their image points."""
    order, begin, images = block.image_points_by_point()
    place_in_image = order - block.first[images]
    for point in tied:
        views = []
        for k in range(begin[point], begin[point + 1]):
            x, y = xy[order[k]]
            if np.isfinite(x):
                views.append(f"{images[k]} {place_in_image[k]} {x!s} {y!s}")
        place = " ".join(map(str, block.point_m[point]))
        yield f"{place}\n128 128 128\n{len(views)} {' '.join(views)}\n"


def _lens_change(run: FinishedRun, name: str) -> float:
    """The median change of a camera's principal distance by the air in its lens, a part of it."""
    changes_px = run.exposures.changes_px[run.rows_of(name)]
    if not changes_px.size:
        return 0.0
    return float(np.median(changes_px)) / run.cameras[name].camera.fx_px


def _ideal_camera(camera: Camera) -> dict[str, float]:
    """The camera of the points that are written."""
    return {
        "f_px": camera.fx_px,
        "k1": 0.0,
        "k2": 0.0,
        "cx_px": 0.0,
        "cy_px": 0.0,
    }


def _original_camera(camera: Camera, lens_change: float) -> dict[str, Any]:
    """The camera that the images were taken with.

    ``lens_change`` is what the air in the lens added to the calibrated principal distance, as a
    part of it; where the run removed it, the images still have it.
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
    """East, north, up at the origin, rotation matrices, pixels from the image's centre."""
    return ExportFrame(
        positions=block_positions(run.stations),
        angles=angles_of_block("rotation_matrix", PHOTOGRAMMETRIC),
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
