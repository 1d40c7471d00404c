"""Positions in a stated coordinate system, transformed to WGS 84 by pyproj.

PROJ transforms horizontally, without ballpark transformations. It does not transform heights: where
it lacks a grid, it returns them unchanged without an error. The name of their datum decides.
"""

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from unbend.flight.heights import LARGEST_GEOID_M, USUAL_GEOID_M
from unbend.geodesy import GeoidGrid
from unbend.messages import Message, Notes
from unbend.tables.geodata import messages
from unbend.tables.geodata.geoid import package_geoid
from unbend.units import WGS84_A, Array, Mask, measured

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

_GOOD_M = 1.0  # a transformation with a worse accuracy is a warning
MARGIN_DEG = 2.0  # positions may be so far outside the area of use of a coordinate system
SEA_LEVELS = ("EGM96 height", "MSL height")  # names of vertical datums that are mean sea level here


@dataclass(frozen=True, eq=False)
class Places:
    """(n,) latitude, longitude [rad] on WGS 84 and height [m] of positions; NaN where unknown.

    ``heights`` is what the heights count from: msl, ellipsoid or relative. ``convergence_rad`` (n,)
    is the azimuth of grid north, 0 for geographic positions.
    """

    lat_rad: Array
    lon_rad: Array
    h_m: Array
    heights: str
    convergence_rad: Array


def places_of(
    crs: str,
    xyh: tuple[Array, Array, Array],
    *,
    heights: str,
    geoid: GeoidGrid | None,
    where: str,
    key: str,
) -> tuple[Places, Notes]:
    """Positions on WGS 84 of (n,) x, y and heights in a coordinate system.

    ``crs`` : as PROJ knows it, EPSG:25832 or EPSG:25832+7837. ``xyh`` : x to the east and y to the
    north in its unit, or longitude and latitude [deg], for any order of its axes; heights [m], or
    in the unit of its vertical part. ``heights`` : what these count from, as stated: msl, ellipsoid
    or relative. ``geoid`` : the user's grid of the vertical datum, needed if that is not mean sea
    level. ``where``, ``key`` : the file, and the key of the mission file, for messages.

    Refuses (InputError) a ``crs`` that is not such a system (CRS-UNKNOWN), or has only a ballpark
    transformation (CRS-BALLPARK), positions outside its area (CRS-AREA), and a vertical part that
    contradicts ``heights`` or needs a grid (CRS-VERTICAL). A transformation worse than 1 m is a
    warning (CRS-DATUM), which names the grid that would make it better.
    """
    horizontal, vertical = horizontal_and_vertical(crs, heights, where, key)
    x, y, h = xyh
    lon_lat = in_own_datum(horizontal, x, y)
    lon_lat, notes = _nan_outside_area(lon_lat, horizontal, where, key, (x, y))
    is_known = np.asarray(np.isfinite(lon_lat).all(axis=0))
    operation = to_wgs84(horizontal, lon_lat[:, is_known], where, key)
    count = int(is_known.sum())
    note = messages.positions_on_wgs84(
        where=where,
        key=key,
        count=count,
        system=horizontal.name,
        crs=crs,
        operation=operation.description,
        is_good=operation.is_good,
    )
    notes.append(note)
    lat, lon = _transformed(operation.transformer, x, y, is_known)
    is_known = np.isfinite(lat)  # without those beyond the grid of the transformation
    if is_known.sum() < count:
        note = messages.positions_beyond_grid(
            where=where,
            key=key,
            count=count - int(is_known.sum()),
            operation=operation.description,
        )
        notes.append(note)
    if vertical is not None:
        h = _metres_upwards(vertical, h)
        if vertical.name not in SEA_LEVELS:
            if geoid is None:
                raise messages.crs_vertical_grid(
                    where=where,
                    named=key,
                    vertical=vertical.name,
                    horizontal=horizontal.to_string(),
                )
            h, note = _above_ellipsoid(
                h,
                vertical,
                geoid,
                (lat, lon),
                count=count,
                where=where,
                key=key,
            )
            notes.append(note)
            heights = "ellipsoid"
    places = Places(
        lat_rad=lat,
        lon_rad=lon,
        h_m=h,
        heights=heights,
        convergence_rad=_convergence(horizontal, lon_lat, is_known),
    )
    return places, tuple(notes)


