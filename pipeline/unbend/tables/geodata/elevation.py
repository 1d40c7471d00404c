"""Digital elevation models, in one raster or several, read tile by tile as rays need them."""

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.messages import Notes
from unbend.refraction.kernels.columns import BLOCK, TILE, TerrainGrid
from unbend.tables.geodata import messages
from unbend.tables.geodata.gdal import (
    GDAL_OPTIONS,
    INDEX_FORMATS,
    is_upright,
    may_unpack,
    opening_rasters,
)
from unbend.tables.geodata.raster_system import RasterSystem, raster_system
from unbend.units import METRES_OF_A_FOOT, Array, Integers, Mask

_TILES_IN_MEMORY = 100  # of 1 MB
_LOWEST_M = -600.0  # numbers down from here are holes that a file does not declare
_HIGHEST_M = 9_000.0  # and so are numbers up from here
_US_SURVEY_FOOT_M = 1200.0 / 3937.0
_METRES_OF_UNIT = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "metres": 1.0,
    "meters": 1.0,
    "ft": METRES_OF_A_FOOT,
    "foot": METRES_OF_A_FOOT,
    "feet": METRES_OF_A_FOOT,
    "us-ft": _US_SURVEY_FOOT_M,
    "us-survey-foot": _US_SURVEY_FOOT_M,
}
_LARGEST_OFFSET = 0.01  # in cells, of the nodes of a raster from the grid of the model
_UNDULATION_STEP = 64  # nodes between undulations; a geoid is linear to 1 mm over them


