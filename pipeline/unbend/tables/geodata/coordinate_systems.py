"""Positions in a stated coordinate system, brought to WGS 84, by pyproj.

Horizontally by PROJ without ballpark transformations. Heights stay what they are, by the name of
their datum: PROJ returns them unchanged, and says nothing, where it lacks a grid.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
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

_GOOD_M = 1.0  # a transformation that is no better than this is a warning
MARGIN_DEG = 2.0  # so far outside its area of use a coordinate system is still meant
SEA_LEVELS = ("EGM96 height", "MSL height")  # vertical datums that are mean sea level here


@dataclass(frozen=True, eq=False)
class Places:
    """(n,) latitude, longitude [rad] on WGS 84 and height [m] of positions; NaN where unknown.

    ``heights`` says what they count from: msl, ellipsoid, or as stated. ``convergence_rad`` is the
    azimuth of grid north, 0 where the positions were geographic.
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

    ``crs`` as PROJ knows it, EPSG:25832 or EPSG:25832+7837. ``xyh`` : x to the east and y to the
    north in its unit, or longitude and latitude [deg], whatever the order of its axes; heights [m],
    or in the unit of its vertical part, and ``heights`` what these count from, as stated: msl,
    ellipsoid or relative. ``geoid`` is the user's grid that belongs to the vertical part, where
    that is no mean sea level; ``where``, ``key`` are the file, and the mission file's key.

    Refuses (InputError) what is no such system (CRS-UNKNOWN), one that has only a ballpark
    transformation (CRS-BALLPARK), positions outside its area (CRS-AREA), and a vertical part that
    contradicts ``heights`` or needs a grid (CRS-VERTICAL). A transformation worse than 1 m is a
    warning (CRS-DATUM), which names the grid that would make it better.
    """
    horizontal, vertical = _system(crs, heights, where, key)
    x, y, h = xyh
    lon_lat, notes = _inside(_own_places(horizontal, x, y), horizontal, where, key, (x, y))
    is_known = np.isfinite(lon_lat).all(axis=0)
    best, by, is_good = to_wgs84(horizontal, lon_lat[:, is_known], where, key)
    count = int(is_known.sum())
    note = messages.positions_on_wgs84(
        where=where,
        key=key,
        count=count,
        system=horizontal.name,
        crs=crs,
        operation=by,
        is_good=is_good,
    )
    notes.append(note)
    x_or_nan = np.where(is_known, x, np.nan)
    lon, lat = np.radians(np.array(best.transform(x_or_nan, y, errcheck=False)))
    is_known &= np.isfinite(lat)  # not beyond the grid of the transformation
    lat[~is_known] = np.nan
    lon[~is_known] = np.nan
    beyond = count - int(is_known.sum())
    if beyond > 0:
        notes.append(
            messages.positions_beyond_grid(where=where, key=key, count=beyond, operation=by)
        )
    convergence = np.zeros(lat.size)
    if horizontal.is_projected:
        known_places = lon_lat[:, is_known]
        _, _, known_convergence = grid_coordinates(horizontal.to_string(), *known_places)
        convergence[is_known] = known_convergence
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
    return Places(lat, lon, h, heights, convergence), tuple(notes)


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
    """Heights [m] above the ellipsoid of those in a vertical datum, by the grid that belongs to it.

    Refuses (CRS-VERTICAL) a grid that lies elsewhere than any geoid.
    """
    undulation = geoid.undulation(*lat_lon)
    off_m = _off_from_package(undulation, *lat_lon)
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
    """Heights [m] of numbers in the unit and the direction of a vertical system."""
    axis = vertical.axis_info[0]
    h = h * axis.unit_conversion_factor
    return -h if axis.direction == "down" else h


def _off_from_package(undulation: Array, lat_rad: Array, lon_rad: Array) -> float:
    """How far undulations [m] are from EGM96 in the median, 0 where none is known."""
    off = undulation - package_geoid().undulation(lat_rad, lon_rad)
    known_off = off[np.isfinite(off)]
    return float(np.median(known_off)) if known_off.size else 0.0


def _own_places(horizontal: Any, x: Array, y: Array) -> Array:
    """(2, n) longitude and latitude [deg, from Greenwich] in a system's own datum."""
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
    """The best transformation between two systems that PROJ can do here.

    ``transformer`` is PROJ's; ``by`` says in words what it is; ``is_good`` whether it is known to
    be good to 1 m.
    """

    transformer: "Transformer"
    by: str
    is_good: bool


