"""Matches of the images of a block as COLMAP's database has them, made new or copied.

Points tie each pair of their images; where the run read a database, its own matches and geometries
are copied, for the keypoints that are still there.
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

_MOST_IMAGES = 2_147_483_647  # of pair_id = first * this + second
_CALIBRATED = 2  # configuration of two views whose cameras are calibrated

Row = tuple[Any, ...]
"""A row of a table of the database."""


@dataclass(frozen=True, eq=False)
class _CopiedImage:
    """Number of an image, and where each keypoint of the database that was read stands now.

    ``place`` is -1 for keypoints that were left out, and has one more element, -1, for those beyond
    the last.
    """

    number: int
    place: Integers


def copied_rows(block: ExportedBlock, source: Path) -> Iterator[Row]:
    """Rows of ``matches`` and ``two_view_geometries`` of the database that was read.

    The keypoint ``index`` of an image is the block's point ``image:index``. Its index is replaced
    by that in the exported image; matches of keypoints that were left out are left out. Of a
    geometry the configuration is kept, not the matrices, which are of bent rays.
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
    """Two images by their names, the places of their matches (m, 2), and a geometry's kind."""

    first: str | None
    second: str | None
    matches: NDArray[np.uint32]
    configuration: list[int]


def _pairs_read(
    database: sqlite3.Connection,
    source: Path,
    table: str,
) -> Iterator[_PairRead]:
    """The rows of one of both tables; refuses matches cut short."""
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
    """The images of a block whose points are called ``image:index``, by their names."""
    images = {}
    for i, _camera, here in block.images():
        image = block.image[i]
        points = block.name.take(pa.array(block.point[here]))
        prefix = len(f"{image}:".encode())
        index = pc.binary_replace_slice(points, 0, prefix, "").cast(pa.int64()).to_numpy()
        place = np.full(index.max(initial=0) + 2, -1)
        place[index] = np.arange(index.size)
        images[image] = _CopiedImage(i + 1, place)
    return images


def _copied_pair(
    matches: NDArray[np.uint32],
    first: _CopiedImage,
    second: _CopiedImage,
) -> tuple[int, int, bytes] | None:
    """Pair of images, number and places of the matches (m, 2) that both still have, or None.

    The image of the smaller number comes first, as COLMAP wants it.
    """
    first_place = first.place.take(
        matches[:, 0],
        mode="clip",
    )
    second_place = second.place.take(
        matches[:, 1],
        mode="clip",
    )
    places = [first_place, second_place]
    if second.number < first.number:
        first, second = second, first
        places.reverse()
    both = np.stack(places, axis=1)
    is_kept = both.min(axis=1) >= 0
    kept = both[is_kept].astype("<u4")
    if len(kept) == 0:
        return None
    return first.number * _MOST_IMAGES + second.number, len(kept), kept.tobytes()


def match_rows(block: ExportedBlock) -> Iterator[Row]:
    """Rows of both tables: pair of images, number of points in both, places of their keypoints."""
    order, begin, images = block.image_points_by_point()
    place_in_image = order - block.first[images]
    for i, _camera, here in block.images():
        point = block.point[here]
        place, partner = _partners(begin[point], block.count[point])
        later = np.flatnonzero(images[partner] > i)
        later = later[np.argsort(images[partner[later]], kind="stable")]
        partner = partner[later]
        matches = np.stack([place[later], place_in_image[partner]], axis=1).astype("<u4")
        for other, matches_of_pair in _by_image(images[partner], matches):
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
    """The images, and the matches (m, 2) of each; ``image`` (n,) is that of each match, sorted."""
    changes = np.flatnonzero(np.diff(image, prepend=-1))
    edges = np.append(changes, image.size)
    for low, high in pairwise(edges.tolist()):
        yield int(image[low]), matches[low:high]


def _partners(begin: Integers, count: Integers) -> tuple[Integers, Integers]:
    """Place of each point of an image in it, and the image points of the same point, one by one.

    The latter are rows in the order by points, of which ``begin`` (n,) is the first of each point,
    and ``count`` (n,) the number.
    """
    place = np.repeat(np.arange(count.size), count)
    partner = np.repeat(begin - np.cumsum(count) + count, count)
    return place, partner + np.arange(place.size)