def _transformed(
    transformer: "Transformer", x: Array, y: Array, is_known: Mask
) -> tuple[Array, Array]:
    """(n,) latitude and longitude [rad] of x and y; NaN if not ``is_known``, or without a value."""
    known_x = np.where(is_known, x, np.nan)
    lon, lat = np.radians(np.array(transformer.transform(known_x, y, errcheck=False)))
    has_no_value = ~(is_known & np.isfinite(lat))
    lat[has_no_value] = np.nan
    lon[has_no_value] = np.nan
    return lat, lon


def _convergence(horizontal: "CRS", lon_lat_deg: Array, is_known: Mask) -> Array:
    """(n,) azimuth of grid north [rad] at (2, n) places; 0 in a geographic system, or if unknown.

    ``is_known`` (n,) : the places at which it is computed.
    """
    convergence_rad = np.zeros(is_known.size)
    if horizontal.is_projected:
        lon_deg, lat_deg = lon_lat_deg[:, is_known]
        _, _, known_rad = grid_coordinates(horizontal.to_string(), lon_deg, lat_deg)
        convergence_rad[is_known] = known_rad
    return convergence_rad


def _above_ellipsoid(
    h_m: Array,
    vertical: "CRS",
    geoid: GeoidGrid,
    lat_lon: tuple[Array, Array],
    *,
    count: int,
    where: str,
    key: str,
) -> tuple[Array, Message]:
    """(n,) heights [m] above the ellipsoid, and a note, of heights ``h_m`` in a vertical datum.

    ``geoid`` : the grid of the datum. ``lat_lon`` : (n,) places [rad]. ``count`` : of known
    positions, for the note. Refuses (CRS-VERTICAL) a grid too far from EGM96 for any datum.
    """
    undulation = geoid.undulation(*lat_lon)
    off_m = _median_difference_from_egm96(undulation, *lat_lon)
    if abs(off_m) > LARGEST_GEOID_M:
        raise messages.crs_vertical_other_grid(
            where=where,
            named=key,
            geoid=geoid.name,
            off_m=off_m,
            vertical=vertical.name,
        )
    note = messages.heights_by_grid(
        where=where,
        count=count,
        datum=vertical.name,
        grid=geoid.name,
        off_m=off_m,
        is_usual=abs(off_m) <= USUAL_GEOID_M,
    )
    return h_m + undulation, note


def _metres_upwards(vertical: "CRS", h: Array) -> Array:
    """Heights [m], positive upwards, of numbers in the unit and direction of a vertical system."""
    axis = vertical.axis_info[0]
    h = h * axis.unit_conversion_factor
    return -h if axis.direction == "down" else h


def _median_difference_from_egm96(undulation: Array, lat_rad: Array, lon_rad: Array) -> float:
    """Median of (n,) undulations [m] less those of EGM96; 0 if all are NaN."""
    difference_m = undulation - package_geoid().undulation(lat_rad, lon_rad)
    known_m = difference_m[np.isfinite(difference_m)]
    return float(np.median(known_m)) if known_m.size else 0.0


def in_own_datum(horizontal: Any, x: Array, y: Array) -> Array:
    """(2, n) longitude and latitude [deg, from Greenwich] in the datum of a system, of its x, y."""
    from pyproj import Transformer

    geodetic = horizontal.geodetic_crs
    to_geodetic = Transformer.from_crs(horizontal, geodetic, always_xy=True)
    lon_lat = np.array(to_geodetic.transform(x, y, errcheck=False))
    unit_rad = geodetic.axis_info[0].unit_conversion_factor  # grads of Paris, for example
    lon_lat *= np.degrees(unit_rad)
    lon_lat[0] += prime_meridian_deg(geodetic)
    return lon_lat


@dataclass(frozen=True, eq=False)
class BestOperation:
    """The best transformation between two systems that PROJ can do with its installed grids.

    ``description`` : in words, with its accuracy, and the grid that a better one needs.
    ``is_good`` : its known accuracy is 1 m or better.
    """

    transformer: "Transformer"
    description: str
    is_good: bool


