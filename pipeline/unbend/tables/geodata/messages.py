"""Messages of coordinate systems, elevation models, geoids and points."""

from pathlib import Path
from typing import Any

from unbend.errors import Code, ConfigError, Counted, InputError
from unbend.messages import Message, loss, note, warning

CRS_AREA = Code(
    "CRS-AREA",
    means=(
        "Positions are outside the area of their coordinate system, or outside the grid of its "
        "transformation."
    ),
    effect="They are unknown. If half of them or more are unknown, the mission is refused.",
    remedy=(
        "Write the system of the positions under the key that the message names, for example "
        "stations.orientation.crs: EPSG:25832. Check which column is x (east) and which is y "
        "(north)."
    ),
)


def positions_none(*, where: Path | str, key: str) -> InputError:
    """There are no positions to bring to WGS 84."""
    return InputError(
        CRS_AREA,
        "there are no positions",
        where=where,
        remedy=(
            "check {key}, and which column is which: x is east or longitude, y is north or "
            "latitude, for any order of the axes of the system"
        ),
        key=key,
    )


def positions_outside(
    *,
    where: Path | str,
    key: str,
    outside: int,
    total: int,
    system: str,
    area: str,
    x: float,
    y: float,
) -> InputError:
    """Half of the positions or more are outside the area of use of their system."""
    return InputError(
        CRS_AREA,
        (
            "{outside} of {total} are outside the area of {system} ({area}), the first is {x:g}, "
            "{y:g}"
        ),
        where=where,
        remedy=(
            "check {key}, and which column is which: x is east or longitude, y is north or "
            "latitude, for any order of the axes of the system"
        ),
        key=key,
        outside=outside,
        total=Counted(total, "position"),
        system=system,
        area=area,
        x=x,
        y=y,
    )


def some_positions_outside(
    *,
    where: str,
    key: str,
    count: int,
    total: int,
    system: str,
    area: str,
    x: float,
    y: float,
) -> Message:
    """Some positions, fewer than half, are outside the area of use of their system."""
    return loss(
        CRS_AREA,
        (
            "{count} of {total} are outside the area of {system} ({area}), the first is {x:g}, "
            "{y:g}. If the system is another one, write it as {key}; correct these rows if they "
            "are wrong"
        ),
        one=(
            "1 of {total} is outside the area of {system} ({area}): {x:g}, {y:g}. If the system is "
            "another one, write it as {key}; correct this row if it is wrong"
        ),
        where=where,
        key=key,
        count=count,
        total=Counted(total, "position"),
        system=system,
        area=area,
        x=x,
        y=y,
    )


def positions_beyond_grid(*, where: str, key: str, count: int, operation: str) -> Message:
    """Positions are inside the system's area, but the transformation's grid has no value there."""
    return loss(
        CRS_AREA,
        (
            "{count} positions are outside the grid of {operation}. Transform the coordinates to "
            "WGS 84 with a program that has a grid there, and write {key}: EPSG:4326"
        ),
        one=(
            "1 position is outside the grid of {operation}. Transform the coordinates to WGS 84 "
            "with a program that has a grid there, and write {key}: EPSG:4326"
        ),
        where=where,
        key=key,
        count=count,
        operation=operation,
    )


CRS_BALLPARK = Code(
    "CRS-BALLPARK",
    means="PROJ knows no transformation to WGS 84 of known accuracy for this system.",
    effect="The mission is refused.",
    remedy="Transform the coordinates to a system on WGS 84 or ETRS89, and state that system.",
)


def crs_ballpark(*, where: Path | str, name: str, named: str) -> InputError:
    """PROJ has no transformation of known accuracy; ``named`` is the key of the mission file."""
    return InputError(
        CRS_BALLPARK,
        "{name} has no transformation to WGS 84 with a known accuracy",
        where=where,
        name=name,
        named=named,
        remedy=(
            "transform the coordinates to a system on WGS 84 or ETRS89, and state that system: "
            "{named}"
        ),
    )


CRS_DATUM = Code(
    "CRS-DATUM",
    means="Positions were transformed to WGS 84 by the named transformation.",
    effect="A note; a warning if it is not better than 1 m.",
    remedy=(
        "If metres matter, install the grid that the entry names: python -m pyproj sync --file "
        "NAME. Or transform the coordinates to a system on WGS 84 or ETRS89, and write that system "
        "under the key that the entry names, for example stations.orientation.crs: EPSG:25832."
    ),
)

