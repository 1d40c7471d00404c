"""BINGO's image.dat: image points in millimetres from the image's centre, y up.

For each image: a line with the names of image and camera, lines with name, x and y of each point,
and a line -99. The centre is (w/2, h/2) in COLMAP's pixels. Names have at most 15 characters: of
longer names the last 15 are written, blanks become underscores, and ``names.csv`` lists the changed
names. Written as BINGO documents it; not tested with BINGO itself.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.tables.exports import messages
from unbend.tables.exports.export_format import (
    PIXEL_UM,
    ExportFormat,
    FinishedRun,
    Option,
    Values,
    pixel_mm,
    write_csv_stream,
)
from unbend.tables.exports.export_frames import ExportFrame, PixelFrame
from unbend.tables.exports.exported_block import ExportedBlock, add_counts_of_block, block_of
from unbend.units import Array

_MOST_CHARACTERS = 15  # of a name in BINGO

# Rows: x and y against axes that are turned by 90 degrees counter-clockwise.
_QUARTER_TURN = np.array([[0, 1], [-1, 0]])


def short_names(names: Sequence[str], kind: str) -> list[str]:
    """Names as BINGO takes them, in the same order: their last 15 characters, without blanks.

    ``kind`` is what the names are of, for the message. Refuses (MissionError EXPORT-NAMES) two
    names that become the same.

    >>> short_names(["strip 7/DSC_00012345.tif", "a 1"], "image")
    ['SC_00012345.tif', 'a_1']
    """
    name_of_short: dict[str, str] = {}
    for name in names:
        short = re.sub(r"\s", "_", name)[-_MOST_CHARACTERS:] or "_"
        if short in name_of_short:
            raise messages.names_too_long(
                where="observations",
                kind=kind,
                first=name_of_short[short],
                other=name,
                short=short,
                longest=_MOST_CHARACTERS,
            )
        name_of_short[short] = name
    return [*name_of_short]


def write_bingo(run: FinishedRun, values: Values, folder: Path, ledger: Ledger) -> int:
    """Write image.dat, and names.csv if names were changed; returns the number of image points."""
    block = block_of(run, ledger, intersect=False)
    add_counts_of_block(block, ledger)
    names = {
        "image": [*block.image],
        "camera": [*block.cameras],
        "point": block.point_name.to_pylist(),
    }
    written = {kind: short_names(names_of_kind, kind) for kind, names_of_kind in names.items()}
    pixel_sizes_mm = [pixel_mm(run, name, values) for name in block.cameras]
    for name, size_mm in zip(block.cameras, pixel_sizes_mm, strict=True):
        if np.isnan(size_mm):
            raise messages.pixel_size_unknown(where="--pixel-um", name=name)
    rotation = np.linalg.matrix_power(_QUARTER_TURN, values["quarter_turns"])
    with (folder / "image.dat").open("w", encoding="utf-8") as file:
        file.writelines(_lines_of_images(block, written, pixel_sizes_mm, rotation))
    changed = _changed_names(names, written)
    if changed:
        table = pa.Table.from_pylist(changed)
        write_csv_stream(folder / "names.csv", table.schema, [table])
    return int(block.point.size)


def _lines_of_images(
    block: ExportedBlock,
    names: Mapping[str, Sequence[str]],
    pixel_sizes_mm: Sequence[float],
    rotation: Array,
) -> Iterator[str]:
    """The lines of image.dat.

    ``names`` as they are written, by kind: image, camera, point. ``pixel_sizes_mm`` of the cameras.
    ``rotation`` (2, 2) from x to the right, y up to the axes of BINGO's image.
    """
    for i, camera, image_points in block.images():
        number = block.camera[i]
        from_centre_px = _from_centre_px(block, camera, image_points)
        x_mm, y_mm = rotation @ from_centre_px * pixel_sizes_mm[number]
        yield f"{names['image'][i]} {names['camera'][number]}\n"
        for point, x, y in zip(block.point[image_points], x_mm, y_mm, strict=True):
            yield f"{names['point'][point]} {x:.7f} {y:.7f}\n"
        yield "-99\n"


def _from_centre_px(
    block: ExportedBlock,
    camera: Camera,
    image_points: slice,
) -> Array:
    """(2, n) x to the right and y up [px], from the image's centre, of the image points."""
    right_px = block.x_px[image_points] - 0.5 * camera.width_px
    up_px = 0.5 * camera.height_px - block.y_px[image_points]
    return np.stack([right_px, up_px])


def _changed_names(
    names: Mapping[str, list[str]],
    written: Mapping[str, list[str]],
) -> list[dict[str, str]]:
    """Rows of names.csv: the names that differ from the ``written`` ones, kind by kind."""
    rows = []
    for kind, names_of_kind in names.items():
        for written_name, name in zip(written[kind], names_of_kind, strict=True):
            if written_name != name:
                rows.append({"kind": kind, "written": written_name, "name": name})
    return rows


_AXES_BY_TURNS = (("right", "up"), ("up", "left"), ("left", "down"), ("down", "right"))
"""Directions of x and y in the image after 0, 1, 2 and 3 quarter turns counter-clockwise."""


def frame_of_points(_: FinishedRun, values: Values) -> ExportFrame:
    """The frame of image.dat: image points only, in millimetres from the image's centre."""
    axes = _AXES_BY_TURNS[values["quarter_turns"]]
    return ExportFrame(pixels=PixelFrame("centre of the image", axes, "mm"))


QUARTER_TURNS = Option(
    "quarter_turns",
    int,
    default=0,
    help="quarter turns, counter-clockwise, of the axes of BINGO's image against x to the right, "
    "y up",
    minimum=0,
    maximum=3,
)

FORMATS = (
    ExportFormat(
        "bingo",
        "a block for BINGO: a folder with image.dat",
        "",
        write_bingo,
        frame_of_points,
        options=(PIXEL_UM, QUARTER_TURNS),
        use=(
            "in BINGO, and in Inpho if it reads these files, switch off the correction of "
            "refraction. With orientations in a local Cartesian frame (--format opk-enu) switch "
            "off the correction of earth curvature too; with those in a map projection keep it on, "
            "and that of the projection's scale"
        ),
        marked=("image.dat",),
    ),
)
