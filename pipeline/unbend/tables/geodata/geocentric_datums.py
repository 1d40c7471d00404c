"""Earth-centred axes of other datums than WGS 84, brought to its axes by similarities from PROJ."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from unbend.block.oriented_images import CartesianFrame
from unbend.geodesy import ecef_of_geodetic
from unbend.messages import Notes
from unbend.tables.geodata import messages
from unbend.tables.geodata.coordinate_systems import (
    BestOperation,
    prime_meridian_deg,
    to_wgs84,
)
from unbend.units import Array


@dataclass(frozen=True)
class GeocentricDatum:
    """The datum of a coordinate system ``crs``, with its earth-centred axes and its ellipsoid.

    ``name`` is that of its geodetic system.
    """

    crs: str
    name: str


def datum_of(crs: str) -> GeocentricDatum | None:
    """The datum of a coordinate system, WKT or EPSG; None if PROJ does not know one.

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


CUBE_M = 1000.0  # half an edge of the cube with the corners that define the similarity


def frame_of_datum(
    datum: GeocentricDatum, xyz: Array, *, keep_heights: bool, where: str, key: str
) -> tuple[CartesianFrame, Notes]:
    """The frame of earth-centred x, y, z of another datum than WGS 84, and a note.

    ``xyz`` (n, 3) : positions of a block [m], NaN if unknown. Around their middle the best
    transformation of PROJ is taken as a similarity. ``keep_heights`` : the heights above the
    datum's ellipsoid are not transformed, because they are heights above sea level that a program
    treated as ellipsoidal. ``where``, ``key`` : the file, and the mission file's key, for messages.
    Refuses (InputError CRS-BALLPARK) a datum without a transformation of known accuracy.
    """
    is_known = np.isfinite(xyz).all(axis=1)
    middle = np.median(xyz[is_known], axis=0)
    corners = CUBE_M * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    geodetic = geodetic_in_datum(datum, middle + corners)
    operation = to_wgs84_with_heights(datum, geodetic, where, key)
    lon, lat, h = operation.transformer.transform(*geodetic.T)
    if keep_heights:
        h = geodetic[:, 2]
    ecef = ecef_of_geodetic(np.radians(lat), np.radians(lon), h)
    note = messages.positions_on_wgs84(
        where=where,
        key=key,
        count=int(is_known.sum()),
        system=f"{datum.name}, earth-centred",
        crs=datum.name,
        operation=operation.description,
        is_good=operation.is_good,
    )
    return fitted_frame(corners, ecef, middle), (note,)


def fitted_frame(corners: Array, ecef: Array, middle: Array) -> CartesianFrame:
    """The similarity that brings positions in another datum to earth-centred ones on WGS 84.

    ``corners`` (n, 3) : the positions less ``middle`` (3,) [m], symmetrical about it. ``ecef``
    (n, 3) : the same positions on WGS 84 [m].
    """
    centre = ecef.mean(axis=0)
    rotation, _ = Rotation.align_vectors(ecef - centre, corners)
    matrix = rotation.as_matrix()
    turned = corners @ matrix.T
    scale = float(np.sum(turned * (ecef - centre)) / np.sum(turned**2))
    return CartesianFrame(matrix, centre - scale * matrix @ middle, scale)


def geodetic_in_datum(datum: GeocentricDatum, xyz: Array) -> Array:
    """(n, 3) longitude, latitude and ellipsoidal height [m] of earth-centred xyz (n, 3) in a datum.

    Longitude and latitude are in the unit of the datum's system, from its prime meridian.
    """
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
    datum: GeocentricDatum, geodetic: Array, where: str, key: str
) -> BestOperation:
    """`to_wgs84` with heights, for ``geodetic`` (n, 3) as of `geodetic_in_datum`."""
    from pyproj import CRS

    system = CRS.from_user_input(datum.crs).geodetic_crs
    unit_deg = np.degrees(system.axis_info[0].unit_conversion_factor)
    lon_lat = unit_deg * geodetic[:, :2].T + np.array([[prime_meridian_deg(system)], [0.0]])
    return to_wgs84(system.to_3d(), lon_lat, where, key, target="EPSG:4979")