_WGS84_BETTER = (
    ". If metres matter, install the grid that is named here, if there is one (python -m pyproj "
    "sync --file NAME), or transform the coordinates to a system on WGS 84 or ETRS89 and write "
    "that system as {key}"
)


def positions_on_wgs84(
    *,
    where: str,
    key: str,
    count: int,
    system: str,
    crs: str,
    operation: str,
    is_good: bool,
) -> Message:
    """Positions were brought to WGS 84; a warning where that is not good to 1 m."""
    send = note if is_good else warning
    advice = "" if is_good else _WGS84_BETTER
    return send(
        CRS_DATUM,
        "{count} positions in {system} ({crs}) transformed to WGS 84 by {operation}" + advice,
        one="1 position in {system} ({crs}) transformed to WGS 84 by {operation}" + advice,
        where=where,
        key=key,
        count=count,
        system=system,
        crs=crs,
        operation=operation,
    )


CRS_UNKNOWN = Code(
    "CRS-UNKNOWN",
    means="PROJ does not know a coordinate system for positions with this name.",
    effect="The mission is refused.",
    remedy="State it as EPSG:25832, EPSG:4326 or EPSG:25832+5773.",
)


def crs_unknown(*, where: Path | str, crs: str, error: str, named: str) -> InputError:
    """PROJ does not know the system, or it is not a system of horizontal positions."""
    return InputError(
        CRS_UNKNOWN,
        "PROJ does not know a coordinate system for positions with the name {crs!r}: {error}",
        where=where,
        crs=crs,
        error=error,
        named=named,
        remedy="state {named} as EPSG:25832, EPSG:4326 or EPSG:25832+5773",
    )


CRS_VERTICAL = Code(
    "CRS-VERTICAL",
    means=(
        "Heights refer to a vertical datum that is not mean sea level or EGM96, to another "
        "ellipsoid than that of WGS 84, or to another reference than the stated one."
    ),
    effect=(
        "Refused, unless the grid of the datum is given. With the grid it is a note, a warning if "
        "the grid differs by 3 m or more from EGM96, and refused above 10 m."
    ),
    remedy=(
        "Give the grid of the datum as mission.geoid, or heights above the sea, or state the "
        "reference of the heights."
    ),
)


def crs_vertical_stated(
    *, where: Path | str, named: str, name: str, these: str, heights: str
) -> InputError:
    """The mission file states another surface of heights than the system has."""
    return InputError(
        CRS_VERTICAL,
        "the heights of {name} are {these}, but {heights} are stated",
        where=where,
        named=named,
        name=name,
        these=these,
        heights=heights,
        remedy="state {these} as their reference, or in {named} a system without heights",
    )


def crs_vertical_ellipsoid(
    *, where: Path | str, named: str, name: str, ellipsoid: str
) -> InputError:
    """Heights above the ellipsoid of a past survey."""
    return InputError(
        CRS_VERTICAL,
        "the ellipsoid of {name} is {ellipsoid}, and receivers do not give heights above it",
        where=where,
        named=named,
        name=name,
        ellipsoid=ellipsoid,
        remedy=(
            "{named}: give heights above mean sea level (msl), or positions in a system "
            "of WGS 84 or ETRS89"
        ),
    )


def crs_vertical_grid(
    *, where: Path | str, named: str, vertical: str, horizontal: str
) -> InputError:
    """The vertical datum is not mean sea level, and its grid of undulations is not given."""
    return InputError(
        CRS_VERTICAL,
        "its heights are {vertical}, and their relation to other heights is not known",
        where=where,
        named=named,
        vertical=vertical,
        horizontal=horizontal,
        remedy=(
            "{named}: give mission.geoid, the path of this datum's grid of undulations (.gtx or "
            "GeoTIFF); or, if a difference of some decimetres to a metre between sea levels does "
            "not matter, state only {horizontal}"
        ),
    )