def best_operation(
    source: "CRS | str", lon_lat: Array, target: "CRS | str"
) -> BestOperation | None:
    """The transformation that is best about (2, n) places, with the grids that are here.

    No other takes its place where its grid ends. None where PROJ has only a ballpark one.
    """
    from pyproj.aoi import AreaOfInterest
    from pyproj.network import set_network_enabled
    from pyproj.transformer import TransformerGroup

    set_network_enabled(False)  # whatever PROJ_NETWORK and proj.ini say
    corners = (*lon_lat.min(axis=1).tolist(), *lon_lat.max(axis=1).tolist())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the words say it
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
    by = f"{best.description or 'an unnamed operation'}"
    by += f", to {best.accuracy:g} m" if best.accuracy >= 0.0 else ", of unknown accuracy"
    if not group.best_available and group.unavailable_operations:
        missing = group.unavailable_operations[0]
        grids = ", ".join(grid.short_name for grid in missing.grids)
        by += f"; {missing.name} to {missing.accuracy:g} m needs {grids} in PROJ's folder"
    return BestOperation(best, by, 0.0 <= best.accuracy <= _GOOD_M)


def to_wgs84(
    horizontal: Any, lon_lat: Array, where: str, key: str, *, target: str = "EPSG:4326"
) -> tuple[Any, str, bool]:
    """The best transformation to WGS 84 about (2, n) places, what it is, and whether to 1 m."""
    best = best_operation(horizontal, lon_lat, target)
    if best is None:
        raise messages.crs_ballpark(where=where, name=horizontal.name, named=key)
    return best.transformer, best.by, best.is_good


def grid_coordinates(crs: str, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array, Array]:
    """x, y [m] and the azimuth of grid north [rad] of (n,) places, without a shift of datum.

    NaN where the projection does not reach; ValueError where PROJ knows no such projection.
    """
    from pyproj import CRS, Proj
    from pyproj.exceptions import ProjError

    try:
        projection = Proj(crs)
        meridian_deg = prime_meridian_deg(CRS.from_user_input(crs))
    except ProjError as error:
        raise ValueError(str(error)) from None
    x, y = projection(lon_deg, lat_deg)
    # Places count from Greenwich in the projection, and from its own meridian in the factors.
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
    """Whether a system of PROJ's is geographic, projected or ecef; None for another, or none.

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
    """(n,) latitudes and longitudes on WGS 84 [rad] of x and y in a system, or lon and lat [deg].

    To some metres, for comparisons; NaN where the system does not reach, None where PROJ does not
    know it.
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


@dataclass(frozen=True)
class GridSystem:
    """The coordinate system of a grid.

    ``to_grid`` makes x, y (longitude, latitude [deg]) of longitude and latitude on WGS 84 [deg],
    ``to_places`` the reverse; ``by`` says how, ``is_good`` whether to 1 m. ``vertical`` names its
    vertical datum, "" without one, whose unit is ``unit_m``.
    """

    name: str
    geographic: bool
    to_grid: Callable[[Array, Array], tuple[Array, Array]]
    to_places: Callable[[Array, Array], tuple[Array, Array]]
    by: str
    is_good: bool
    vertical: str = ""
    is_sea_level: bool = True
    unit_m: float = 1.0


