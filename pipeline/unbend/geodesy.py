"""The figure of the earth: radii, normal gravity, geopotential, local frames.

Heights above mean sea level (orthometric) are written ``h``; heights above the ellipsoid
``h_ellipsoid``; their difference is the undulation, ``h_ellipsoid = h + undulation``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.units import STANDARD_GRAVITY, WGS84_A, WGS84_F, Array

_E2 = WGS84_F * (2.0 - WGS84_F)

# WGS84: normal gravity at the equator [m s-2], Somigliana's constant, and omega^2 a^2 b / GM.
_G_EQUATOR, _SOMIGLIANA, _CENTRIFUGAL = 9.7803253359, 0.00193185265241, 0.00344978650684


@dataclass(frozen=True)
class Gravity:
    """What turns a height into a geopotential height: ``g_phi``, gravity at sea level [m s-2], and
    ``r_phi``, the effective radius [m] by which it falls off.

    ``latitude_rad`` : where, or None for a standard atmosphere with constants of its own.
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
        """Height above sea level [m] of geopotential heights [m']; inverse of the former.

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
    gradient = 3.085462e-6 + 2.27e-9 * cos2 - 2e-12 * np.cos(4.0 * latitude_rad)
    return Gravity(float(g_phi), float(2.0 * g_phi / gradient), float(latitude_rad))


def normal_gravity(latitude_rad: float) -> Gravity:
    """WGS84 normal gravity at the ellipsoid, and the effective radius by which it falls off.

    Valid at all latitudes; pressure integrated with it stays within 1e-6 of itself up to 25 km.
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
    cos_a, sin_a = np.cos(azimuth_rad), np.sin(azimuth_rad)
    return np.asarray(1.0 / (cos_a * cos_a / meridian + sin_a * sin_a / prime_vertical))


def principal_radii(latitude_rad: ArrayLike) -> tuple[Array, Array]:
    """Radii of curvature [m] of the WGS84 ellipsoid in the meridian and in the prime vertical.

    >>> [round(float(r), 1) for r in principal_radii(0.0)]
    [6335439.3, 6378137.0]
    """
    sin_phi = np.sin(np.asarray(latitude_rad, dtype=np.float64))
    w2 = 1.0 - _E2 * sin_phi * sin_phi
    prime_vertical = WGS84_A / np.sqrt(w2)
    return prime_vertical * (1.0 - _E2) / w2, prime_vertical


def offset_geodetic(
    latitude_rad: Array, longitude_rad: Array, h_ellipsoid: Array, enu: Array
) -> tuple[Array, Array, Array]:
    """Geodetic position reached by a small step in east, north and up.

    ``enu`` is (n, 3) [m]; exact to 1 mm for steps below 1 km, computed in earth-centred
    coordinates, so poles and the 180th meridian are no special case. Longitudes return in
    [-pi, pi].
    """
    point = ecef_of_geodetic(latitude_rad, longitude_rad, h_ellipsoid)
    axes = enu_from_ecef(latitude_rad, longitude_rad)
    for axis in range(3):
        point = point + axes[:, axis] * enu[:, axis, None]
    return geodetic_of_ecef(*point.T)


def longitudes_near(longitude_rad: Array, reference_rad: ArrayLike) -> Array:
    """(n,) longitudes [rad] within half a turn of a reference, on across the 180th meridian.

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
    sin_p, cos_p = np.sin(latitude_rad), np.cos(latitude_rad)
    radius = WGS84_A / np.sqrt(1.0 - _E2 * sin_p * sin_p)
    across, up = (radius + h_ellipsoid) * cos_p, (radius * (1.0 - _E2) + h_ellipsoid) * sin_p
    return np.stack([across * np.cos(longitude_rad), across * np.sin(longitude_rad), up], axis=-1)


def enu_from_ecef(latitude_rad: Array, longitude_rad: Array) -> Array:
    """(n, 3, 3) rotations from earth-centred axes to east, north, up at (n,) places.

    The vertical turns with the place: 324 arcsec per 10 km.
    """
    sin_p, cos_p = np.sin(latitude_rad), np.cos(latitude_rad)
    sin_l, cos_l = np.sin(longitude_rad), np.cos(longitude_rad)
    east = np.stack([-sin_l, cos_l, np.zeros_like(sin_l)], axis=-1)
    north = np.stack([-sin_p * cos_l, -sin_p * sin_l, cos_p], axis=-1)
    up = np.stack([cos_p * cos_l, cos_p * sin_l, sin_p], axis=-1)
    return np.stack([east, north, up], axis=-2)


def geodetic_of_ecef(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and ellipsoidal height [m] of earth-centred coordinates [m].

    Bowring's formula iterated three times: 1e-12 rad and 1e-6 m from -10 km to 100 km.
    """
    p = np.hypot(x, y)
    b = WGS84_A * (1.0 - WGS84_F)
    beta = np.arctan2(z, (1.0 - WGS84_F) * p)
    second = (WGS84_A**2 - b**2) / b**2
    latitude = beta
    for _ in range(3):
        latitude = np.arctan2(
            z + second * b * np.sin(beta) ** 3, p - _E2 * WGS84_A * np.cos(beta) ** 3
        )
        beta = np.arctan2((1.0 - WGS84_F) * np.sin(latitude), np.cos(latitude))
    sin_p, cos_p = np.sin(latitude), np.cos(latitude)
    w = np.sqrt(1.0 - _E2 * sin_p * sin_p)
    height = p * cos_p + z * sin_p - WGS84_A * w
    return latitude, np.arctan2(y, x), height


