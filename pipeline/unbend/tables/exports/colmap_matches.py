"""Matches of the images of a block as COLMAP's database has them, made new or copied.

New matches tie each pair of images of a point. If the run read a database, its matches and
geometries are copied, for the keypoints that the block still has.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from unbend.tables.exports.exported_block import ExportedBlock
from unbend.tables.imports.blocks import damage_refused
from unbend.tables.imports.blocks.colmap import open_database
from unbend.tables.imports.blocks.messages import matches_cut
from unbend.units import Integers

_MOST_IMAGES = 2_147_483_647  # COLMAP's kMaxNumImages: pair_id = first * this + second
_CALIBRATED = 2  # configuration of two views with calibrated cameras

Row = tuple[Any, ...]
"""A row of a table of the database."""


@dataclass(frozen=True, eq=False)
class _CopiedImage:
    """An image of the block that is also in the database that was read.

    ``number`` counts from 1. ``new_index`` is the index in the block's image of each keypoint of
    the database, -1 for keypoints that were left out. Its last element is -1 too: indices beyond
    the last keypoint of the block are clipped to it.
    """

    number: int
    new_index: Integers


def copied_rows(block: ExportedBlock, source: Path) -> Iterator[Row]:
    """Rows for ``matches`` and ``two_view_geometries``, from the database that the run read.

    A row is the table, pair_id, number of matches, their indices as bytes; for a geometry also its
    configuration. The block's points have the names ``image:index`` of the keypoints of that
    database. Indices become those in the exported image; matches of keypoints that were left out
    are left out. The matrices of a geometry are not copied, because they are of bent rays.
    Refuses (InputError IMPORT-FORMAT) a database without these tables, and matches cut short.
    """
    copied = _copied_images(block)
    with damage_refused(source, "colmap"), closing(open_database(source)) as database:
        for table in ("matches", "two_view_geometries"):
            for pair in _pairs_read(database, source, table):
                if pair.first in copied and pair.second in copied:
                    pair_and_matches = _copied_pair(
                        pair.matches,
                        copied[pair.first],
                        copied[pair.second],
                    )
                    if pair_and_matches is not None:
                        yield table, *pair_and_matches, *pair.configuration


@dataclass(frozen=True, eq=False)
class _PairRead:
    """A row of matches of the database that was read.

    ``first``, ``second`` : names of the images, None for an image that the database does not list.
    ``matches`` (m, 2) : indices of the keypoints. ``configuration`` : that of a geometry as the
    only element; empty for the table ``matches``.
    """

    first: str | None
    second: str | None
    matches: NDArray[np.uint32]
    configuration: list[int]


def _pairs_read(
    database: sqlite3.Connection,
    source: Path,
    table: str,
) -> Iterator[_PairRead]:
    """The rows of a table, ``matches`` or ``two_view_geometries``; refuses matches cut short.

    ``source`` is the path of the database, for the message.
    """
    names = dict(database.execute("SELECT image_id, name FROM images"))
    columns = "rows, cols, data, pair_id"
    if table == "two_view_geometries":
        columns += ", config"
    query = f"SELECT {columns} FROM {table} WHERE rows > 0"
    for row in database.execute(query):
        count, width, blob = row[:3]
        pair_id, *configuration = row[3:]
        first, second = (names.get(number) for number in divmod(pair_id, _MOST_IMAGES))
        if width != 2 or len(blob or b"") != 8 * count:
            raise matches_cut(
                where=source,
                table=table,
                one=str(first),
                other=str(second),
            )
        matches = np.frombuffer(blob, "<u4").reshape(count, 2)
        yield _PairRead(first, second, matches, configuration)


def _copied_images(block: ExportedBlock) -> dict[str, _CopiedImage]:
    """The images of a block, by their names, from its points with the names ``image:index``."""
    images = {}
    for i, _camera, image_points in block.images():
        image = block.image[i]
        points = block.point_name.take(pa.array(block.point[image_points]))
        prefix_bytes = len(f"{image}:".encode())
        index_texts = pc.binary_replace_slice(points, 0, prefix_bytes, "")
        old_index = index_texts.cast(pa.int64()).to_numpy()
        new_index = np.full(old_index.max(initial=0) + 2, -1)
        new_index[old_index] = np.arange(old_index.size)
        images[image] = _CopiedImage(i + 1, new_index)
    return images


def _copied_pair(
    matches: NDArray[np.uint32],
    first: _CopiedImage,
    second: _CopiedImage,
) -> tuple[int, int, bytes] | None:
    """pair_id, number of matches and their indices as bytes; None without a match that is kept.

    ``matches`` (m, 2) are indices in the database that was read. A match is kept if both keypoints
    are in the block. The image of the smaller number comes first, as COLMAP requires.
    """
    first_index = first.new_index.take(
        matches[:, 0],
        mode="clip",
    )
    second_index = second.new_index.take(
        matches[:, 1],
        mode="clip",
    )
    columns = [first_index, second_index]
    if second.number < first.number:
        first, second = second, first
        columns.reverse()
    both = np.stack(columns, axis=1)
    is_kept = both.min(axis=1) >= 0
    kept = both[is_kept].astype("<u4")
    if len(kept) == 0:
        return None
    return first.number * _MOST_IMAGES + second.number, len(kept), kept.tobytes()


def match_rows(block: ExportedBlock) -> Iterator[Row]:
    """Rows for ``matches`` and ``two_view_geometries`` of the pairs of images with common points.

    Rows are as of `copied_rows`. Each pair occurs once, the image of the smaller number first.
    """
    by_point = block.image_points_by_point()
    for i, _camera, image_points in block.images():
        point = block.point[image_points]
        index, entry = _pairs_by_point(by_point.begin[point], block.images_of_point[point])
        is_later = np.flatnonzero(by_point.image[entry] > i)
        pairs = is_later[np.argsort(by_point.image[entry[is_later]], kind="stable")]
        entry = entry[pairs]
        matches = np.stack([index[pairs], by_point.number_in_image[entry]], axis=1).astype("<u4")
        for other, matches_of_pair in _by_image(by_point.image[entry], matches):
            row = (
                (i + 1) * _MOST_IMAGES + other + 1,
                len(matches_of_pair),
                matches_of_pair.tobytes(),
            )
            yield "matches", *row
            yield "two_view_geometries", *row, _CALIBRATED


def _by_image(
    image: Integers,
    matches: NDArray[np.uint32],
) -> Iterator[tuple[int, NDArray[np.uint32]]]:
    """Each image with its rows of ``matches`` (n, 2); ``image`` (n,) of the matches is sorted."""
    first_of_images = np.flatnonzero(np.diff(image, prepend=-1))
    edges = np.append(first_of_images, image.size)
    for low, high in pairwise(edges.tolist()):
        yield int(image[low]), matches[low:high]


def _pairs_by_point(begin: Integers, count: Integers) -> tuple[Integers, Integers]:
    """All pairs of an image point of an image and an image point, in any image, of the same point.

    ``begin`` (n,) and ``count`` (n,) : for each image point of the image, the first entry and the
    number of entries of its point in `ImagePointsByPoint`. Of each pair (k,) the number of the
    first in its image, 0 to n - 1, and the entry of the second.

    >>> index, entry = _pairs_by_point(np.array([7, 2]), np.array([3, 2]))
    >>> index.tolist(), entry.tolist()
    ([0, 0, 0, 1, 1], [7, 8, 9, 2, 3])
    """
    index = np.repeat(np.arange(count.size), count)
    entry_less_pair = np.repeat(begin - np.cumsum(count) + count, count)
    return index, entry_less_pair + np.arange(index.size)