def crs_vertical_other_grid(
    *, where: Path | str, named: str, geoid: str, off_m: float, vertical: str
) -> InputError:
    """The grid of undulations differs from EGM96 by more than any sea level does."""
    return InputError(
        CRS_VERTICAL,
        (
            "{geoid} differs by {off_m:+.1f} m from EGM96 at the positions, which is impossible "
            "for a sea level: it is not the grid of {vertical}, or has the opposite sign"
        ),
        where=where,
        named=named,
        geoid=geoid,
        off_m=off_m,
        vertical=vertical,
        remedy=(
            "{named}: give this datum's grid of undulations under mission.geoid: the "
            "ellipsoidal height minus the height above the datum"
        ),
    )


def heights_by_grid(
    *, where: str, count: int, datum: str, grid: str, off_m: float, is_usual: bool
) -> Message:
    """Heights were brought to the ellipsoid; a warning where the datum is far from EGM96."""
    send = note if is_usual else warning
    return send(
        CRS_VERTICAL,
        (
            "{grid} gives the relation of {datum} to the ellipsoid, {off_m:+.1f} m from EGM96 in "
            "the median"
        ),
        where=where,
        count=count,
        datum=datum,
        grid=grid,
        off_m=off_m,
    )


DEM_CRS = Code(
    "DEM-CRS",
    means=(
        "The rasters of the elevation model have no coordinate system, several, or another one "
        "than the mission file states."
    ),
    effect="The mission is refused.",
    remedy=(
        "If the rasters have no system, state ground.height.crs. If they have several, warp them "
        "to one system (gdalwarp)."
    ),
)


def dem_crs_stated(*, where: Path | str, own: str, other: str, named: str) -> InputError:
    """A raster states a coordinate system, ``own``, and the mission file states another."""
    return InputError(
        DEM_CRS,
        "the file is in {own}, but {other} is stated",
        where=where,
        own=own,
        other=other,
        named=named,
        remedy="leave {named} out, or write the correct system into the file",
    )


def rasters_without_system(*, where: Path | str) -> InputError:
    """No raster has a coordinate system, and the mission file states none."""
    return InputError(
        DEM_CRS,
        "the rasters have no coordinate system",
        where=where,
        remedy="state ground.height.crs, as EPSG:25832",
    )


def rasters_of_several_systems(*, where: Path | str) -> InputError:
    """The rasters have different coordinate systems, or only some have one."""
    return InputError(
        DEM_CRS,
        "the rasters have several coordinate systems",
        where=where,
        remedy="warp them to one system (gdalwarp), and write that system into each file",
    )


DEM_RASTER = Code(
    "DEM-RASTER",
    means=(
        "The elevation model is not a single band of heights, north up, or states blocks that are "
        "far too large for its file."
    ),
    effect="The mission is refused.",
    remedy="Write one band, north up (gdalwarp). Name the tiles of a VRT instead of the VRT.",
)


def dem_raster(
    *, where: Path | str, driver: str, bands: int, affine: tuple[float, float, float, float]
) -> InputError:
    """The raster is not one band with north up; ``affine`` are a, b, d, e of its cells."""
    step_x, row_x, column_y, step_y = affine
    return InputError(
        DEM_RASTER,
        (
            "it is a {driver} of {bands}, its cells ({step_x:g}, {row_x:g}, {column_y:g}, "
            "{step_y:g}); one band is needed, north up"
        ),
        where=where,
        remedy=(
            "write one band of heights, north up (gdalwarp); instead of a VRT, an index of tiles "
            "or a service, name the rasters themselves in ground.height.dem"
        ),
        driver=driver,
        bands=Counted(bands, "band"),
        step_x=step_x,
        row_x=row_x,
        column_y=column_y,
        step_y=step_y,
    )


def dem_block(*, where: Path | str, block_bytes: int) -> InputError:
    """A block of the raster, which GDAL unpacks at once, is far larger than the file."""
    return InputError(
        DEM_RASTER,
        "it states blocks of {block_bytes:,} bytes, out of all proportion to the size of the file",
        where=where,
        remedy="check the file, or write it in tiles (gdalwarp)",
        block_bytes=block_bytes,
    )


DEM_RASTERIO = Code(
    "DEM-RASTERIO",
    means="Elevation models are read by rasterio, which is not installed.",
    effect="The mission is refused.",
    remedy='pip install "unbend[rasters]", or give ground.height another source.',
)


def dem_rasterio(*, where: Path | str) -> InputError:
    """rasterio is not installed."""
    return InputError(
        DEM_RASTERIO,
        "elevation models are read by rasterio, which is not installed",
        where=where,
        remedy="pip install 'unbend[rasters]', or give ground.height another source",
    )


