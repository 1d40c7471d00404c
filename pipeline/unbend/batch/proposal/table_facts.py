"""What a table of observations, or the block of another program, decides of a mission file."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq

from unbend.batch import messages
from unbend.batch.proposal.values import Proposed, words_of_proposals, yaml_text
from unbend.config.yaml_text import TODO
from unbend.messages import Ledger
from unbend.tables.delimited import csv_names
from unbend.tables.imports.blocks import block_reader, damage_refused
from unbend.tables.observations import Batch, Observations, open_observations
from unbend.units import Array

OPENSFM_FILE = "reconstruction.json"  # stands for the folder of its project

BATCH_ROWS = 250_000
MOST_BATCHES = 4  # a million rows show how large the images are
MOST_BYTES_OF_HEAD = 4000  # of an XML file, in which it says which program wrote it

NAME_OF_HEIGHT = re.compile(
    r"^(h|z|ground|terrain)(_.*)?$|height|elev|^alt|ellips|msl|^h(oe|ö)he",
    re.IGNORECASE,
)
"""Columns whose names say that they may hold heights."""

FILES_OF_BLOCKS = {"cameras.bin": "colmap", "cameras.txt": "colmap", OPENSFM_FILE: "opensfm"}
"""The program that writes a file of this name into the folder of a block."""

PIX4D_CAMERAS = "calibrated_camera_parameters.txt"  # end of the name of Pix4D's file of cameras

WORDS_OF_XML = {b"dbat": "dbat", b"<blocksexchange": "blocksexchange"}
"""The program that writes an XML file with this word near its beginning, in lower case."""

ENDINGS_OF_BLOCKS = {".psz": "metashape", ".db": "colmap"}
"""The program that writes a block as one file with this ending."""

OPEN_HEIGHT = Proposed(
    "height", TODO, "metres; {column: NAME} of the observations; {dem: dem.tif}; intersected"
)
"""The question for ground heights, where the table has no column of that kind."""


@dataclass(frozen=True)
class TableFacts:
    """What a table of observations, or a block, decides, for the template of the mission file.

    format : the program of a block; empty for a table.
    images : the images of the observations.
    remark : how many rows there are.
    columns : keys under ``observations.columns`` whose values are guessed or left open.
    size : how far the observations reach, in words.
    height, reference : the keys of these names under ``ground``; ``heights`` is a remark on both.
    cameras : what a block calls its cameras.
    """

    format: str = ""
    images: tuple[str, ...] = ()
    remark: str = ""
    columns: tuple[Proposed, ...] = ()
    size: str = ""
    height: Proposed = OPEN_HEIGHT
    reference: str = TODO
    heights: str = ""
    cameras: tuple[str, ...] = ()


def block_format(path: Path) -> str:
    """The program that wrote the block in a file or folder; empty for a file that is no block.

    Refuses a folder that has no file of a block.
    """
    if path.is_dir():
        for name, program in FILES_OF_BLOCKS.items():
            if (path / name).is_file():
                return program
        if any(path.glob(f"*{PIX4D_CAMERAS}")):
            return "pix4d"
        files = ", ".join([*FILES_OF_BLOCKS, f"..._{PIX4D_CAMERAS}"])
        raise messages.folder_is_no_block(where=path, files=files)
    ending = path.suffix.lower()
    if ending == ".xml" and path.is_file():
        head = path.read_bytes()[:MOST_BYTES_OF_HEAD].lower()
        for word, program in WORDS_OF_XML.items():
            if word in head:
                return program
        return "metashape"
    return ENDINGS_OF_BLOCKS.get(ending, "")


def facts_of_observations(path: Path) -> TableFacts:
    """Read a table of observations or a block; refuses as `open_observations`."""
    program = block_format(path)
    return facts_of_block(path, program) if program else facts_of_table(path)


def facts_of_block(path: Path, program: str) -> TableFacts:
    """Read the cameras and the image points of a block."""
    with damage_refused(path, program):
        cameras = tuple(block_reader(program).read_cameras(path))
    columns: dict[str, str | None] = {name: name for name in words_of_proposals()["columns"]}
    observations = open_observations(path, columns, None, Ledger(), file_format=program)
    return TableFacts(
        format=program,
        images=observations.images,
        remark=f"{observations.rows} image points of {len(observations.images)} images",
        cameras=cameras,
    )


def facts_of_table(path: Path) -> TableFacts:
    """Read a table of observations, its columns by their names."""
    names = column_names(path)
    guessed = guessed_columns(names)
    keys = proposed_columns(guessed, names)
    unknown = [key.key for key in keys if key.value == TODO]
    unused = [name for name in names if name not in guessed.values()]
    if unknown == ["point"] and unused:  # any column will do to read images, pixels and heights
        guessed["point"] = unused[0]
    elif unknown:
        remark = (
            f"its images are not known yet: {', '.join(unknown)}: no column has a usual name; "
            "rename them in the header of the table, and run init again"
        )
        return TableFacts(remark=remark, columns=keys)
    columns: dict[str, str | None] = {}
    for quantity, name in guessed.items():
        # No name is guessed if the columns cannot be listed; `open_observations` says why.
        columns[quantity] = name or quantity
    return facts_of_columns(path, columns, keys, height_candidates(names, columns))


def facts_of_columns(
    path: Path,
    columns: dict[str, str | None],
    keys: tuple[Proposed, ...],
    candidates: list[str],
) -> TableFacts:
    """Read a table whose ``columns`` are known; ``candidates`` may have the heights of the points.

    ``keys`` are those of the columns in the mission file.
    """
    height = candidates[0] if len(candidates) == 1 else None
    observations = open_observations(path, columns, height, Ledger())
    extent = extent_of(observations)
    reference = TODO if height is None else guessed_reference(height)
    heights = extent.heights
    if reference != TODO:
        heights = f"guessed by the name of the column; {extent.heights}"
    return TableFacts(
        images=observations.images,
        remark=f"{observations.rows} rows of {len(observations.images)} images",
        columns=keys,
        size=extent.pixels,
        height=proposed_height(candidates),
        reference=reference,
        heights=heights,
    )


def column_names(path: Path) -> list[str]:
    """The columns of a CSV or Parquet file; empty for other files, and for one that is damaged."""
    if path.is_file() and path.suffix.lower() in (".csv", ".txt"):
        return csv_names(path)
    try:
        return list(pq.read_schema(path).names)
    except (OSError, ValueError):  # the reader of observations says what is wrong
        return []


def guessed_columns(names: list[str]) -> dict[str, str | None]:
    """The column of each quantity: the one of its name, or of another usual name; or None."""
    # Of names that differ by case, blanks and hyphens alone the first one counts.
    name_of_lower = {re.sub("[ -]+", "_", name.lower()): name for name in reversed(names)}
    columns: dict[str, str | None] = {}
    for quantity, usual_names in words_of_proposals()["columns"].items():
        columns[quantity] = quantity if quantity in names else None
        for usual in usual_names:
            if columns[quantity] is None:
                columns[quantity] = name_of_lower.get(usual)
    return columns


def proposed_columns(columns: Mapping[str, str | None], names: list[str]) -> tuple[Proposed, ...]:
    """Keys of the columns whose names are guessed or left open; none if no columns are listed."""
    proposed = []
    for quantity, name in columns.items():
        if not names or name == quantity:
            continue
        if name is None:
            proposed.append(Proposed(quantity, TODO, f"one of {', '.join(names)}"))
        else:
            proposed.append(Proposed(quantity, yaml_text(name), "guessed by its name"))
    return tuple(proposed)


def height_candidates(names: list[str], columns: Mapping[str, str | None]) -> list[str]:
    """The columns that may hold the heights of the points: ``h_g_m`` alone, or all such names."""
    used = set(columns.values())
    candidates = [name for name in names if NAME_OF_HEIGHT.search(name) and name not in used]
    return ["h_g_m"] if "h_g_m" in candidates else candidates


def proposed_height(candidates: list[str]) -> Proposed:
    """The key ``ground.height`` by the columns that may hold it."""
    if not candidates:
        return OPEN_HEIGHT
    if len(candidates) > 1:
        return Proposed("height", f"{{column: {TODO}}}", f"one of {', '.join(candidates)}")
    (name,) = candidates
    remark = "" if name == "h_g_m" else "guessed by its name: heights of the points [m]"
    return Proposed("height", f"{{column: {yaml_text(name)}}}", remark)


def guessed_reference(column: str) -> str:
    """What heights count from by the name of their column; TODO where it does not say one thing."""
    references = set()
    for part, reference in words_of_proposals()["datums"].items():
        if part in column.lower():
            references.add(reference)
    return references.pop() if len(references) == 1 else TODO


class Extent(NamedTuple):
    """How far observations reach, in words: their pixels, and the heights of their points."""

    pixels: str
    heights: str


def extent_of(observations: Observations) -> Extent:
    """How far the first million observations reach."""
    batches = list(islice(observations.batches(BATCH_ROWS), MOST_BATCHES))
    x = reach_text([batch.x_given_px for batch in batches])
    y = reach_text([batch.y_given_px for batch in batches])
    pixels = (
        f"99 % of the observations are within {x.most} x {y.most} px, all within {x.largest} x "
        f"{y.largest}"
    )
    return Extent(pixels, heights_text(batches))


class Reach(NamedTuple):
    """Pixels that 99 % of the observations, and all of them, do not exceed."""

    most: str
    largest: str


def reach_text(pixels: list[Array]) -> Reach:
    """How far the pixels of some batches reach, from 0 on; 0 without any."""
    most, largest = np.nanpercentile(np.concatenate([np.zeros(1), *pixels]), [99, 100]).round()
    return Reach(f"{most:.0f}", f"{largest:.0f}")


def heights_text(batches: list[Batch]) -> str:
    """The lowest, highest and median height of the points of some batches; empty without any."""
    heights = [batch.ground for batch in batches if batch.ground is not None]
    ground = np.concatenate([np.empty(0), *heights])
    if not np.isfinite(ground).any():
        return ""
    low, middle, high = np.nanpercentile(ground, [0.0, 50.0, 100.0])
    return f"the heights are {low:.0f} to {high:.0f} m, {middle:.0f} in the median"
