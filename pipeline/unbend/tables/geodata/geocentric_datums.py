"""Earth-centred axes of other datums than WGS 84, brought to it by PROJ as similarities."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.oriented_images import CartesianFrame
from unbend.geodesy import ecef_of_geodetic
from unbend.messages import Notes
from unbend.tables.geodata import messages
from unbend.tables.geodata.coordinate_systems import prime_meridian_deg, to_wgs84
from unbend.units import Array

if TYPE_CHECKING:
    from pyproj import Transformer


@dataclass(frozen=True)
class GeocentricDatum:
    """Earth-centred axes of the datum of a coordinate system, on its own ellipsoid."""

    crs: str
    name: str


def datum_of(crs: str) -> GeocentricDatum | None:
    """The datum of a coordinate system, as WKT or EPSG; None where PROJ knows none.

    >>> datum_of("EPSG:2056").name, datum_of("LOCAL_CS[...]")
    ('CH1903+', None)
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(crs)
    except CRSError:
        return None
    geodetic = system.geodetic_crs
    return None if geodetic is None else GeocentricDatum(crs, geodetic.name)


CUBE_M = 1000.0  # half an edge of the cube whose corners tell how a datum lies to another


def frame_of_datum(
    datum: GeocentricDatum, xyz: Array, *, keep_heights: bool, where: str, key: str
) -> tuple[CartesianFrame, Notes]:
    """The frame of the earth-centred x, y, z of another datum than WGS 84.

    ``xyz`` (n, 3) are positions of a block: about their middle the best transformation that PROJ
    has is taken as a similarity. ``keep_heights`` : heights above the own ellipsoid stay what they
    are, numbers above sea level that a program took for them. Refuses (InputError CRS-BALLPARK) a
    datum of which PROJ knows only the name.
    """
    is_known = np.isfinite(xyz).all(axis=1)
    middle = np.median(xyz[is_known], axis=0)
    corners = CUBE_M * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    places = own_geodetic(datum, middle + corners)
    transform, by, is_good = to_wgs84_with_heights(datum, places, where, key)
    lon, lat, h = transform.transform(*places.T)
    if keep_heights:
        h = places[:, 2]
    ecef = ecef_of_geodetic(np.radians(lat), np.radians(lon), h)
    note = messages.positions_on_wgs84(
        where=where,
        key=key,
        count=int(is_known.sum()),
        system=f"{datum.name}, earth-centred",
        crs=datum.name,
        operation=by,
        is_good=is_good,
    )
    return frame_through(corners, ecef, middle), (note,)


def frame_through(corners: Array, ecef: Array, middle: Array) -> CartesianFrame:
    """The similarity that brings (n, 3) corners about a place to earth-centred positions."""
    centre = ecef.mean(axis=0)
    rotation, _ = Rotation.align_vectors(ecef - centre, corners)
    matrix = rotation.as_matrix()
    turned = corners @ matrix.T
    scale = float(np.sum(turned * (ecef - centre)) / np.sum(turned**2))
    return CartesianFrame(matrix, centre - scale * matrix @ middle, scale)


def own_geodetic(datum: GeocentricDatum, xyz: Array) -> Array:
    """(n, 3) longitude, latitude [units of the datum's system] and height [m] on its ellipsoid."""
    from pyproj import CRS, Transformer

    geodetic = CRS.from_user_input(datum.crs).geodetic_crs
    ellipsoid = geodetic.ellipsoid
    axes = f"+a={ellipsoid.semi_major_metre} +b={ellipsoid.semi_minor_metre}"
    to_geodetic = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=cart {axes} "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    lon, lat, h = to_geodetic.transform(*xyz.T)
    unit_deg = np.degrees(geodetic.axis_info[0].unit_conversion_factor)
    return np.stack(
        [(lon - prime_meridian_deg(geodetic)) / unit_deg, lat / unit_deg, h],
        axis=1,
    )


def to_wgs84_with_heights(
    datum: GeocentricDatum, own: Array, where: str, key: str
) -> "tuple[Transformer, str, bool]":
    """As `to_wgs84` for (n, 3) longitudes, latitudes and ellipsoidal heights of a datum."""
    from pyproj import CRS

    system = CRS.from_user_input(datum.crs).geodetic_crs
    unit_deg = np.degrees(system.axis_info[0].unit_conversion_factor)
    lon_lat = unit_deg * own[:, :2].T + np.array([[prime_meridian_deg(system)], [0.0]])
    return to_wgs84(system.to_3d(), lon_lat, where, key, target="EPSG:4979")