def grid_system(
    own: str, stated: str | None, *, corners: Array, heights: str, where: str, key: str
) -> GridSystem:
    """The system of a grid by its own words, WKT or EPSG, which must be the stated one.

    ``corners`` (2, n) are x and y of its corners. Refuses (InputError) as `places_of` does, and two
    systems that differ (DEM-CRS).
    """
    horizontal, vertical = _system(own, heights, where, key)
    other, of_other = _system(stated or own, heights, where, key)
    vertical = vertical or of_other
    if not horizontal.equals(other, ignore_axis_order=True):
        raise messages.dem_crs_stated(where=where, own=horizontal.name, other=other.name, named=key)
    places = _own_places(horizontal, *corners)
    is_known = np.isfinite(places).all(axis=0)
    best, by, is_good = to_wgs84(horizontal, places[:, is_known], where, key)
    system = GridSystem(
        name=horizontal.name,
        geographic=horizontal.is_geographic,
        to_grid=partial(best.transform, direction="INVERSE"),
        to_places=best.transform,
        by=by,
        is_good=is_good,
    )
    if vertical is None:
        return system
    return replace(
        system,
        vertical=vertical.name,
        is_sea_level=vertical.name in SEA_LEVELS,
        unit_m=vertical.axis_info[0].unit_conversion_factor,
    )


def is_on_wgs84(crs: str) -> bool:
    """Whether PROJ knows the system, as WKT or EPSG, on the ellipsoid of WGS 84 or GRS 80.

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


def _system(crs: str, heights: str, where: str, key: str) -> tuple[Any, Any]:
    """The horizontal part, two-dimensional, and the vertical part or None; refuses no system.

    And heights that are not above what the system says, or above an ellipsoid of a past survey.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        whole = CRS.from_user_input(crs)
        horizontal, *vertical = whole.sub_crs_list if whole.is_compound else [whole]
        if not (horizontal.is_projected or horizontal.is_geographic) or horizontal.is_geocentric:
            raise CRSError(f"{whole.name} is a {whole.type_name}")
    except CRSError as error:
        raise messages.crs_unknown(where=where, crs=crs, error=str(error), named=key) from None
    ellipsoid = horizontal.ellipsoid
    of_system = heights
    if vertical:
        of_system = "msl"
    elif len(whole.axis_info) == 3:
        of_system = "ellipsoid"
    if of_system != heights:
        raise messages.crs_vertical_stated(
            where=where, named=key, name=whole.name, these=of_system, heights=heights
        )
    if heights == "ellipsoid" and abs(ellipsoid.semi_major_metre - WGS84_A) > 1.0:
        raise messages.crs_vertical_ellipsoid(
            where=where, named=key, name=horizontal.name, ellipsoid=ellipsoid.name
        )
    return horizontal.to_2d(), vertical[0] if vertical else None


def is_in_area(system: "CRS", lon_lat: Array, margin_deg: float) -> Mask:
    """(n,) whether (2, n) longitudes and latitudes [deg] are in a system's area of use.

    A margin around the area counts too. All places are, of a system that states no area.
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


def _inside(
    lon_lat: Array, horizontal: Any, where: str, key: str, given: tuple[Array, Array]
) -> tuple[Array, list[Message]]:
    """(2, n) places with NaN outside the system's area of use; refuses where most are outside."""
    area = horizontal.area_of_use
    area_name = area.name if area else "the earth"
    is_given = np.isfinite(given).all(axis=0)
    if not is_given.any():
        raise messages.positions_none(where=where, key=key)
    lon_lat = np.where(np.isfinite(lon_lat), lon_lat, np.nan)
    is_place = np.isfinite(lon_lat).all(axis=0)
    is_inside = is_place & is_in_area(horizontal, lon_lat, MARGIN_DEG)
    is_outside = is_given & ~is_inside
    count = int(is_outside.sum())
    if count == 0:
        return lon_lat, []
    total = int(is_given.sum())
    first = int(np.argmax(is_outside))
    x = float(given[0][first])
    y = float(given[1][first])
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
