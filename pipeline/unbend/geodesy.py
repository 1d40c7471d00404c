"""The figure of the earth: radii, normal gravity, geopotential, local frames.

Heights above mean sea level (orthometric) are written ``h``; heights above the ellipsoid
``h_ellipsoid``; their difference is the undulation, ``h_ellipsoid = h + undulation``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.units import STANDARD_GRAVITY, WGS84_A, WGS84_F, Array

_E2 = WGS84_F * (2.0 - WGS84_F)  # first eccentricity squared
_WGS84_B = WGS84_A * (1.0 - WGS84_F)  # polar semi-axis [m]
_SECOND_E2 = (WGS84_A**2 - _WGS84_B**2) / _WGS84_B**2  # second eccentricity squared

# Constants of WGS84's normal gravity (NIMA TR8350.2).
_G_EQUATOR = 9.7803253359  # normal gravity at the equator [m s-2]
_SOMIGLIANA = 0.00193185265241  # (b g_pole) / (a g_equator) - 1
_CENTRIFUGAL = 0.00344978650684  # omega^2 a^2 b / GM

_BOWRING_STEPS = 3  # one step leaves 1e-11 rad at 100 km, two are exact to rounding


@dataclass(frozen=True)
class Gravity:
    """Gravity above a place, which turns heights into geopotential heights.

    Parameters
    ----------
    g_phi : gravity at sea level [m s-2].
    r_phi : effective radius [m]: gravity at a height h is g_phi (r_phi / (r_phi + h))^2.
    latitude_rad : of the place, or None for a standard atmosphere with constants of its own.
    """

    g_phi: float
    r_phi: float
    latitude_rad: float | None = None

    def geopotential_height(self, h: ArrayLike) -> Array:
        """Geopotential height H [m'] of heights ``h`` [m] above sea level (Gyer 1996, p. 307).

        >>> float(Gravity(9.80665, 6356766.0).geopotential_height(11019.1).round(1))
        11000.0
        """
        h = np.asarray(h, dtype=np.float64)
        return self.r_phi * h * self.g_phi / ((self.r_phi + h) * STANDARD_GRAVITY)

    def height(self, geopotential: ArrayLike) -> Array:
        """Height above sea level [m] of geopotential heights [m'], the inverse function.

        >>> float(Gravity(9.80665, 6356766.0).height(11000.0).round(1))
        11019.1
        """
        reduced = np.asarray(geopotential, dtype=np.float64) * STANDARD_GRAVITY / self.g_phi
        return self.r_phi * reduced / (self.r_phi - reduced)


def lambert_gravity(latitude_rad: float) -> Gravity:
    """Sea-level gravity and effective radius at a latitude, after Lambert.

    Valid at all latitudes; the geopotential height stays within 0.10 m of integrated WGS84
    normal gravity up to 10 km (0.11 m at the poles) and within 0.27 m up to 25 km.
    Source: Gyer 1996, p. 307; List 1958, p. 218, Equation 6.

    >>> gravity = lambert_gravity(0.7853981633974483)
    >>> round(gravity.g_phi, 5), round(gravity.r_phi)
    (9.80616, 6356360)
    """
    sin2 = np.sin(latitude_rad) ** 2
    sin2_double = np.sin(2.0 * latitude_rad) ** 2
    g_phi = 9.780356 * (1.0 + 0.0052885 * sin2 - 0.0000059 * sin2_double)
    cos2 = np.cos(2.0 * latitude_rad)
    cos4 = np.cos(4.0 * latitude_rad)
    gradient = 3.085462e-6 + 2.27e-9 * cos2 - 2e-12 * cos4
    r_phi = 2.0 * g_phi / gradient
    return Gravity(float(g_phi), float(r_phi), float(latitude_rad))


def normal_gravity(latitude_rad: float) -> Gravity:
    """WGS84 normal gravity at the ellipsoid, and the effective radius for its decrease with height.

    Valid at all latitudes; a pressure integrated with it has a relative error below 1e-6 up to
    25 km.
    Source: Somigliana's formula and the free-air gradient at the ellipsoid (NIMA TR8350.2, 4-1
    and 4-3).

    >>> gravity = normal_gravity(0.7853981633974483)
    >>> round(gravity.g_phi, 5), round(gravity.r_phi)
    (9.8062, 6356209)
    """
    sin2 = np.sin(latitude_rad) ** 2
    g_phi = _G_EQUATOR * (1.0 + _SOMIGLIANA * sin2) / np.sqrt(1.0 - _E2 * sin2)
    r_phi = WGS84_A / (1.0 + WGS84_F + _CENTRIFUGAL - 2.0 * WGS84_F * sin2)
    return Gravity(float(g_phi), float(r_phi), float(latitude_rad))


def euler_radius(latitude_rad: ArrayLike, azimuth_rad: ArrayLike) -> Array:
    """Radius of curvature [m] of the WGS84 ellipsoid in an azimuth, by Euler's formula.

    ``latitude_rad`` and ``azimuth_rad`` (clockwise from north) broadcast. At a pole every azimuth
    gives the polar radius of curvature.

    >>> euler_radius(0.0, [0.0, 1.5707963267948966]).round(1).tolist()
    [6335439.3, 6378137.0]
    """
    meridian, prime_vertical = principal_radii(latitude_rad)
    cos_a = np.cos(azimuth_rad)
    sin_a = np.sin(azimuth_rad)
    curvature = cos_a * cos_a / meridian + sin_a * sin_a / prime_vertical
    return np.asarray(1.0 / curvature)


def principal_radii(latitude_rad: ArrayLike) -> tuple[Array, Array]:
    """Radii of curvature [m] of the WGS84 ellipsoid in the meridian and in the prime vertical.

    >>> [round(float(r), 1) for r in principal_radii(0.0)]
    [6335439.3, 6378137.0]
    """
    sin_phi = np.sin(np.asarray(latitude_rad, dtype=np.float64))
    w2 = 1.0 - _E2 * sin_phi * sin_phi
    prime_vertical = WGS84_A / np.sqrt(w2)
    meridian = prime_vertical * (1.0 - _E2) / w2
    return meridian, prime_vertical


def offset_geodetic(
    latitude_rad: Array, longitude_rad: Array, h_ellipsoid: Array, enu: Array
) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and ellipsoidal height [m] of places after a straight step.

    ``enu`` (n, 3) are the steps [m] along east, north and up at their starts. Computed in
    earth-centred coordinates, also at the poles and across the 180th meridian. Within 5e-9 m of the
    same step in extended precision, for steps up to 1000 km. Longitudes are in [-pi, pi].
    """
    point = ecef_of_geodetic(latitude_rad, longitude_rad, h_ellipsoid)
    axes = enu_from_ecef(latitude_rad, longitude_rad)
    for axis in range(3):
        point = point + axes[:, axis] * enu[:, axis, None]
    return geodetic_of_ecef(*point.T)


def longitudes_near(longitude_rad: Array, reference_rad: ArrayLike) -> Array:
    """Longitudes [rad], moved by whole turns to within half a turn of a reference.

    So they are continuous across the 180th meridian. The reference is one or (n,).

    >>> np.degrees(longitudes_near(np.radians([179.0, -179.0]), 3.1)).round().tolist()
    [179.0, 181.0]
    """
    reference = np.broadcast_to(np.asarray(reference_rad, np.float64), longitude_rad.shape)
    return np.asarray(np.unwrap([reference, longitude_rad], axis=0)[1])


def wrapped(angle_rad: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def ecef_of_geodetic(latitude_rad: Array, longitude_rad: Array, h_ellipsoid: Array) -> Array:
    """(n, 3) earth-centred coordinates [m] of (n,) geodetic ones on WGS84.

    >>> ecef_of_geodetic(np.zeros(1), np.zeros(1), np.full(1, 100.0)).tolist()
    [[6378237.0, 0.0, 0.0]]
    """
    sin_p = np.sin(latitude_rad)
    cos_p = np.cos(latitude_rad)
    prime_vertical = WGS84_A / np.sqrt(1.0 - _E2 * sin_p * sin_p)
    from_axis = (prime_vertical + h_ellipsoid) * cos_p
    x = from_axis * np.cos(longitude_rad)
    y = from_axis * np.sin(longitude_rad)
    z = (prime_vertical * (1.0 - _E2) + h_ellipsoid) * sin_p
    return np.stack([x, y, z], axis=-1)


def enu_from_ecef(latitude_rad: Array, longitude_rad: Array) -> Array:
    """(n, 3, 3) rotations from earth-centred axes to east, north, up at (n,) places.

    The vertical turns with the place: 324 arcsec per 10 km.
    """
    sin_p = np.sin(latitude_rad)
    cos_p = np.cos(latitude_rad)
    sin_l = np.sin(longitude_rad)
    cos_l = np.cos(longitude_rad)
    east = np.stack([-sin_l, cos_l, np.zeros_like(sin_l)], axis=-1)
    north = np.stack([-sin_p * cos_l, -sin_p * sin_l, cos_p], axis=-1)
    up = np.stack([cos_p * cos_l, cos_p * sin_l, sin_p], axis=-1)
    return np.stack([east, north, up], axis=-2)


def geodetic_of_ecef(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and ellipsoidal height [m] of earth-centred coordinates [m].

    Bowring's formula, iterated. Within 1e-15 rad and 5e-9 m of PROJ from -10 km to 100 km.
    """
    p = np.hypot(x, y)
    beta = np.arctan2(z, (1.0 - WGS84_F) * p)
    latitude = beta
    for _ in range(_BOWRING_STEPS):
        latitude = np.arctan2(
            z + _SECOND_E2 * _WGS84_B * np.sin(beta) ** 3,
            p - _E2 * WGS84_A * np.cos(beta) ** 3,
        )
        beta = np.arctan2((1.0 - WGS84_F) * np.sin(latitude), np.cos(latitude))
    longitude = np.arctan2(y, x)
    sin_p = np.sin(latitude)
    w = np.sqrt(1.0 - _E2 * sin_p * sin_p)
    height = p * np.cos(latitude) + z * sin_p - WGS84_A * w
    return latitude, longitude, height


_TOLERANCE = 1e-6  # of a grid's edges and of its width: rounded headers


@dataclass(frozen=True, eq=False)
class _Cell:
    """The cells of a grid that contain places: their corners, and where in them the places are.

    Parameters
    ----------
    south_west, south_east, north_west, north_east : undulations [m]; NaN outside the grid.
    north_share : of the way from the southern to the northern side.
    east_share : of the way from the western to the eastern side.
    """

    south_west: Array
    south_east: Array
    north_west: Array
    north_east: Array
    north_share: Array
    east_share: Array


@dataclass(frozen=True, eq=False)
class GeoidGrid:
    """Undulations on a grid of geographic coordinates.

    Parameters
    ----------
    name : of the geoid and its grid.
    values_m : (rows, columns) ellipsoidal minus orthometric height [m], from the south-west corner
        to the north and east; NaN where unknown.
    south_deg, west_deg : the place of the first value.
    step_lat_deg, step_lon_deg : distance of two rows, and of two columns.
    """

    name: str
    values_m: NDArray[np.float32]
    south_deg: float
    west_deg: float
    step_lat_deg: float
    step_lon_deg: float

    def _cell(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> _Cell:
        """The cells of the grid that contain places [rad]; NaN corners outside the grid."""
        rows, columns = self.values_m.shape
        goes_round = abs(columns * self.step_lon_deg - 360.0) < _TOLERANCE
        cells_across = columns
        if not goes_round:
            cells_across -= 1
        degrees_north = np.degrees(np.asarray(lat_rad, np.float64)) - self.south_deg
        degrees_east = np.degrees(np.asarray(lon_rad, np.float64)) - self.west_deg
        # A place on the western edge may be a little less than 360 degrees east of it.
        degrees_east = (degrees_east + 1e-9) % 360.0 - 1e-9
        y, x = np.broadcast_arrays(
            degrees_north / self.step_lat_deg, degrees_east / self.step_lon_deg
        )
        is_inside = y > -_TOLERANCE
        is_inside &= y < rows - 1 + _TOLERANCE
        is_inside &= x < cells_across + _TOLERANCE
        whole_y = np.where(is_inside, y, 0.0).astype(np.int64)
        whole_x = np.where(is_inside, x, 0.0).astype(np.int64)
        south = np.clip(whole_y, 0, rows - 2)
        west = np.clip(whole_x, 0, cells_across - 1)
        north = south + 1
        east = (west + 1) % columns

        def corner(row: NDArray[np.int64], column: NDArray[np.int64]) -> Array:
            """Undulations [m] of one corner of each cell."""
            values = self.values_m[row, column].astype(np.float64)
            return np.where(is_inside, values, np.nan)

        return _Cell(
            south_west=corner(south, west),
            south_east=corner(south, east),
            north_west=corner(north, west),
            north_east=corner(north, east),
            north_share=y - south,
            east_share=x - west,
        )

    def undulation(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> Array:
        """Undulation [m] at places [rad] that broadcast; NaN outside the grid and in its holes.

        Bilinear, as PROJ's vgridshift; continuous over the date line and at the poles.

        >>> values_m = np.array([[40, 41, 42], [42, 43, 44]], np.float32)
        >>> region = GeoidGrid("region", values_m, 46.0, 5.0, step_lat_deg=1.0, step_lon_deg=1.0)
        >>> region.undulation(np.radians(46.5), np.radians(6.25)).round(6).tolist()
        42.25
        """
        cell = self._cell(lat_rad, lon_rad)
        north = cell.north_share
        east = cell.east_share
        south_side = cell.south_west * (1.0 - east) + cell.south_east * east
        north_side = cell.north_west * (1.0 - east) + cell.north_east * east
        return np.asarray(south_side * (1.0 - north) + north_side * north)

    def deflection(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> tuple[Array, Array]:
        """Deflection of the vertical to the north (xi) and to the east (eta), both [rad].

        xi and eta are minus the slopes of the geoid to the north and east (Heiskanen & Moritz 1967,
        Eq. 2-204), here of the bilinear surface of a grid cell. The grid of EGM96 with 15
        minutes smooths over 28 km: in mountains this is an error of several arcseconds. Not defined
        at the poles.
        """
        cell = self._cell(lat_rad, lon_rad)
        north = cell.north_share
        east = cell.east_share
        south_rise = cell.south_east - cell.south_west
        north_rise = cell.north_east - cell.north_west
        west_rise = cell.north_west - cell.south_west
        east_rise = cell.north_east - cell.south_east
        rise_eastwards = south_rise * (1.0 - north) + north_rise * north
        rise_northwards = west_rise * (1.0 - east) + east_rise * east
        lat = np.asarray(lat_rad, np.float64)
        meridian, prime_vertical = principal_radii(lat)
        height_of_cell = meridian * np.radians(self.step_lat_deg)
        width_of_cell = prime_vertical * np.cos(lat) * np.radians(self.step_lon_deg)
        with np.errstate(divide="ignore", invalid="ignore"):
            return (
                np.asarray(-rise_northwards / height_of_cell),
                np.asarray(-rise_eastwards / width_of_cell),
            )