DEM_READ = Code(
    "DEM-READ",
    means="The elevation model was read. The entry has its heights, system and datum.",
    effect=(
        "A note; a warning if its datum is treated as mean sea level although it is another datum."
    ),
    remedy="Check the datum if a metre of height matters.",
)


def elevation_read(
    *,
    where: str,
    count: int,
    columns: int,
    rows: int,
    step_x: float,
    step_y: float,
    system: str,
    heights: str,
    unit_m: float,
    operation: str,
    is_good: bool,
    is_sea_level: bool,
) -> Message:
    """The elevation model that was read; a warning if position or height may be a metre off.

    ``count`` : of rasters. ``columns``, ``rows`` : of all together.
    """
    text = (
        "{count} rasters, {columns} by {rows} cells of {step_x:g} by {step_y:g} in {system}; "
        "heights are {heights}, in units of {unit_m:g} m; to WGS 84 by {operation}"
    )
    if not is_sea_level:
        text += "; {heights} is treated as mean sea level, and may differ from it by a metre"
    send = note if is_good and is_sea_level else warning
    return send(
        DEM_READ,
        text,
        one=text.replace("{count} rasters", "1 raster"),
        where=where,
        count=count,
        columns=columns,
        rows=rows,
        step_x=step_x,
        step_y=step_y,
        system=system,
        heights=heights,
        unit_m=unit_m,
        operation=operation,
    )


DEM_TILES = Code(
    "DEM-TILES",
    means="The tiles of the elevation model are not on the same grid.",
    effect="The mission is refused.",
    remedy="Warp them to one grid (gdalwarp).",
)


def dem_tiles(
    *,
    where: Path | str,
    off: float,
    first: str,
    step: tuple[float, float],
    first_step: tuple[float, float],
) -> InputError:
    """A raster is not on the grid of the ``first`` one; steps are those of x and y.

    ``off`` : the offset of its nodes in cells.
    """
    return InputError(
        DEM_TILES,
        (
            "its nodes are shifted by {off:.2g} cells from those of {first} (cells of {step_x:.9g} "
            "by {step_y:.9g}, there {first_x:.9g} by {first_y:.9g})"
        ),
        where=where,
        remedy=(
            "resample the rasters to one grid (gdalwarp), or name one of them in ground.height.dem"
        ),
        off=off,
        first=first,
        step_x=step[0],
        step_y=step[1],
        first_x=first_step[0],
        first_y=first_step[1],
    )


DEM_UNIT = Code(
    "DEM-UNIT",
    means="The heights of the elevation model are in an unknown unit.",
    effect="The mission is refused.",
    remedy="State the unit of the band as m or ft.",
)


def dem_unit(*, where: Path | str, unit: str) -> InputError:
    """The unit of the heights is not known."""
    return InputError(
        DEM_UNIT,
        "its heights are in {unit!r}, which is not a known unit of length",
        where=where,
        unit=unit,
        remedy="state the unit of the band as m or ft",
    )


DEM_UNREADABLE = Code(
    "DEM-UNREADABLE",
    means="The elevation model cannot be read.",
    effect="The mission is refused.",
    remedy="Check ground.height.dem, and the file with gdalinfo.",
)


def dem_unreadable(*, where: Path | str, error: str) -> InputError:
    """GDAL cannot read a raster, or a part of it."""
    return InputError(
        DEM_UNREADABLE,
        "it cannot be read as a raster: {error}",
        where=where,
        error=error,
        remedy="check ground.height.dem, and the file with gdalinfo",
    )


GEOID_GRID = Code(
    "GEOID-GRID",
    means=(
        "The file is not a grid of undulations, or it is a GeoTIFF and rasterio is not installed."
    ),
    effect="The mission or the export is refused.",
    remedy=(
        "Give a .gtx or GeoTIFF in geographic coordinates, with ellipsoidal minus orthometric "
        "heights in metres."
    ),
)


def _no_geoid(where: Path | str, why: str, **values: Any) -> InputError:
    """A file is not a grid of undulations: ``why``, a text with placeholders for ``values``."""
    return InputError(
        GEOID_GRID,
        f"it is not a grid of undulations: {why}",
        where=where,
        remedy=(
            "give a .gtx or a GeoTIFF in geographic coordinates of the ellipsoidal height"
            " minus the height above the geoid, in metres"
        ),
        **values,
    )


