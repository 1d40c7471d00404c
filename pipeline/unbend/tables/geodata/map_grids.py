"""Results in a stated coordinate system: coordinates, heights, convergence and scale of its grid.

The reverse of `coordinate_systems`: from WGS 84 by PROJ, without ballpark transformations. PROJ
does not transform heights: where it lacks a grid, it returns them unchanged without an error.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from unbend.flight.heights import LARGEST_GEOID_M, USUAL_GEOID_M
from unbend.geodesy import GeoidGrid, offset_geodetic
from unbend.messages import Notes
from unbend.tables.geodata import messages
from unbend.tables.geodata.coordinate_systems import (
    MARGIN_DEG,
    SEA_LEVELS,
    best_operation,
    is_in_area,
)
from unbend.tables.geodata.geoid import package_geoid
from unbend.units import WGS84_A, Array

if TYPE_CHECKING:
    from pyproj import CRS, Transformer
    from pyproj._crs import Axis

STEP_M = 100.0
"""Half the distance of the differences that give the axes of a grid. Relative errors of the
differences: 1e-11 by PROJ's rounding, 1e-10 by the curvature of the projection."""

LARGEST_SCALE_ERROR = 0.01
"""Largest difference from 1 of the scale of a grid for angles. Grids for surveys are within 0.003
in their area of use. In others, as Web Mercator, heights and distances have different scales."""

LARGEST_DISTORTION = 1e-5
"""Difference of the scales in two directions above which there is a warning: 3 cm at 3 km.
Conformal projections have none."""

SOUTHERN_END_OF_UTM_DEG = -80.0
NORTHERN_END_OF_UTM_DEG = 84.0
CODES_OF_NORTHERN_ZONES = 32600  # of EPSG, before the number of the zone
CODES_OF_SOUTHERN_ZONES = 32700

CODE_OF_EGM96_HEIGHTS = 5773  # of EPSG: heights above mean sea level, as runs have them

ELLIPSOID = "ellipsoid"
SEA_LEVEL = "sea level"
STATED_GEOID = "stated geoid"

_SUFFIXES = {"metre": "m", "US survey foot": "us_ft", "foot": "ft", "degree": "deg"}
"""Endings of the names of columns, by PROJ's names of units."""


@dataclass(frozen=True)
class Unit:
    """A unit of coordinates.

    ``suffix`` : the ending of the names of columns in this unit. ``size`` : in metres or radians.
    """

    name: str
    suffix: str
    size: float


@dataclass(frozen=True, eq=False)
class HeightReference:
    """What heights count from.

    ``kind`` : `ELLIPSOID` (of WGS 84), `SEA_LEVEL` (that of the run) or `STATED_GEOID` (that of the
    grid ``geoid``). ``name`` : of the datum. ``is_down`` : they are depths, positive downwards.
    """

    kind: str
    name: str
    unit: Unit
    is_down: bool = False
    geoid: GeoidGrid | None = None

    def heights(self, lat_rad: Array, lon_rad: Array, h_msl: Array, h_ellipsoid: Array) -> Array:
        """(n,) heights, or depths, against this reference in its unit; NaN where unknown.

        ``h_msl``, ``h_ellipsoid`` are the heights [m] above sea level and above the ellipsoid.
        """
        if self.kind == SEA_LEVEL:
            height_m = h_msl
        elif self.geoid is not None:
            height_m = h_ellipsoid - self.geoid.undulation(lat_rad, lon_rad)
        else:
            height_m = h_ellipsoid
        sign = -1.0 if self.is_down else 1.0
        return np.asarray(sign * height_m / self.unit.size)


@dataclass(frozen=True, eq=False)
class GridAxes:
    """Direction and scale of a grid's axes at (n,) places.

    ``convergence_rad`` : azimuth of the second axis, that is of grid north. ``scale`` : length in
    the grid of a metre on the ellipsoid [m], the mean of all directions. ``distortion`` : the
    largest difference of the scales of two directions; 0 for a conformal projection.
    """

    convergence_rad: Array
    scale: Array
    distortion: Array