def best_operation(
    source: "CRS | str", lon_lat: Array, target: "CRS | str"
) -> BestOperation | None:
    """The best transformation from ``source`` to ``target`` in the extent of (2, n) places [deg].

    ``lon_lat`` : longitudes and latitudes. The transformation gives no values beyond its grid: no
    other replaces it there. None if PROJ has only a ballpark transformation.
    """
    from pyproj.aoi import AreaOfInterest
    from pyproj.network import set_network_enabled
    from pyproj.transformer import TransformerGroup

    set_network_enabled(False)  # whatever PROJ_NETWORK and proj.ini say
    corners = (*lon_lat.min(axis=1).tolist(), *lon_lat.max(axis=1).tolist())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a missing grid: it is in the description
        group = TransformerGroup(
            source,
            target,
            always_xy=True,
            allow_ballpark=False,
            area_of_interest=AreaOfInterest(*corners),
        )
    if not group.transformers:
        return None
    best = group.transformers[0]
    has_accuracy = best.accuracy >= 0.0  # PROJ has -1 for an unknown accuracy
    description = f"{best.description or 'an unnamed operation'}"
    description += f", to {best.accuracy:g} m" if has_accuracy else ", of unknown accuracy"
    if not group.best_available and group.unavailable_operations:
        better = group.unavailable_operations[0]
        grids = ", ".join(grid.short_name for grid in better.grids)
        description += f"; {better.name} to {better.accuracy:g} m needs {grids} in PROJ's folder"
    return BestOperation(best, description, is_good=0.0 <= best.accuracy <= _GOOD_M)


def to_wgs84(
    horizontal: "CRS", lon_lat: Array, where: str, key: str, *, target: str = "EPSG:4326"
) -> BestOperation:
    """The best transformation to WGS 84 in the extent of (2, n) longitudes and latitudes [deg].

    ``target`` is WGS 84 with or without heights. Refuses (CRS-BALLPARK) a system that has none.
    """
    best = best_operation(horizontal, lon_lat, target)
    if best is None:
        raise messages.crs_ballpark(where=where, name=horizontal.name, named=key)
    return best


def grid_coordinates(crs: str, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array, Array]:
    """x, y [m] and the azimuth of grid north [rad] of (n,) places in the datum of ``crs``.

    NaN where the projection does not reach; ValueError if PROJ does not know it.
    """
    from pyproj import CRS, Proj
    from pyproj.exceptions import ProjError

    try:
        projection = Proj(crs)
        meridian_deg = prime_meridian_deg(CRS.from_user_input(crs))
    except ProjError as error:
        raise ValueError(str(error)) from None
    x, y = projection(lon_deg, lat_deg)
    # Longitudes count from Greenwich in the projection, from its prime meridian in get_factors.
    factors = projection.get_factors(lon_deg - meridian_deg, lat_deg)
    convergence_deg = np.asarray(factors.meridian_convergence)
    x = measured(np.asarray(x))
    y = measured(np.asarray(y))
    return x, y, np.radians(measured(convergence_deg))


def prime_meridian_deg(system: Any) -> float:
    """Longitude of a system's prime meridian from Greenwich [deg]."""
    meridian = system.prime_meridian
    return float(np.degrees(meridian.longitude * meridian.unit_conversion_factor))


def kind_of_system(crs: str) -> str | None:
    """The kind of a system: geographic, projected or ecef; None for others, or if PROJ has none.

    >>> kind_of_system("EPSG:32632"), kind_of_system("WGS84"), kind_of_system("EPSG:4978")
    ('projected', 'geographic', 'ecef')
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(crs)
    except CRSError:
        return None
    if system.is_geocentric:
        return "ecef"
    if system.is_projected:
        return "projected"
    return "geographic" if system.is_geographic else None


def name_of_system(crs: str) -> str:
    """The name of a system that PROJ knows.

    >>> name_of_system("EPSG:25833")
    'ETRS89 / UTM zone 33N'
    """
    from pyproj import CRS

    return str(CRS.from_user_input(crs).name)


def lat_lon_of(crs: str, x: Array, y: Array) -> tuple[Array, Array] | None:
    """(n,) latitudes and longitudes on WGS 84 [rad] of (n,) x and y in a system.

    x and y are longitude and latitude [deg] in a geographic system. Accurate to some metres, for
    comparisons. NaN where the system does not reach; None if PROJ does not know it.
    """
    from pyproj import CRS, Transformer
    from pyproj.exceptions import CRSError, ProjError

    try:
        system = CRS.from_user_input(crs)
        to_wgs84 = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
        lon_deg, lat_deg = to_wgs84.transform(x, y)
    except (CRSError, ProjError):
        return None
    lat_rad = np.radians(measured(lat_deg))
    lon_rad = np.radians(measured(lon_deg))
    return lat_rad, lon_rad


def is_on_wgs84(crs: str) -> bool:
    """Whether PROJ knows a system, WKT or EPSG, and its ellipsoid is that of WGS 84 or GRS 80.

    >>> is_on_wgs84("EPSG:25832"), is_on_wgs84("EPSG:27561"), is_on_wgs84("LOCAL_CS[...]")
    (True, False, False)
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        ellipsoid = CRS.from_user_input(crs).ellipsoid
    except CRSError:
        return False
    return ellipsoid is not None and abs(ellipsoid.semi_major_metre - WGS84_A) < 1.0


