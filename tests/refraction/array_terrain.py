"""A terrain of an array in memory, for tests of rays over it."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np

from unbend.refraction.kernels.columns import BLOCK, TILE, TerrainGrid


class ArrayTerrain:
    """Heights (rows, columns) on a grid of latitudes and longitudes [deg], from the north-west.

    Where ``around`` columns go round the earth, the stored ones begin with number ``first``.
    """

    lock = nullcontext()

    def __init__(self, heights, north, west, step_lat, step_lon, *, around=0, first=0, slots=4):
        self.heights, self.corner, self.step = heights, (north, west), (step_lat, step_lon)
        self.first = first
        shape = -(-heights.shape[0] // TILE), -(-(around or heights.shape[1]) // TILE)
        self.grid = TerrainGrid(
            np.full(shape, np.nan, np.float32),
            np.full(shape, np.nan, np.float32),
            np.full(shape, -1, np.int32),
            np.empty((slots, TILE + 1, TILE + 1), np.float32),
            np.empty((slots, TILE // BLOCK, TILE // BLOCK), np.float32),
            np.empty((slots, TILE // BLOCK, TILE // BLOCK), np.float32),
            around,
        )
        self.next, self.loads = 0, 0

    def nodes(self, lat, lon):
        east = (np.degrees(lon) - self.corner[1] + 180.0) % 360.0 - 180.0
        return (self.corner[0] - np.degrees(lat)) / self.step[0], east / self.step[1]

    def load(self, tiles):
        from unbend.refraction.kernels.terrain import extremes_of_tile

        grid = self.grid
        for tile in tiles[: grid.tiles.shape[0]].tolist():
            i, j = divmod(tile, grid.slot.shape[1])
            slot, self.next = self.next, (self.next + 1) % grid.tiles.shape[0]
            grid.slot[grid.slot == slot] = -1
            grid.slot[i, j] = slot
            rows = i * TILE + np.arange(TILE + 1)
            whole = self.stored(*np.meshgrid(rows, j * TILE + np.arange(TILE + 1), indexing="ij"))
            grid.tiles[slot] = whole
            extremes_of_tile(whole, grid.block_low[slot], grid.block_high[slot])
            grid.low[i, j], grid.high[i, j] = (
                grid.block_low[slot].min(),
                grid.block_high[slot].max(),
            )
            self.loads += 1

    def stored(self, row, column):
        """Heights of nodes, NaN beside the array."""
        if self.grid.around:
            column = (column - self.first) % self.grid.around
        inside = (row >= 0) & (row < self.heights.shape[0])
        inside &= (column >= 0) & (column < self.heights.shape[1])
        nodes = self.heights[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, nodes, np.nan)