@dataclass(frozen=True, eq=False)
class MapGrid:
    """A coordinate system that results are written in, map or geographic.

    ``identifier`` : as EPSG:25832, "" for a system without one. ``wkt``, ``wkt1`` : of the whole
    system, as ISO 19162 and as OGC 01-009, "" if it cannot be written so. ``axes`` : directions of
    the first and second coordinate as they are written; ``axis_order`` : directions of all
    coordinates in the order of the definition. ``unit`` : of the first two. ``operation`` : PROJ's
    transformation from WGS 84 in words; ``transformer`` does it, the best for one block.
    """

    identifier: str
    name: str
    wkt: str
    wkt1: str
    is_geographic: bool
    axes: tuple[str, str]
    axis_order: tuple[str, ...]
    unit: Unit
    height: HeightReference
    operation: str
    transformer: Transformer

    def coordinates(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """(n,) x and y of places; of a geographic system longitude and latitude [deg].

        NaN where the transformation has no value.
        """
        x, y = self.transformer.transform(np.degrees(lon_rad), np.degrees(lat_rad), errcheck=False)
        is_known = np.isfinite(x) & np.isfinite(y)
        return np.where(is_known, x, np.nan), np.where(is_known, y, np.nan)

    def places(self, x: Array, y: Array) -> tuple[Array, Array]:
        """(n,) longitude and latitude on WGS 84 [deg] of x and y; the reverse of `coordinates`."""
        lon, lat = self.transformer.transform(x, y, direction="INVERSE", errcheck=False)
        lon_deg = np.array(lon, dtype=np.float64)
        lat_deg = np.array(lat, dtype=np.float64)
        return lon_deg, lat_deg

    def axes_at(self, lat_rad: Array, lon_rad: Array) -> GridAxes:
        """The axes of the grid at (n,) places on the ellipsoid, from differences over 200 m."""
        east = self.at_step(lat_rad, lon_rad, east_m=STEP_M)
        west = self.at_step(lat_rad, lon_rad, east_m=-STEP_M)
        north = self.at_step(lat_rad, lon_rad, north_m=STEP_M)
        south = self.at_step(lat_rad, lon_rad, north_m=-STEP_M)
        # Derivatives of x and y [m] by metres to the east and to the north.
        to_derivative = self.unit.size / (2.0 * STEP_M)
        x_of_east, y_of_east = to_derivative * (east - west)
        x_of_north, y_of_north = to_derivative * (north - south)
        # The nearest similarity has half of these elements, the remainder is the distortion.
        cosine = x_of_east + y_of_north
        sine = x_of_north - y_of_east
        return GridAxes(
            convergence_rad=-np.arctan2(sine, cosine),
            scale=0.5 * np.hypot(sine, cosine),
            distortion=np.hypot(x_of_east - y_of_north, x_of_north + y_of_east),
        )

    def at_step(
        self, lat_rad: Array, lon_rad: Array, *, east_m: float = 0.0, north_m: float = 0.0
    ) -> Array:
        """(2, n) x and y of the places a step to the east and north of places on the ellipsoid."""
        step = np.tile([east_m, north_m, 0.0], (lat_rad.size, 1))
        height = np.zeros(lat_rad.size)
        lat, lon, _ = offset_geodetic(lat_rad, lon_rad, height, step)
        return np.stack(self.coordinates(lat, lon))


def open_grid(
    crs: str, lat_rad: Array, lon_rad: Array, *, geoid: GeoidGrid | None, needs_angles: bool
) -> tuple[MapGrid, Notes]:
    """The coordinate system of an export, with the best transformation for its stations.

    ``crs`` : as PROJ knows it, EPSG:25832 or EPSG:25832+7837. ``lat_rad``, ``lon_rad`` : (n,)
    places of the stations on WGS 84, NaN if unknown. ``geoid`` : the user's grid of the vertical
    part. ``needs_angles`` : the export has angles against the grid, so a geographic system is
    refused. Refuses (ConfigError EXPORT-CRS) what is not such a system, or cannot be reached.
    """
    parts = parts_of(crs)
    horizontal = parts.horizontal
    refuse_kind(horizontal, crs, needs_angles=needs_angles)
    is_known = np.isfinite(lat_rad) & np.isfinite(lon_rad)
    if not is_known.any():
        raise messages.grid_without_places(crs=crs)
    lon_lat_rad = np.stack([lon_rad[is_known], lat_rad[is_known]])
    lon_lat_deg = np.degrees(lon_lat_rad)
    if not is_in_area(horizontal, lon_lat_deg, MARGIN_DEG).all():
        raise messages.grid_elsewhere(crs=crs, name=horizontal.name, area=area_of(horizontal))
    best = best_operation("EPSG:4326", lon_lat_deg, horizontal.to_2d())
    if best is None:
        raise messages.grid_ballpark(crs=crs, name=horizontal.name)
    height, height_notes = height_reference(crs, parts, geoid, lon_lat_rad)
    grid = MapGrid(
        identifier=identifier_of(crs, parts.whole.to_authority(min_confidence=100)),
        name=parts.whole.name,
        wkt=parts.whole.to_wkt(),
        wkt1=wkt1_of(parts.whole),
        is_geographic=horizontal.is_geographic,
        axes=written_axes(horizontal),
        axis_order=tuple(axis.direction for axis in parts.whole.axis_info),
        unit=unit_of(horizontal.axis_info[0]),
        height=height,
        operation=best.description,
        transformer=best.transformer,
    )
    if not grid.is_geographic:
        refuse_left_handed(grid, crs, lat_rad[is_known][:1], lon_rad[is_known][:1])
    reached = messages.grid_reached(
        count=lon_lat_deg.shape[1],
        crs=crs,
        name=grid.name,
        operation=best.description,
        is_good=best.is_good,
    )
    return grid, (reached, *height_notes, *_notes_of_area(horizontal, lon_lat_deg))


def area_of(horizontal: CRS) -> str:
    """The name of a system's area of use; "the earth" if it states none."""
    return horizontal.area_of_use.name if horizontal.area_of_use else "the earth"


def _notes_of_area(horizontal: CRS, lon_lat_deg: Array) -> Notes:
    """A note if some of (2, n) longitudes and latitudes are outside a system's area of use."""
    outside = int(np.sum(~is_in_area(horizontal, lon_lat_deg, margin_deg=0.0)))
    if not outside:
        return ()
    name = horizontal.name
    return (messages.grid_beyond_area(count=outside, name=name, area=area_of(horizontal)),)


def utm_zone(lat_deg: float, lon_deg: float) -> str | None:
    """The EPSG code of the UTM zone of a place on WGS 84; None beyond 84° north or 80° south.

    >>> utm_zone(47.4, 8.6), utm_zone(-33.9, 18.4), utm_zone(85.0, 0.0)
    ('EPSG:32632', 'EPSG:32734', None)
    """
    if not SOUTHERN_END_OF_UTM_DEG <= lat_deg <= NORTHERN_END_OF_UTM_DEG:
        return None
    zone = int((lon_deg + 180.0) % 360.0 // 6.0) + 1
    codes = CODES_OF_NORTHERN_ZONES if lat_deg >= 0.0 else CODES_OF_SOUTHERN_ZONES
    return f"EPSG:{codes + zone}"


def utm_grid(lat_deg: float, lon_deg: float) -> MapGrid | None:
    """The UTM zone of a place on WGS 84, opened there; None beyond 84° north or 80° south."""
    code = utm_zone(lat_deg, lon_deg)
    if code is None:
        return None
    lat_rad = np.radians([lat_deg])
    lon_rad = np.radians([lon_deg])
    grid, _ = open_grid(code, lat_rad, lon_rad, geoid=None, needs_angles=False)
    return grid


@dataclass(frozen=True)
class SystemParts:
    """A coordinate system: its horizontal part, its vertical part or None, and the whole.

    ``horizontal`` is the whole if it is not compound, also with three dimensions.
    """

    horizontal: CRS
    vertical: CRS | None
    whole: CRS

    @property
    def is_3d(self) -> bool:
        """Whether the system is not compound, and has ellipsoidal heights."""
        return not self.whole.is_compound and len(self.whole.axis_info) == 3


def parts_of(crs: str) -> SystemParts:
    """The parts of a coordinate system; refuses (EXPORT-CRS) what PROJ does not know."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        whole = CRS.from_user_input(crs)
    except CRSError as error:
        raise messages.grid_unknown(crs=crs, error=str(error)) from None
    if not whole.is_compound:
        return SystemParts(whole, None, whole)
    horizontal, vertical = whole.sub_crs_list
    return SystemParts(horizontal, vertical, whole)


def refuse_kind(horizontal: CRS, crs: str, *, needs_angles: bool) -> None:
    """Refuse a system that is not projected or geographic; with ``needs_angles`` geographic too."""
    has_positions = horizontal.is_projected or horizontal.is_geographic
    if not has_positions or horizontal.is_geocentric:
        raise messages.grid_of_other_kind(crs=crs, name=horizontal.name, kind=horizontal.type_name)
    if needs_angles and horizontal.is_geographic:
        raise messages.grid_geographic(crs=crs, name=horizontal.name)


def identifier_of(crs: str, authority: tuple[str, str] | None) -> str:
    """The identifier of a system, as EPSG:25832; "" without one.

    ``authority`` : as PROJ knows it, None if it does not. Then the identifier is ``crs``, if that
    consists of two codes.

    >>> identifier_of("epsg:25832+5773", None), identifier_of("+proj=utm +zone=32", None)
    ('EPSG:25832+5773', '')
    """
    if authority is not None:
        return ":".join(authority)
    identifier = crs.strip().upper()
    if re.fullmatch(r"EPSG:\d+\+\d+", identifier):
        return identifier
    return ""


def wkt1_of(whole: CRS) -> str:
    """The WKT of a system as OGC 01-009, which older programs read; "" if it has none."""
    from pyproj.exceptions import CRSError

    try:
        text = whole.to_wkt("WKT1_GDAL")
    except CRSError:
        return ""
    return text or ""


def unit_of(axis: Axis) -> Unit:
    """The unit of an axis."""
    suffix = _SUFFIXES.get(axis.unit_name, axis.unit_name.lower().replace(" ", "_"))
    return Unit(axis.unit_name, suffix, axis.unit_conversion_factor)


def written_axes(horizontal: CRS) -> tuple[str, str]:
    """The directions of the first two coordinates, in the order of PROJ's option always_xy."""
    first, second = (axis.direction for axis in horizontal.axis_info[:2])
    if (first, second) == ("north", "east"):
        return second, first
    return first, second


def height_reference(
    crs: str, parts: SystemParts, geoid: GeoidGrid | None, lon_lat_rad: Array
) -> tuple[HeightReference, Notes]:
    """What the heights of an export count from, by the vertical part of its system.

    Without a vertical part they count from the ellipsoid of WGS 84, in the unit of a projected
    system. ``geoid`` : the user's grid; ``lon_lat_rad`` (2, n) : places of the flight. Refuses
    (ConfigError EXPORT-CRS) a datum without its grid or with a wrong one, a grid that is not
    needed, and another ellipsoid than that of WGS 84.
    """
    vertical = parts.vertical
    if geoid is not None and (vertical is None or vertical.name in SEA_LEVELS):
        raise messages.grid_geoid_unused(crs=crs)
    if vertical is None:
        return ellipsoidal_heights(crs, parts), _notes_of_ellipsoid(crs, parts)
    axis = vertical.axis_info[0]
    unit = unit_of(axis)
    is_down = axis.direction == "down"
    if vertical.name in SEA_LEVELS:
        return HeightReference(SEA_LEVEL, vertical.name, unit, is_down), ()
    if geoid is None:
        raise messages.grid_needs_geoid(crs=crs, vertical=vertical.name)
    lon, lat = lon_lat_rad
    difference_m = geoid.undulation(lat, lon) - package_geoid().undulation(lat, lon)
    known_m = difference_m[np.isfinite(difference_m)]
    if known_m.size == 0:
        raise messages.grid_geoid_elsewhere(geoid=geoid.name)
    off_m = float(np.median(known_m))
    if abs(off_m) > LARGEST_GEOID_M:
        raise messages.grid_other_geoid(geoid=geoid.name, off_m=off_m, vertical=vertical.name)
    note = messages.heights_by_grid(
        where="--geoid",
        count=known_m.size,
        datum=vertical.name,
        grid=geoid.name,
        off_m=off_m,
        is_usual=abs(off_m) <= USUAL_GEOID_M,
    )
    name = f"{vertical.name}, by {geoid.name}"
    return HeightReference(STATED_GEOID, name, unit, is_down, geoid), (note,)


def _notes_of_ellipsoid(crs: str, parts: SystemParts) -> Notes:
    """A note that heights count from the ellipsoid, for a system that does not define heights."""
    if parts.is_3d:
        return ()
    identifier = identifier_of(crs, parts.whole.to_authority(min_confidence=100))
    with_sea_level = ""
    if identifier.startswith("EPSG:"):
        with_sea_level = f"{identifier}+{CODE_OF_EGM96_HEIGHTS}"
    return (messages.grid_heights(name=parts.whole.name, with_sea_level=with_sea_level),)


def ellipsoidal_heights(crs: str, parts: SystemParts) -> HeightReference:
    """The reference of heights above the ellipsoid of WGS 84, for a system without vertical part.

    Refuses (EXPORT-CRS) a three-dimensional system on another ellipsoid.
    """
    ellipsoid = parts.horizontal.ellipsoid
    is_wgs84 = ellipsoid is not None and abs(ellipsoid.semi_major_metre - WGS84_A) <= 1.0
    if parts.is_3d and not is_wgs84:
        name = ellipsoid.name if ellipsoid is not None else "unknown"
        raise messages.grid_ellipsoid(crs=crs, ellipsoid=name)
    unit = unit_of(parts.horizontal.axis_info[0])
    if parts.horizontal.is_geographic:
        unit = Unit("metre", "m", 1.0)
    return HeightReference(ELLIPSOID, "ellipsoid of WGS 84", unit)


def refuse_left_handed(grid: MapGrid, crs: str, lat_rad: Array, lon_rad: Array) -> None:
    """Refuse (EXPORT-CRS) axes that are mirrored: y clockwise of x, seen from above.

    ``lat_rad``, ``lon_rad`` (1,) : the place at which they are tested.
    """
    middle = grid.at_step(lat_rad, lon_rad)
    to_east = grid.at_step(lat_rad, lon_rad, east_m=STEP_M) - middle
    to_north = grid.at_step(lat_rad, lon_rad, north_m=STEP_M) - middle
    sides = np.hstack([to_east, to_north])
    if np.linalg.det(sides) < 0.0:
        raise messages.grid_left_handed(crs=crs, name=grid.name, axes=" and ".join(grid.axes))


def check_grid_axes(axes: GridAxes, *, crs: str, name: str) -> Notes:
    """Notes on a grid for angles: convergence and scale, and a warning if it is distorted.

    ``axes`` : those at the stations, at least one. Refuses (ConfigError EXPORT-CRS) a grid with a
    scale that differs by more than 1 % from 1.
    """
    lowest = float(np.nanmin(axes.scale))
    highest = float(np.nanmax(axes.scale))
    if max(abs(lowest - 1.0), abs(highest - 1.0)) > LARGEST_SCALE_ERROR:
        raise messages.grid_scale_unfit(crs=crs, name=name, lowest=lowest, highest=highest)
    convergence = np.degrees(axes.convergence_rad)
    notes = [
        messages.grid_axes(
            count=axes.scale.size,
            convergence=(float(np.nanmin(convergence)), float(np.nanmax(convergence))),
            scale=(lowest, highest),
        )
    ]
    distortion = float(np.nanmax(axes.distortion))
    if distortion > LARGEST_DISTORTION:
        notes.append(messages.grid_distorted(name=name, distortion=distortion))
    return tuple(notes)


def utm_zone_of(crs: str) -> tuple[int, str] | None:
    """The number of the UTM zone of a system, and its hemisphere (N or S).

    None for other systems, and for one with the zone's number in front of x, as EPSG:4647.

    >>> utm_zone_of("EPSG:25833"), utm_zone_of("EPSG:32756")
    ((33, 'N'), (56, 'S'))
    >>> utm_zone_of("EPSG:2056"), utm_zone_of("EPSG:4647")
    (None, None)
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        zone = CRS.from_user_input(crs).utm_zone  # "32N", or "32N WITH PREFIX"
    except CRSError:
        return None
    zone_and_hemisphere = re.fullmatch(r"(\d{1,2})([NS])", zone or "")
    if zone_and_hemisphere is None:
        return None
    number, hemisphere = zone_and_hemisphere.groups()
    return int(number), hemisphere