def geoid_unreadable(*, where: Path | str, error: str) -> InputError:
    """The operating system, or GDAL, cannot read the file."""
    return _no_geoid(where, "{error}", error=error)


def geoid_header(*, where: Path | str) -> InputError:
    """The first bytes of a .gtx are not its header."""
    return _no_geoid(where, "the header is not that of a GTX")


def geoid_size(*, where: Path | str, size: int, rows: int, columns: int) -> InputError:
    """A .gtx is longer or shorter than its header states."""
    why = "{size} are not {rows} times {columns} values"
    return _no_geoid(where, why, size=Counted(size, "byte"), rows=rows, columns=columns)


def geoid_needs_rasterio(*, where: Path | str) -> InputError:
    """The file is a GeoTIFF, but rasterio is not installed."""
    return _no_geoid(where, "a GeoTIFF needs rasterio: pip install 'unbend[rasters]'")


def geoid_bands(*, where: Path | str) -> InputError:
    """The raster has several bands, is projected, or names other rasters."""
    return _no_geoid(where, "one band in geographic coordinates is needed, in the file itself")


def geoid_turned(*, where: Path | str) -> InputError:
    """The raster is turned, or its first row is in the south."""
    return _no_geoid(where, "its rows are not along parallels, from north to south")


def geoid_too_large(*, where: Path | str, unpacked_bytes: int) -> InputError:
    """The raster states far more values than its file can have."""
    why = "it states {size:,} bytes of values, out of all proportion to the size of the file"
    return _no_geoid(where, why, size=unpacked_bytes)


def geoid_values(*, where: Path | str, lowest: float, highest: float) -> InputError:
    """The values of the grid are too small or too large for undulations."""
    why = "it contains {lowest:.0f} to {highest:.0f} m; undulations are -107 to 86 m"
    return _no_geoid(where, why, lowest=lowest, highest=highest)


def geoid_without_values(*, where: Path | str) -> InputError:
    """The grid has no value at all."""
    return _no_geoid(where, "it contains no values")


POINTS_COLUMN = Code(
    "POINTS-COLUMN",
    means="The table of points lacks a column.",
    effect="The mission is refused.",
    remedy="Name its columns under ground.height.columns or control.columns.",
)
POINTS_EMPTY = Code(
    "POINTS-EMPTY",
    means="The table or block has no points.",
    effect="The mission is refused.",
    remedy="Give points, or ground.height in another way.",
)


def points_empty(*, where: Path | str) -> InputError:
    """The table of points has no rows."""
    return InputError(
        POINTS_EMPTY, "the table has no rows", where=where, remedy="write one row for each point"
    )


POINTS_REPEATED = Code(
    "POINTS-REPEATED",
    means="Points occur in the table more than once.",
    effect="The mission is refused.",
    remedy="Write one row for each point.",
)


def points_repeated(*, where: Path | str, count: int, first: str) -> InputError:
    """Points occur in the table more than once."""
    return InputError(
        POINTS_REPEATED,
        "{count} points occur more than once, the first is {first}",
        one="1 point occurs more than once: {first}",
        where=where,
        count=count,
        remedy="write one row for each point",
        first=first,
    )


POINTS_TABLE = Code(
    "POINTS-TABLE",
    means="The table of points cannot be read as CSV or Parquet.",
    effect="The mission is refused.",
    remedy="Write it again.",
)


def points_table(*, where: Path | str, error: str) -> InputError:
    """Arrow cannot read the table of points, or a column is of another type."""
    return InputError(
        POINTS_TABLE,
        "it cannot be read as a table of points: {error}",
        where=where,
        error=error,
        remedy="write a Parquet file with names as text and numbers as float64",
    )


EXPORT_CRS = Code(
    "EXPORT-CRS",
    means=(
        "The coordinate system of --crs cannot be used for this export. For example, it is "
        "unknown, has no grid for angles, is far from the flight, or has heights that need a "
        "missing grid."
    ),
    effect="The export is refused.",
    remedy=(
        "Choose another system, as the refusal states. Outside the polar regions the UTM zone of "
        "the flight, on WGS 84, is possible."
    ),
)


