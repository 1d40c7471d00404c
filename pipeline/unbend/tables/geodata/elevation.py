"""Digital elevation models, in one raster or several, read tile by tile as rays come to them."""

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
from unbend.tables.geodata.coordinate_systems import GridSystem, grid_system
from unbend.tables.geodata.gdal import GDAL_OPTIONS, NAME_OTHERS, is_upright
from unbend.units import Array, Integers, Mask

_TILES_IN_MEMORY = 100  # of 1 MB

_LOWEST_M, _HIGHEST_M = -600.0, 9_000.0
_METRES = {
    "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "ft": 0.3048,
    "foot": 0.3048, "feet": 0.3048, "us-ft": 1200.0 / 3937.0, "us-survey-foot": 1200.0 / 3937.0,
}  # fmt: skip
_APART = 0.01  # so far nodes of rasters of one model may lie beside each other, in cells


class ElevationModel:
    """Rasters on one grid as a `Terrain`; ``lock`` is held while tiles are read and used.

    ``undulation`` of latitude and longitude [rad] is what their heights lie above sea level too
    much, None where they are above sea level.
    """

    def __init__(
        self,
        rasters: "Sequence[_Raster]",
        system: GridSystem,
        undulation: Callable[[Array, Array], Array] | None,
    ) -> None:
        first = rasters[0]
        self._rasters, self._system, self._undulation = rasters, system, undulation
        self._step = first.step_x, first.step_y
        self.lock, self._projecting = threading.RLock(), threading.Lock()
        # In nodes from the north-west corner of all.
        west, north = min(r.west for r in rasters), max(r.north for r in rasters)
        self._corner = west, north
        self._places = []
        for raster in rasters:
            row, column = (north - raster.north) / first.step_y, (raster.west - west) / first.step_x
            off = max(
                abs(row - round(row)), abs(column - round(column)),
                raster.columns * abs(raster.step_x / first.step_x - 1.0),
                raster.rows * abs(raster.step_y / first.step_y - 1.0),
            )  # fmt: skip
            if off > _APART:
                raise messages.dem_tiles(
                    where=raster.path,
                    off=off,
                    first=first.path.name,
                    step=(raster.step_x, raster.step_y),
                    first_step=(first.step_x, first.step_y),
                )
            self._places.append((round(row), round(column)))
        rows = max(p[0] + r.rows for p, r in zip(self._places, rasters, strict=True))
        columns = max(p[1] + r.columns for p, r in zip(self._places, rasters, strict=True))
        around = 0
        if system.geographic and columns * first.step_x > 180.0:
            around = round(360.0 / first.step_x)
        self.size = rows, columns
        shape = -(-rows // TILE), -(-(around or columns) // TILE)
        slots = min(_TILES_IN_MEMORY, shape[0] * shape[1])
        low, high = np.full((2, *shape), np.nan, np.float32)
        block_low, block_high = np.empty((2, slots, TILE // BLOCK, TILE // BLOCK), np.float32)
        tiles = np.empty((slots, TILE + 1, TILE + 1), np.float32)
        slot = np.full(shape, -1, np.int32)
        self.grid = TerrainGrid(low, high, slot, tiles, block_low, block_high, around)
        self._held: dict[int, int] = {}  # tile -> slot, the longest there first

    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """Row and column of places on WGS 84 [rad], in nodes, which are centres of cells."""
        with self._projecting:
            x, y = self._system.to_grid(np.degrees(lon_rad), np.degrees(lat_rad))
        (west, north), (step_x, step_y) = self._corner, self._step
        if self._system.geographic:
            middle = west + 0.5 * self.size[1] * step_x
            x = middle + (x - middle + 180.0) % 360.0 - 180.0
        return (north - y) / step_y - 0.5, (x - west) / step_x - 0.5

    def covers(self, lat_rad: Array, lon_rad: Array) -> Mask:
        """(n,) which places lie within the rasters' common frame."""
        row, column = self.nodes(lat_rad, lon_rad)
        inside = (row >= 0.0) & (row <= self.size[0] - 1) & (column <= self.size[1] - 1)
        return np.asarray(inside & ((column >= 0.0) | (self.grid.around > 0)))

    @property
    def name(self) -> str:
        """The path of the first raster."""
        return str(self._rasters[0].path)

    def heights(self, row: Array, column: Array) -> Array:
        """(n,) heights above sea level [m] at places in nodes, bilinear; NaN in holes, outside."""
        height, i, j = np.full(row.size, np.nan), np.floor(row), np.floor(column)
        tile = np.empty((TILE + 1, TILE + 1), np.float32)
        tiles, of = np.unique(np.stack([i // TILE, j // TILE]), axis=1, return_inverse=True)
        for number, (p, q) in enumerate(np.int64(TILE) * tiles.T.astype(np.int64)):
            at = np.flatnonzero(of == number)
            with self.lock:
                self._read(int(p), int(q), tile)
            k, m = (i[at] - p).astype(int), (j[at] - q).astype(int)
            down, right = row[at] - i[at], column[at] - j[at]
            upper = tile[k, m] * (1.0 - right) + tile[k, m + 1] * right
            lower = tile[k + 1, m] * (1.0 - right) + tile[k + 1, m + 1] * right
            height[at] = upper * (1.0 - down) + lower * down
        return height

    def load(self, tiles: Integers) -> None:
        """Read tiles that are not in memory, as many as fit there, in the place of others."""
        from unbend.refraction.kernels.terrain import extremes_of_tile

        grid = self.grid
        wanted = sorted(tiles[: grid.tiles.shape[0]].tolist())  # neighbours share blocks of files
        for tile in wanted:
            slot = len(self._held)
            if slot == grid.tiles.shape[0]:
                oldest = next(t for t in self._held if t not in wanted)
                slot = self._held.pop(oldest)
                grid.slot[divmod(oldest, grid.slot.shape[1])] = -1
            place = divmod(tile, grid.slot.shape[1])
            self._read(place[0] * TILE, place[1] * TILE, grid.tiles[slot])
            low, high = grid.block_low[slot], grid.block_high[slot]
            extremes_of_tile(grid.tiles[slot], low, high)
            grid.low[place], grid.high[place] = low.min(), high.max()
            grid.slot[place] = self._held[tile] = slot

    def _read(self, row: int, column: int, tile: NDArray[np.float32]) -> None:
        """Fill a tile with its nodes [m above sea level], NaN in holes and beside the rasters."""
        tile[:], fresh = np.nan, True
        turns = (0,) if self.grid.around == 0 else (-self.grid.around, 0, self.grid.around)
        for raster, (top, left) in zip(self._rasters, self._places, strict=True):
            for turn in turns:
                i_0, i_1 = max(row, top), min(row + TILE + 1, top + raster.rows)
                j_0 = max(column, left + turn)
                j_1 = min(column + TILE + 1, left + turn + raster.columns)
                if i_0 >= i_1 or j_0 >= j_1:
                    continue
                part = tile[i_0 - row : i_1 - row, j_0 - column : j_1 - column]
                read = raster.read(i_0 - top, j_0 - left - turn, *part.shape)
                read *= np.float32(raster.unit_m or self._system.unit_m)
                np.copyto(part, read, where=fresh or np.isnan(part))
                fresh = False
        # Numbers for holes that the file does not declare are no heights either.
        if not (tile.min() > _LOWEST_M and tile.max() < _HIGHEST_M):
            np.copyto(tile, np.float32(np.nan), where=(tile <= _LOWEST_M) | (tile >= _HIGHEST_M))
        if self._undulation is not None:
            # At every 64th node; between these a geoid is even to a millimetre.
            at = np.linspace(0.0, TILE, 9)
            (west, north), (step_x, step_y) = self._corner, self._step
            x, y = np.meshgrid(
                west + (column + at + 0.5) * step_x, north - (row + at + 0.5) * step_y
            )
            with self._projecting:
                lon, lat = self._system.to_places(x.ravel(), y.ravel())
            above = self._undulation(np.radians(lat), np.radians(lon)).reshape(9, 9)
            apart = np.abs(np.arange(TILE + 1)[:, None] / 64.0 - np.arange(9))
            weight = np.maximum(0.0, 1.0 - apart)
            tile -= (weight @ above @ weight.T).astype(np.float32)


class _Raster:
    """One file: its frame, its nodes, and what to do to its numbers to have metres."""

    def __init__(self, path: Path, open_raster: Callable[[Path], Any]) -> None:
        from rasterio.enums import MaskFlags

        self.path, self._open = path, open_raster
        source = open_raster(path)
        affine = source.transform
        self.crs = source.crs.to_wkt() if source.crs else ""
        if source.count != 1 or not is_upright(affine) or source.driver in NAME_OTHERS:
            raise messages.dem_raster(
                where=path,
                driver=source.driver,
                bands=source.count,
                affine=(affine.a, affine.b, affine.d, affine.e),
            )
        self.step_x, self.step_y, self.west, self.north = affine.a, -affine.e, affine.c, affine.f
        self.rows, self.columns = source.height, source.width
        unit = source.units[0]
        if unit and unit.strip().lower().replace(" ", "-") not in _METRES:
            raise messages.dem_unit(where=path, unit=unit)
        self.unit_m = _METRES[unit.strip().lower().replace(" ", "-")] if unit else None
        self.scale, self.offset = source.scales[0], source.offsets[0]
        self.holed = MaskFlags.all_valid not in source.mask_flag_enums[0]

    def read(self, row: int, column: int, rows: int, columns: int) -> NDArray[np.float32]:
        """A window of the heights [m]; NaN in holes, and for numbers that are no heights."""
        from rasterio import Env
        from rasterio.errors import RasterioError
        from rasterio.windows import Window

        try:
            window = Window(column, row, columns, rows)
            with Env(**GDAL_OPTIONS):
                source = self._open(self.path)
                read = source.read(1, window=window, masked=self.holed, out_dtype=np.float32)
        except RasterioError as error:
            raise messages.dem_unreadable(where=self.path, error=str(error)) from None
        height = np.asarray(np.ma.filled(read, np.nan), np.float32)
        if (self.scale, self.offset) == (1.0, 0.0):
            return height
        return np.asarray(height * np.float32(self.scale) + np.float32(self.offset), np.float32)


def open_elevation(
    paths: Sequence[Path],
    crs: str | None,
    *,
    reference: str,
    undulation: Callable[[Array, Array], Array],
) -> tuple[ElevationModel, Notes]:
    """The model in some rasters that lie on one grid; anything that GDAL reads, GeoTIFF and COG.

    ``paths`` : one raster, or tiles of one; where they overlap the first has its way. ``crs`` : the
    coordinate system, where the files have none. ``reference`` : what the heights count from, msl
    or ellipsoid; for the latter ``undulation`` of places [rad].

    Values belong to centres of cells and are bilinear between. Refuses (InputError) what is no
    raster of heights (DEM-UNREADABLE, DEM-RASTER, DEM-UNIT), rasters of several grids (DEM-TILES),
    and a system that is missing, or contradicts what is stated (DEM-CRS, CRS-VERTICAL).
    """
    try:
        import rasterio
    except ImportError:
        raise messages.dem_rasterio(where="ground.height.dem") from None
    where, key = str(paths[0]), "ground.height.crs"
    open_raster = lru_cache(maxsize=64)(rasterio.open)
    try:
        with rasterio.Env(**GDAL_OPTIONS):
            rasters = [_Raster(path, open_raster) for path in paths]
    except rasterio.errors.RasterioError as error:
        raise messages.dem_unreadable(where=where, error=str(error)) from None
    own = sorted({raster.crs for raster in rasters})
    if len(own) > 1 or not (own[0] or crs):
        if own[-1]:
            raise messages.rasters_of_several_systems(where=where)
        raise messages.rasters_without_system(where=where)
    corners = [[r.west + i * r.columns * r.step_x, r.north - k * r.rows * r.step_y]
               for r in rasters for i in (0, 1) for k in (0, 1)]  # fmt: skip
    system = grid_system(
        own[0] or str(crs), crs, corners=np.transpose(corners), heights=reference, where=where,
        key=key,
    )  # fmt: skip
    model = ElevationModel(rasters, system, undulation if reference == "ellipsoid" else None)
    rows, columns = model.size
    read = messages.elevation_read(
        where=where,
        count=len(rasters),
        columns=columns,
        rows=rows,
        step_x=rasters[0].step_x,
        step_y=rasters[0].step_y,
        system=system.name,
        heights=system.vertical or reference,
        unit_m=rasters[0].unit_m or system.unit_m,
        operation=system.by,
        is_good=system.is_good,
        is_sea_level=system.is_sea_level or not system.vertical,
    )
    return model, (read,)
