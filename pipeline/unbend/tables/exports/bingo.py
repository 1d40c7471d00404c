"""BINGO's image.dat: image points in millimetres from the image's centre, y up.

A line with the names of image and camera, a line with name, x and y for each point, and -99 at the
end of each image. The centre is the corner of pixels (w/2, h/2) of COLMAP's. Names have at most 15
characters: of longer ones the last 15, blanks as underscores, and ``names.csv`` has all that were
changed. Written as documented; BINGO itself was not there to read it.
"""

import re
from collections.abc import Mapping, Sequence
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

_LONGEST = 15


def short_names(names: Sequence[str], kind: str) -> list[str]:
    """Names as BINGO takes them; refuses (MissionError EXPORT-NAMES) those that become the same.

    >>> short_names(["strip 7/DSC_00012345.tif", "a 1"], "image")
    ['SC_00012345.tif', 'a_1']
    """
    first: dict[str, str] = {}
    for name in names:
        short = re.sub(r"\s", "_", name)[-_LONGEST:] or "_"
        if short in first:
            raise messages.names_too_long(
                where="observations",
                kind=kind,
                one=first[short],
                other=name,
                short=short,
                longest=_LONGEST,
            )
        first[short] = name
    return [*first]


def write_bingo(run: FinishedRun, values: Values, folder: Path, ledger: Ledger) -> int:
    """image.dat, and names.csv where names were changed."""
    block = block_of(run, ledger, intersect=False)
    add_counts_of_block(block, ledger)
    names = {
        "image": [*block.image],
        "camera": [*block.cameras],
        "point": block.name.to_pylist(),
    }
    short = {kind: short_names(names_of_kind, kind) for kind, names_of_kind in names.items()}
    sizes_mm = [pixel_mm(run, name, values) for name in block.cameras]
    for name, size_mm in zip(block.cameras, sizes_mm, strict=True):
        if np.isnan(size_mm):
            raise messages.pixel_size_unknown(where="--pixel-um", name=name)
    turn = np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), values["quarter_turns"])
    with (folder / "image.dat").open("w", encoding="utf-8") as file:
        for i, camera, here in block.images():
            number = block.camera[i]
            x_mm, y_mm = turn @ _from_middle_px(block, camera, here) * sizes_mm[number]
            file.write(f"{short['image'][i]} {short['camera'][number]}\n")
            for point, x, y in zip(block.point[here], x_mm, y_mm, strict=True):
                file.write(f"{short['point'][point]} {x:.7f} {y:.7f}\n")
            file.write("-99\n")
    changed = _changed_names(names, short)
    if changed:
        table = pa.Table.from_pylist(changed)
        write_csv_stream(folder / "names.csv", table.schema, [table])
    return int(block.point.size)


def _from_middle_px(
    block: ExportedBlock,
    camera: Camera,
    here: slice,
) -> Array:
    """(2, n) x to the right and y up [px] of image points of a camera, from its middle."""
    right_px = block.x_px[here] - 0.5 * camera.width_px
    up_px = 0.5 * camera.height_px - block.y_px[here]
    return np.stack([right_px, up_px])


def _changed_names(
    names: Mapping[str, list[str]],
    short: Mapping[str, list[str]],
) -> list[dict[str, str]]:
    """The names that are written otherwise, one row each: kind, as written, and the name."""
    rows = []
    for kind, names_of_kind in names.items():
        for written, name in zip(short[kind], names_of_kind, strict=True):
            if written != name:
                rows.append({"kind": kind, "written": written, "name": name})
    return rows


_AXES_BY_TURNS = (("right", "up"), ("up", "left"), ("left", "down"), ("down", "right"))


def frame_of_points(_: FinishedRun, values: Values) -> ExportFrame:
    """Image points alone, in millimetres from the image's centre."""
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
            "in BINGO, and in Inpho if it reads these files, switch off the corrections of "
            "refraction and earth curvature, and adjust in a Cartesian frame; --format opk-enu "
            "writes positions and angles in such a frame"
        ),
        marked=("image.dat",),
    ),
)