class ElevationModel:
    """Rasters on one grid, as a `Terrain` of heights above sea level.

    ``undulation`` of latitude and longitude [rad] is subtracted from the heights of the rasters
    [m]; None if these are above sea level. ``lock`` must be held while tiles are loaded and used.
    """

    def __init__(
        self,
        rasters: "Sequence[_Raster]",
        system: RasterSystem,
        undulation: Callable[[Array, Array], Array] | None,
    ) -> None:
        self._rasters = rasters
        self._system = system
        self._undulation = undulation
        self.lock = threading.RLock()
        self._projecting = threading.Lock()
        self._west = min(raster.west for raster in rasters)
        self._north = max(raster.north for raster in rasters)
        self._step_x = rasters[0].step_x
        self._step_y = rasters[0].step_y
        self._first_nodes = [self._first_node_of(raster) for raster in rasters]
        rows = 0
        columns = 0
        for raster, (top, left) in zip(rasters, self._first_nodes, strict=True):
            rows = max(rows, top + raster.rows)
            columns = max(columns, left + raster.columns)
        self.size = (rows, columns)
        around = 0
        if system.is_geographic and columns * self._step_x > 180.0:
            around = round(360.0 / self._step_x)
        self.grid = _empty_grid(rows, columns, around)
        self._slot_of_tile: dict[int, int] = {}  # of tiles in memory, the first loaded first

    def _first_node_of(self, raster: "_Raster") -> tuple[int, int]:
        """Row and column in the model, from its north-west corner, of a raster's first node.

        Refuses (DEM-TILES) a raster on another grid than the first one.
        """
        row = (self._north - raster.north) / self._step_y
        column = (raster.west - self._west) / self._step_x
        offset = max(
            abs(row - round(row)),
            abs(column - round(column)),
            raster.columns * abs(raster.step_x / self._step_x - 1.0),
            raster.rows * abs(raster.step_y / self._step_y - 1.0),
        )
        if offset > _LARGEST_OFFSET:
            raise messages.dem_tiles(
                where=raster.path,
                off=offset,
                first=self._rasters[0].path.name,
                step=(raster.step_x, raster.step_y),
                first_step=(self._step_x, self._step_y),
            )
        return round(row), round(column)

    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """Row and column of (n,) places on WGS 84, in nodes with fractions; 0, 0 is the first node.

        Nodes are centres of cells.
        """
        with self._projecting:
            x, y = self._system.to_grid(np.degrees(lon_rad), np.degrees(lat_rad))
        if self._system.is_geographic:
            # Longitudes within half a turn of the middle of the model.
            _, columns = self.size
            middle = self._west + 0.5 * columns * self._step_x
            x = middle + (x - middle + 180.0) % 360.0 - 180.0
        row = (self._north - y) / self._step_y - 0.5
        column = (x - self._west) / self._step_x - 0.5
        return row, column

    def covers(self, lat_rad: Array, lon_rad: Array) -> Mask:
        """(n,) which places are between the outermost nodes of all rasters, holes included."""
        row, column = self.nodes(lat_rad, lon_rad)
        rows, columns = self.size
        is_in_rows = (row >= 0.0) & (row <= rows - 1)
        is_round_earth = self.grid.around > 0
        is_in_columns = (column <= columns - 1) & ((column >= 0.0) | is_round_earth)
        return np.asarray(is_in_rows & is_in_columns)

    @property
    def name(self) -> str:
        """The path of the first raster."""
        return str(self._rasters[0].path)

    def heights(self, row: Array, column: Array) -> Array:
        """(n,) heights above sea level [m], bilinear; NaN in holes and outside the rasters.

        ``row``, ``column`` (n,) : places as of `nodes`.
        """
        height = np.full(row.size, np.nan)
        tile = np.empty((TILE + 1, TILE + 1), np.float32)
        tile_of_place = np.stack([np.floor(row) // TILE, np.floor(column) // TILE])
        tiles, number_of_tile = np.unique(tile_of_place, axis=1, return_inverse=True)
        for number, (tile_row, tile_column) in enumerate(tiles.T.astype(int).tolist()):
            first_row = tile_row * TILE
            first_column = tile_column * TILE
            places = np.flatnonzero(number_of_tile == number)
            with self.lock:
                self._fill_tile(first_row, first_column, tile)
            height[places] = _bilinear(
                tile,
                first_row,
                first_column,
                row[places],
                column[places],
            )
        return height

    def load(self, tiles: Integers) -> None:
        """Read tiles into memory, as many as fit; other tiles make room, the first loaded first.

        ``tiles`` : numbers of tiles, row by row, that are not in memory.
        """
        from unbend.refraction.kernels.terrain import extremes_of_tile

        grid = self.grid
        slots = grid.tiles.shape[0]
        tile_columns = grid.slot.shape[1]
        requested = sorted(tiles[:slots].tolist())  # neighbours share blocks of files
        for tile in requested:
            slot = len(self._slot_of_tile)
            if slot == slots:
                oldest = next(other for other in self._slot_of_tile if other not in requested)
                slot = self._slot_of_tile.pop(oldest)
                grid.slot[divmod(oldest, tile_columns)] = -1
            place = divmod(tile, tile_columns)
            tile_row, tile_column = place
            self._fill_tile(tile_row * TILE, tile_column * TILE, grid.tiles[slot])
            low = grid.block_low[slot]
            high = grid.block_high[slot]
            extremes_of_tile(grid.tiles[slot], low, high)
            grid.low[place] = low.min()
            grid.high[place] = high.max()
            grid.slot[place] = slot
            self._slot_of_tile[tile] = slot

    def _fill_tile(
        self,
        row: int,
        column: int,
        tile: NDArray[np.float32],
    ) -> None:
        """Fill ``tile`` with heights [m above sea level], NaN in holes and outside the rasters.

        ``row``, ``column`` : of its first node.
        """
        self._read_rasters(row, column, tile)
        # Impossible heights are holes that the file does not declare.
        if not (tile.min() > _LOWEST_M and tile.max() < _HIGHEST_M):
            is_hole = (tile <= _LOWEST_M) | (tile >= _HIGHEST_M)
            np.copyto(tile, np.float32(np.nan), where=is_hole)
        if self._undulation is not None:
            tile -= self._undulations(self._undulation, row, column)

    def _read_rasters(
        self,
        row: int,
        column: int,
        tile: NDArray[np.float32],
    ) -> None:
        """Fill ``tile`` with the numbers of the rasters in metres; the first raster has precedence.

        ``row``, ``column`` : of its first node. In a model round the earth each raster also recurs
        a full turn to the west and to the east.
        """
        tile[:] = np.nan
        is_empty = True
        shifts = [0]
        if self.grid.around:
            shifts = [-self.grid.around, 0, self.grid.around]
        for raster, (top, first_column) in zip(self._rasters, self._first_nodes, strict=True):
            for shift in shifts:
                left = first_column + shift
                row_begin = max(row, top)
                row_end = min(row + TILE + 1, top + raster.rows)
                column_begin = max(column, left)
                column_end = min(column + TILE + 1, left + raster.columns)
                if row_begin >= row_end or column_begin >= column_end:
                    continue
                rows_of_tile = slice(row_begin - row, row_end - row)
                columns_of_tile = slice(column_begin - column, column_end - column)
                part = tile[rows_of_tile, columns_of_tile]
                heights = raster.read(row_begin - top, column_begin - left, *part.shape)
                # Numbers of a damaged raster may overflow; the caller makes them holes.
                with np.errstate(all="ignore"):
                    heights *= np.float32(raster.unit_m or self._system.unit_m)
                np.copyto(part, heights, where=is_empty or np.isnan(part))
                is_empty = False

    def _undulations(
        self,
        undulation: Callable[[Array, Array], Array],
        row: int,
        column: int,
    ) -> NDArray[np.float32]:
        """(TILE + 1, TILE + 1) undulations [m] at the nodes of a tile.

        Bilinear between each 64th node. ``row``, ``column`` : of the tile's first node.
        """
        coarse_nodes = TILE // _UNDULATION_STEP + 1
        node = np.linspace(0.0, TILE, coarse_nodes)
        x_of_column = self._west + (column + node + 0.5) * self._step_x
        y_of_row = self._north - (row + node + 0.5) * self._step_y
        x, y = np.meshgrid(x_of_column, y_of_row)
        with self._projecting:
            lon, lat = self._system.to_places(x.ravel(), y.ravel())
        coarse = undulation(np.radians(lat), np.radians(lon)).reshape(x.shape)
        # Weights (TILE + 1, coarse_nodes) of linear interpolation along a side.
        place = np.arange(TILE + 1) / _UNDULATION_STEP
        distance = np.abs(place[:, None] - np.arange(coarse_nodes))
        weight = np.maximum(0.0, 1.0 - distance)
        return np.asarray((weight @ coarse @ weight.T).astype(np.float32))


def _empty_grid(rows: int, columns: int, around: int) -> TerrainGrid:
    """A grid of rows and columns of nodes, without a tile in memory.

    ``around`` : columns of a full turn round the earth; 0 if the grid does not go round it.
    """
    # Tiles are counted upwards: a part of a tile is one.
    tile_rows = -(-rows // TILE)
    tile_columns = -(-(around or columns) // TILE)
    shape = (tile_rows, tile_columns)
    slots = min(_TILES_IN_MEMORY, tile_rows * tile_columns)
    blocks = (slots, TILE // BLOCK, TILE // BLOCK)
    return TerrainGrid(
        low=np.full(shape, np.nan, np.float32),
        high=np.full(shape, np.nan, np.float32),
        slot=np.full(shape, -1, np.int32),
        tiles=np.empty((slots, TILE + 1, TILE + 1), np.float32),
        block_low=np.empty(blocks, np.float32),
        block_high=np.empty(blocks, np.float32),
        around=around,
    )


def _bilinear(
    tile: NDArray[np.float32],
    first_row: int,
    first_column: int,
    row: Array,
    column: Array,
) -> Array:
    """(n,) heights [m] at places (row and column in nodes), all of them in one tile.

    ``first_row``, ``first_column`` : of the tile's first node.
    """
    node_row = np.floor(row)
    node_column = np.floor(column)
    down = row - node_row
    right = column - node_column
    i = (node_row - first_row).astype(int)
    j = (node_column - first_column).astype(int)
    upper = tile[i, j] * (1.0 - right) + tile[i, j + 1] * right
    lower = tile[i + 1, j] * (1.0 - right) + tile[i + 1, j + 1] * right
    return np.asarray(upper * (1.0 - down) + lower * down)


class _Raster:
    """One file of an elevation model.

    ``west``, ``north`` : x and y of the corner of its first cell; ``step_x``, ``step_y`` : size of
    a cell. ``unit_m`` : unit of its heights, None if it states none. ``has_holes`` : cells may be
    without a height.
    """

    def __init__(self, path: Path, open_raster: Callable[[Path], Any]) -> None:
        from rasterio.enums import MaskFlags

        self.path = path
        self._open = open_raster
        source = open_raster(path)
        affine = source.transform
        self.crs = source.crs.to_wkt() if source.crs else ""
        if source.count != 1 or not is_upright(affine) or source.driver in INDEX_FORMATS:
            raise messages.dem_raster(
                where=path,
                driver=source.driver,
                bands=source.count,
                affine=(affine.a, affine.b, affine.d, affine.e),
            )
        block_rows, block_columns = source.block_shapes[0]
        block_bytes = block_rows * block_columns * np.dtype(source.dtypes[0]).itemsize
        if not may_unpack(path, block_bytes):
            raise messages.dem_block(where=path, block_bytes=block_bytes)
        self.step_x = affine.a
        self.step_y = -affine.e
        self.west = affine.c
        self.north = affine.f
        self.rows = source.height
        self.columns = source.width
        self.unit_m = _unit_of_heights(path, source.units[0])
        self.scale = source.scales[0]
        self.offset = source.offsets[0]
        self.has_holes = MaskFlags.all_valid not in source.mask_flag_enums[0]

    def corners(self) -> list[tuple[float, float]]:
        """x and y of the four corners, in the coordinate system of the raster."""
        east = self.west + self.columns * self.step_x
        south = self.north - self.rows * self.step_y
        return [
            (self.west, self.north),
            (self.west, south),
            (east, self.north),
            (east, south),
        ]

    def read(
        self,
        row: int,
        column: int,
        rows: int,
        columns: int,
    ) -> NDArray[np.float32]:
        """(rows, columns) heights in the unit of the raster, NaN in holes that it declares.

        ``row``, ``column`` : of the window's first cell. Scale and offset are applied.
        """
        from rasterio import Env
        from rasterio.errors import RasterioError
        from rasterio.windows import Window

        try:
            window = Window(column, row, columns, rows)
            with Env(**GDAL_OPTIONS):
                source = self._open(self.path)
                numbers = source.read(
                    1,
                    window=window,
                    masked=self.has_holes,
                    out_dtype=np.float32,
                )
        except RasterioError as error:
            raise messages.dem_unreadable(where=self.path, error=str(error)) from None
        height = np.asarray(np.ma.filled(numbers, np.nan), np.float32)
        if self.scale == 1.0 and self.offset == 0.0:
            return height
        with np.errstate(all="ignore"):
            scaled = height * np.float32(self.scale)
            return np.asarray(scaled + np.float32(self.offset), np.float32)


def _unit_of_heights(path: Path, unit: str | None) -> float | None:
    """The size [m] of a unit of heights, None without one; refuses (DEM-UNIT) an unknown unit.

    ``path`` of the raster is for the message.
    """
    if not unit:
        return None
    name = unit.strip().lower().replace(" ", "-")
    if name not in _METRES_OF_UNIT:
        raise messages.dem_unit(where=path, unit=unit)
    return _METRES_OF_UNIT[name]


def open_elevation(
    paths: Sequence[Path],
    crs: str | None,
    *,
    reference: str,
    undulation: Callable[[Array, Array], Array],
) -> tuple[ElevationModel, Notes]:
    """The elevation model in rasters on one grid, in any format that GDAL reads.

    ``paths`` : one raster, or tiles of one; where they overlap, the first takes precedence.
    ``crs`` : the coordinate system that the mission file states, needed if the files have none.
    ``reference`` : what the heights count from, msl or ellipsoid. ``undulation`` : [m], of latitude
    and longitude [rad], used for ellipsoid.

    Values belong to centres of cells and are bilinear between. Refuses (InputError) a file that is
    not a raster of heights (DEM-UNREADABLE, DEM-RASTER, DEM-UNIT), rasters of several grids
    (DEM-TILES), and a system that is missing, or contradicts what is stated (DEM-CRS,
    CRS-VERTICAL).
    """
    try:
        import rasterio
    except ImportError:
        raise messages.dem_rasterio(where="ground.height.dem") from None
    where = str(paths[0])
    open_raster = lru_cache(maxsize=64)(rasterio.open)
    try:
        with opening_rasters():
            rasters = [_Raster(path, open_raster) for path in paths]
    except rasterio.errors.RasterioError as error:
        raise messages.dem_unreadable(where=where, error=str(error)) from None
    corners: list[tuple[float, float]] = []
    for raster in rasters:
        corners += raster.corners()
    system = raster_system(
        _system_of_rasters(rasters, where) or _stated_system(crs, where),
        crs,
        corners=np.transpose(corners),
        heights=reference,
        where=where,
        key="ground.height.crs",
    )
    is_above_ellipsoid = reference == "ellipsoid"
    model = ElevationModel(rasters, system, undulation if is_above_ellipsoid else None)
    rows, columns = model.size
    note = messages.elevation_read(
        where=where,
        count=len(rasters),
        columns=columns,
        rows=rows,
        step_x=rasters[0].step_x,
        step_y=rasters[0].step_y,
        system=system.name,
        heights=system.vertical or reference,
        unit_m=rasters[0].unit_m or system.unit_m,
        operation=system.operation,
        is_good=system.is_good,
        is_sea_level=system.is_sea_level or not system.vertical,
    )
    return model, (note,)


def _system_of_rasters(rasters: Sequence[_Raster], where: str) -> str:
    """The coordinate system of rasters as WKT, "" if none has one; refuses (DEM-CRS) several."""
    systems = {raster.crs for raster in rasters}
    if len(systems) > 1:
        raise messages.rasters_of_several_systems(where=where)
    return rasters[0].crs


def _stated_system(crs: str | None, where: str) -> str:
    """The coordinate system that the mission file states; refuses (DEM-CRS) a file without one."""
    if not crs:
        raise messages.rasters_without_system(where=where)
    return crs
