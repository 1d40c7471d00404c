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
        self.heights = heights
        self.north = north
        self.west = west
        self.step_lat = step_lat
        self.step_lon = step_lon
        self.first = first
        rows, columns = heights.shape
        tiles = (-(-rows // TILE), -(-(around or columns) // TILE))
        blocks = (slots, TILE // BLOCK, TILE // BLOCK)
        self.grid = TerrainGrid(
            low=np.full(tiles, np.nan, np.float32),
            high=np.full(tiles, np.nan, np.float32),
            slot=np.full(tiles, -1, np.int32),
            tiles=np.empty((slots, TILE + 1, TILE + 1), np.float32),
            block_low=np.empty(blocks, np.float32),
            block_high=np.empty(blocks, np.float32),
            around=around,
        )
        self.loads = 0

    def nodes(self, lat, lon):
        south = self.north - np.degrees(lat)
        east = (np.degrees(lon) - self.west + 180.0) % 360.0 - 180.0
        return south / self.step_lat, east / self.step_lon

    def load(self, tiles):
        from unbend.refraction.kernels.terrain import extremes_of_tile

        grid = self.grid
        slots = len(grid.tiles)
        for tile in tiles[:slots].tolist():
            i, j = divmod(tile, grid.slot.shape[1])
            slot = self.loads % slots
            grid.slot[grid.slot == slot] = -1
            grid.slot[i, j] = slot
            nodes = np.arange(TILE + 1)
            grid.tiles[slot] = self.stored(i * TILE + nodes[:, None], j * TILE + nodes)
            extremes_of_tile(grid.tiles[slot], grid.block_low[slot], grid.block_high[slot])
            grid.low[i, j] = grid.block_low[slot].min()
            grid.high[i, j] = grid.block_high[slot].max()
            self.loads += 1

    def stored(self, row, column):
        """Heights of nodes, NaN beside the array."""
        if self.grid.around:
            column = (column - self.first) % self.grid.around
        rows, columns = self.heights.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        nodes = self.heights[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, nodes, np.nan)
