"""The part of a terrain about a ray: a tile, a block of a tile or a cell, compiled."""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import BLOCK, TILE
from unbend.refraction.kernels.jit import jit

# Within this margin above or below the nodes of a tile a ray is followed block by block, and within
# the second above those of a block cell by cell. A step down to the highest node may end above it:
# without these margins many tiny steps would follow.
_TILE_MARGIN_M = 5.0
_BLOCK_MARGIN_M = 0.01

# In the place of a slot: the nodes of a tile are not needed, or not in memory.
_NOT_NEEDED = -1
TO_BE_READ = -2


class Edges(NamedTuple):
    """Rows and columns of the grid that bound a box or a cell."""

    top: float
    bottom: float
    left: float
    right: float


class Box(NamedTuple):
    """The tile about a place, or a block of the tile where its nodes are needed."""

    tile: int  # number of the tile, -1 outside the grid
    slot: int  # of the tile in memory, or `_NOT_NEEDED`, `TO_BE_READ`
    cell: tuple[int, int]  # row and column of the place's cell in the tile
    low: float  # lowest node [m]; infinite where all are unknown
    high: float  # highest node [m]; minus infinite where all are unknown
    edges: Edges


class Surroundings(NamedTuple):
    """The part of a terrain about a ray: a box that the ray is above or below, or else one cell."""

    box: Box
    edges: Edges  # of the box, or of the cell
    is_over: bool  # the ray is above all nodes of the box
    is_under: bool  # the ray is below all nodes; both where all nodes are unknown
    is_near: bool  # neither: the four nodes of the cell decide


@jit
def _tile_at(grid, row, column):  # type: ignore[no-untyped-def]
    """The `Box` of the whole tile about a place, with the slot `_NOT_NEEDED`.

    ``row`` and ``column`` are those of the place in the grid, with fractions. Outside the grid the
    number of the tile is -1, and its nodes are unknown.
    """
    # Where columns go round the earth the place may be whole rounds outside the grid's columns.
    columns_of_rounds = 0
    if grid.around > 0:
        columns_of_rounds = math.floor(column / grid.around) * grid.around
    i = math.floor(row)
    j = math.floor(column) - columns_of_rounds
    tile_row = i // TILE
    tile_column = j // TILE
    top = tile_row * TILE
    left = tile_column * TILE
    right = left + TILE
    if grid.around > 0 and right > grid.around:  # the last tile of a round is cut off
        right = grid.around
    low = np.inf
    high = -np.inf
    tile = -1
    rows, columns = grid.low.shape
    if 0 <= tile_row < rows and 0 <= tile_column < columns:
        tile = tile_row * columns + tile_column
        low = grid.low[tile_row, tile_column]
        high = grid.high[tile_row, tile_column]
    return Box(
        tile=tile,
        slot=_NOT_NEEDED,
        cell=(i - top, j - left),
        low=low,
        high=high,
        edges=Edges(
            top=float(top),
            bottom=float(top + TILE),
            left=float(left + columns_of_rounds),
            right=float(right + columns_of_rounds),
        ),
    )


@jit
def _block_of(grid, tile_box, slot):  # type: ignore[no-untyped-def]
    """The `Box` of the block that contains the cell of ``tile_box``; its nodes are in ``slot``."""
    k = tile_box.cell[0] // BLOCK
    m = tile_box.cell[1] // BLOCK
    top = tile_box.edges.top + k * BLOCK
    left = tile_box.edges.left + m * BLOCK
    # Only columns of a tile may not be a multiple of BLOCK: the last tile of a round (`_tile_at`).
    right = min(left + BLOCK, tile_box.edges.right)
    return Box(
        tile=tile_box.tile,
        slot=slot,
        cell=tile_box.cell,
        low=np.float64(grid.block_low[slot, k, m]),
        high=np.float64(grid.block_high[slot, k, m]),
        edges=Edges(top, top + BLOCK, left, right),
    )


@jit
def _box_at(grid, row, column, height):  # type: ignore[no-untyped-def]
    """The `Box` of the tile about a place, or of a block of it where the tile's nodes are needed.

    The nodes are needed where ``height`` [m] is between the lowest and the highest of the tile, or
    these are not known yet. If they are not in memory, the box is the tile, with the slot
    `TO_BE_READ`.
    """
    box = _tile_at(grid, row, column)
    if box.tile < 0:
        return box
    is_between = box.low - _TILE_MARGIN_M <= height <= box.high + _TILE_MARGIN_M
    if not (math.isnan(box.low) or is_between):
        return box
    columns = grid.slot.shape[1]
    slot = np.int64(grid.slot[box.tile // columns, box.tile % columns])
    if slot < 0:
        return Box(
            tile=box.tile,
            slot=TO_BE_READ,
            cell=box.cell,
            low=box.low,
            high=box.high,
            edges=box.edges,
        )
    return _block_of(grid, box, slot)


@jit
def surroundings_at(grid, place):  # type: ignore[no-untyped-def]
    """The `Surroundings` of a `RayPlace` on a `TerrainGrid`.

    A box with unknown nodes only has a lowest node of plus infinity and a highest of minus
    infinity: the ray is over it and under it.
    """
    box = _box_at(grid, place.row, place.column, place.height)
    edges = box.edges
    is_over = place.height > box.high + _BLOCK_MARGIN_M
    is_under = place.height < box.low
    is_near = not (is_over or is_under)
    if is_near:
        # Those of the cell.
        top = float(math.floor(place.row))
        left = float(math.floor(place.column))
        edges = Edges(top, top + 1.0, left, left + 1.0)
    return Surroundings(box, edges, is_over, is_under, is_near)