@dataclass(frozen=True, eq=False)
class GeoidGrid:
    """Undulations on a grid of geographic coordinates.

    Parameters
    ----------
    name : of the geoid and its grid.
    values_m : (rows, columns) ellipsoidal minus orthometric height [m], from the south-west corner
        to the north and east; NaN where unknown.
    south_deg, west_deg : the place of the first value.
    step_lat_deg, step_lon_deg : between rows and between columns.
    """

    name: str
    values_m: NDArray[np.float32]
    south_deg: float
    west_deg: float
    step_lat_deg: float
    step_lon_deg: float

    def _cell(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> tuple[Array, Array, Array]:
        """The values about places (2, 2, ...), and the fractions of the way north and east."""
        rows, columns = self.values_m.shape
        y = (np.degrees(np.asarray(lat_rad, np.float64)) - self.south_deg) / self.step_lat_deg
        # A place on the western edge may be a little less than 360 degrees east of it.
        x = (np.degrees(np.asarray(lon_rad, np.float64)) - self.west_deg + 1e-9) % 360.0 - 1e-9
        y, x = np.broadcast_arrays(y, x / self.step_lon_deg)
        goes_round = abs(columns * self.step_lon_deg - 360.0) < 1e-6
        last = columns if goes_round else columns - 1
        known = (y > -1e-6) & (y < rows - 1 + 1e-6) & (x < last + 1e-6)
        row = np.clip(np.where(known, y, 0.0).astype(np.int64), 0, rows - 2)
        column = np.clip(np.where(known, x, 0.0).astype(np.int64), 0, last - 1)
        across = column, (column + 1) % columns
        cells = [[self.values_m[north, east] for east in across] for north in (row, row + 1)]
        corners = np.array(cells, np.float64)
        return np.where(known, corners, np.nan), y - row, x - column

    def undulation(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> Array:
        """Undulation [m] at places [rad] that broadcast; NaN outside the grid and in its holes.

        Bilinear, as PROJ's vgridshift; continuous over the date line and at the poles.
        """
        corners, north, east = self._cell(lat_rad, lon_rad)
        south_side = corners[0, 0] * (1.0 - east) + corners[0, 1] * east
        north_side = corners[1, 0] * (1.0 - east) + corners[1, 1] * east
        return np.asarray(south_side * (1.0 - north) + north_side * north)

    def deflection(self, lat_rad: ArrayLike, lon_rad: ArrayLike) -> tuple[Array, Array]:
        """Deflection of the vertical to the north (xi) and to the east (eta), [rad] all.

        The zenith of the plumb line lies north and east of the ellipsoid's: minus the slopes of
        the geoid (Heiskanen & Moritz 1967, Eq. 2-204). Of the cell of the grid: EGM96 at 15
        minutes smooths over some 28 km, in mountains by several arcseconds. None at the poles.
        """
        corners, north, east = self._cell(lat_rad, lon_rad)
        lat = np.asarray(lat_rad, np.float64)
        south_side, north_side = corners[0, 1] - corners[0, 0], corners[1, 1] - corners[1, 0]
        eastwards = south_side * (1.0 - north) + north_side * north
        northwards = (corners[1, 0] - corners[0, 0]) * (1.0 - east) + (
            corners[1, 1] - corners[0, 1]
        ) * east
        meridian, prime_vertical = principal_radii(lat)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = prime_vertical * np.cos(lat) * np.radians(self.step_lon_deg)
            along = meridian * np.radians(self.step_lat_deg)
            return np.asarray(-northwards / along), np.asarray(-eastwards / across)
