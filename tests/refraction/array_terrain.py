"""A terrain of an array in memory, for tests of rays over it."""

import math
from contextlib import nullcontext

import numpy as np

from unbend.refraction.kernels.columns import BLOCK, TILE, TerrainGrid
from unbend.refraction.kernels.terrain import extremes_of_tile


class ArrayTerrain:
    """Heights (rows, columns) on a grid of latitudes and longitudes [deg], from the north-west.

    Where ``around`` columns go round the earth, the stored ones begin with number ``first``.
    """

    lock = nullcontext()

    def __init__(
        self,
        heights,
        north,
        west,
        step_lat,
        step_lon,
        *,
        around=0,
        first=0,
        slots=4,
    ):
        self.heights = heights
        self.north = north
        self.west = west
        self.step_lat = step_lat
        self.step_lon = step_lon
        self.first = first
        self.loads = 0
        rows, columns = heights.shape
        tiles = (math.ceil(rows / TILE), math.ceil((around or columns) / TILE))
        unread = np.full(tiles, np.nan, np.float32)
        blocks = np.empty((slots, TILE // BLOCK, TILE // BLOCK), np.float32)
        self.grid = TerrainGrid(
            low=unread,
            high=unread.copy(),
            slot=np.full(tiles, -1, np.int32),
            tiles=np.empty((slots, TILE + 1, TILE + 1), np.float32),
            block_low=blocks,
            block_high=blocks.copy(),
            around=around,
        )

    def nodes(self, lat, lon):
        """Row and column of a place [rad]."""
        south = self.north - np.degrees(lat)
        east = (np.degrees(lon) - self.west + 180.0) % 360.0 - 180.0
        return south / self.step_lat, east / self.step_lon

    def load(self, tiles):
        grid = self.grid
        slots = len(grid.tiles)
        nodes = np.arange(TILE + 1)
        for tile in tiles[:slots].tolist():
            slot = self.loads % slots
            self.loads += 1
            grid.slot[grid.slot == slot] = -1
            place = divmod(tile, grid.slot.shape[1])
            grid.slot[place] = slot
            i, j = place
            heights = self.stored(i * TILE + nodes[:, None], j * TILE + nodes)
            grid.tiles[slot] = heights
            low = grid.block_low[slot]
            high = grid.block_high[slot]
            extremes_of_tile(grid.tiles[slot], low, high)
            grid.low[place] = low.min()
            grid.high[place] = high.max()

    def stored(self, row, column):
        """Heights of nodes, NaN beside the array."""
        if self.grid.around:
            column = (column - self.first) % self.grid.around
        rows, columns = self.heights.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        nodes = self.heights[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside, nodes, np.nan)