def grid_unknown(*, crs: str, error: str) -> ConfigError:
    """PROJ does not know the system."""
    return ConfigError(
        EXPORT_CRS,
        "{crs!r} is not a coordinate system that PROJ knows: {error}",
        where="--crs",
        crs=crs,
        error=error,
        remedy="give a code, as EPSG:25832, or with a vertical part, EPSG:25832+5773",
    )


def grid_of_other_kind(*, crs: str, name: str, kind: str) -> ConfigError:
    """The system is neither projected nor geographic."""
    return ConfigError(
        EXPORT_CRS,
        "{name} ({crs}) has no map coordinates: its type is {kind}",
        where="--crs",
        crs=crs,
        name=name,
        kind=kind,
        remedy="give a projected system, for example the UTM zone of the flight",
    )


def grid_geographic(*, crs: str, name: str) -> ConfigError:
    """Angles against a grid need a projected system."""
    return ConfigError(
        EXPORT_CRS,
        "{name} ({crs}) has latitudes and longitudes: it has no grid for omega, phi, kappa",
        where="--crs",
        crs=crs,
        name=name,
        remedy=(
            "give a projected system, for example the UTM zone of the flight; without --crs the "
            "angles are relative to east, north, up at each station"
        ),
    )


def grid_without_places(*, crs: str) -> ConfigError:
    """No station has a position that could be projected."""
    return ConfigError(
        EXPORT_CRS,
        "no station has a position: nothing can be transformed to {crs}",
        where="--crs",
        crs=crs,
        remedy="check the stations of the run",
    )


def grid_elsewhere(*, crs: str, name: str, area: str) -> ConfigError:
    """The flight is far outside the system's area of use."""
    return ConfigError(
        EXPORT_CRS,
        "the flight is more than 2° outside the area of {name} ({crs}): {area}",
        where="--crs",
        crs=crs,
        name=name,
        area=area,
        remedy="give a system for the place of the flight, for example its UTM zone",
    )


def grid_ballpark(*, crs: str, name: str) -> ConfigError:
    """PROJ has no transformation of known accuracy to the system of an export."""
    return ConfigError(
        EXPORT_CRS,
        "{name} ({crs}) has no transformation from WGS 84 with a known accuracy",
        where="--crs",
        crs=crs,
        name=name,
        remedy=(
            "export in a system on WGS 84 or ETRS89, and transform the result with a program of "
            "the survey office; or install the grid of the transformation in PROJ's folder"
        ),
    )


def grid_left_handed(*, crs: str, name: str, axes: str) -> ConfigError:
    """The axes of the system are mirrored against east and north."""
    return ConfigError(
        EXPORT_CRS,
        "the axes of {name} ({crs}) point to {axes}: angles and vectors would be mirrored in it",
        where="--crs",
        crs=crs,
        name=name,
        axes=axes,
        remedy="give the system with axes to the east and north, as EPSG:5514 for EPSG:5513",
    )


def grid_scale_unfit(*, crs: str, name: str, lowest: float, highest: float) -> ConfigError:
    """The scale of the grid is far from one."""
    return ConfigError(
        EXPORT_CRS,
        (
            "the scale of {name} ({crs}) is {lowest:.4f} to {highest:.4f} here: horizontal "
            "distances and heights have different scales in it"
        ),
        where="--crs",
        crs=crs,
        name=name,
        lowest=lowest,
        highest=highest,
        remedy="give a system for surveys, for example the UTM zone of the flight",
    )


def grid_needs_geoid(*, crs: str, vertical: str) -> ConfigError:
    """The vertical datum needs the grid that belongs to it."""
    return ConfigError(
        EXPORT_CRS,
        "heights in {vertical} ({crs}) need the grid of this datum",
        where="--crs",
        crs=crs,
        vertical=vertical,
        remedy=(
            "give it: --geoid FILE (GTX or GeoTIFF, ellipsoidal minus orthometric height); or "
            "export without the vertical part, with heights above the ellipsoid"
        ),
    )


def grid_geoid_unused(*, crs: str) -> ConfigError:
    """A grid was given for a system without a vertical part that needs one."""
    return ConfigError(
        EXPORT_CRS,
        "{crs} has no vertical part that needs a grid",
        where="--geoid",
        crs=crs,
        remedy="leave it out, or state the vertical part: --crs EPSG:25832+7837",
    )