def horizontal_and_vertical(crs: str, heights: str, where: str, key: str) -> tuple[Any, Any]:
    """The horizontal part of a system, two-dimensional, and its vertical part, None without one.

    ``heights`` : what heights count from, as stated. Refuses what is not a system of positions
    (CRS-UNKNOWN), and, both CRS-VERTICAL, stated heights that contradict the system, and heights
    above another ellipsoid than that of WGS 84.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        whole = CRS.from_user_input(crs)
        horizontal, *vertical = whole.sub_crs_list if whole.is_compound else [whole]
        has_positions = horizontal.is_projected or horizontal.is_geographic
        if not has_positions or horizontal.is_geocentric:
            raise CRSError(f"{whole.name} is a {whole.type_name}")
    except CRSError as error:
        raise messages.crs_unknown(where=where, crs=crs, error=str(error), named=key) from None
    ellipsoid = horizontal.ellipsoid
    heights_of_system = heights
    if vertical:
        heights_of_system = "msl"
    elif len(whole.axis_info) == 3:
        heights_of_system = "ellipsoid"
    if heights_of_system != heights:
        raise messages.crs_vertical_stated(
            where=where, named=key, name=whole.name, these=heights_of_system, heights=heights
        )
    if heights == "ellipsoid" and abs(ellipsoid.semi_major_metre - WGS84_A) > 1.0:
        raise messages.crs_vertical_ellipsoid(
            where=where, named=key, name=horizontal.name, ellipsoid=ellipsoid.name
        )
    return horizontal.to_2d(), vertical[0] if vertical else None


def is_in_area(system: "CRS", lon_lat: Array, margin_deg: float) -> Mask:
    """(n,) which of (2, n) longitudes and latitudes [deg] are in a system's area of use.

    The area is extended by a margin on each side. A system without a stated area contains all.
    """
    area = system.area_of_use
    if area is None:
        return np.ones(lon_lat.shape[1], np.bool_)
    width_deg = area.east - area.west
    if area.west > area.east:
        width_deg += 360.0  # over the 180th meridian
    west_deg = area.west - margin_deg
    width_deg = min(width_deg + 2.0 * margin_deg, 360.0)
    lon, lat = lon_lat
    is_inside = (lon - west_deg) % 360.0 <= width_deg
    is_inside &= lat >= area.south - margin_deg
    is_inside &= lat <= area.north + margin_deg
    return np.asarray(is_inside)


def _nan_outside_area(
    lon_lat: Array, horizontal: Any, where: str, key: str, xy: tuple[Array, Array]
) -> tuple[Array, list[Message]]:
    """(2, n) longitudes and latitudes [deg], NaN outside the system's area of use; and notes.

    ``xy`` : the same positions in the system, NaN for those without. Some positions outside are a
    loss. Refuses (CRS-AREA) if half of them or more are outside, or there are no positions.
    """
    area = horizontal.area_of_use
    area_name = area.name if area else "the earth"
    has_xy = np.isfinite(xy).all(axis=0)
    if not has_xy.any():
        raise messages.positions_none(where=where, key=key)
    lon_lat = np.where(np.isfinite(lon_lat), lon_lat, np.nan)
    has_lon_lat = np.isfinite(lon_lat).all(axis=0)
    is_inside = has_lon_lat & is_in_area(horizontal, lon_lat, MARGIN_DEG)
    is_outside = has_xy & ~is_inside
    count = int(is_outside.sum())
    if count == 0:
        return lon_lat, []
    total = int(has_xy.sum())
    first = int(np.argmax(is_outside))
    x = float(xy[0][first])
    y = float(xy[1][first])
    if 2 * count >= total:
        raise messages.positions_outside(
            where=where,
            key=key,
            outside=count,
            total=total,
            system=horizontal.name,
            area=area_name,
            x=x,
            y=y,
        )
    some_outside = messages.some_positions_outside(
        where=where,
        key=key,
        count=count,
        total=total,
        system=horizontal.name,
        area=area_name,
        x=x,
        y=y,
    )
    return np.where(is_inside, lon_lat, np.nan), [some_outside]