def grid_ellipsoid(*, crs: str, ellipsoid: str) -> ConfigError:
    """Heights above an ellipsoid of a past survey."""
    return ConfigError(
        EXPORT_CRS,
        "heights of {crs} refer to the ellipsoid {ellipsoid}, which is not that of WGS 84",
        where="--crs",
        crs=crs,
        ellipsoid=ellipsoid,
        remedy="give the two-dimensional system: heights then refer to the ellipsoid of WGS 84",
    )


def grid_geoid_elsewhere(*, geoid: str) -> ConfigError:
    """The grid of the vertical datum has no values where the flight is."""
    return ConfigError(
        EXPORT_CRS,
        "{geoid} has no value at the place of the flight",
        where="--geoid",
        geoid=geoid,
        remedy="give a grid that covers the flight",
    )


def grid_other_geoid(*, geoid: str, off_m: float, vertical: str) -> ConfigError:
    """The grid is so far from EGM96 that it cannot be one of undulations here."""
    return ConfigError(
        EXPORT_CRS,
        "{geoid} differs from EGM96 by {off_m:.1f} m here: it is not the grid of {vertical}",
        where="--geoid",
        geoid=geoid,
        off_m=off_m,
        vertical=vertical,
        remedy="give the grid of ellipsoidal minus orthometric heights of this datum",
    )


EXPORT_GRID = Code(
    "EXPORT-GRID",
    means=(
        "The relation of the export to its coordinate system: transformation, reference of the "
        "heights, convergence, scale."
    ),
    effect=(
        "A note. A warning if the accuracy of the transformation is not known to be 1 m or better, "
        "the flight is outside the area of the system, or angles are distorted in it."
    ),
    remedy="If it is a warning, choose another system, or install the named grid.",
)


def grid_reached(*, count: int, crs: str, name: str, operation: str, is_good: bool) -> Message:
    """The transformation to the system of an export; a warning if it is not good to 1 m."""
    send = note if is_good else warning
    return send(
        EXPORT_GRID,
        "{count} positions transformed from WGS 84 to {name} ({crs}) by {operation}",
        one="1 position transformed from WGS 84 to {name} ({crs}) by {operation}",
        where="--crs",
        count=count,
        crs=crs,
        name=name,
        operation=operation,
    )


def grid_heights(*, name: str, with_sea_level: str) -> Message:
    """Heights above the ellipsoid, in a system without a vertical part.

    ``with_sea_level`` is the system with heights above mean sea level; empty if it is not known.
    """
    text = (
        "heights in {name} (z) count from the ellipsoid of WGS 84, because the system has no "
        "vertical part"
    )
    if with_sea_level:
        text += "; for heights above mean sea level, as in the run, write --crs {with_sea_level}"
    return note(
        EXPORT_GRID,
        text,
        where="--crs",
        name=name,
        with_sea_level=with_sea_level,
    )


def grid_beyond_area(*, count: int, name: str, area: str) -> Message:
    """Positions are a little outside the area of use."""
    return warning(
        EXPORT_GRID,
        "{count} positions are outside the area of {name}: {area}",
        one="1 position is outside the area of {name}: {area}",
        where="--crs",
        count=count,
        name=name,
        area=area,
    )


def grid_axes(
    *, count: int, convergence: tuple[float, float], scale: tuple[float, float]
) -> Message:
    """Convergence [deg] and scale of a grid at the stations, lowest and highest."""
    return note(
        EXPORT_GRID,
        (
            "angles are relative to grid north: the convergence of {lowest_deg:.4f}° to "
            "{highest_deg:.4f}° is applied; x and y have the scale of {lowest:.6f} to "
            "{highest:.6f}, the heights do not have it"
        ),
        where="--crs",
        count=count,
        lowest_deg=convergence[0],
        highest_deg=convergence[1],
        lowest=scale[0],
        highest=scale[1],
    )


def grid_distorted(*, name: str, distortion: float) -> Message:
    """The projection is not conformal."""
    return warning(
        EXPORT_GRID,
        (
            "{name} is not conformal: the scales of two directions differ by up to {percent:.3f} % "
            "here, so that images do not fit it with one rotation; a UTM zone has no such "
            "difference"
        ),
        where="--crs",
        name=name,
        percent=100.0 * distortion,
    )
