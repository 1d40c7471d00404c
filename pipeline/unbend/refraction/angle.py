"""Refraction angles to print: a single one, a table over the nadir angle, methods compared."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import (
    DEFAULT_WAVELENGTH_M,
    INDEX_OF_ONE_LIGHT,
    IndexModel,
)
from unbend.refraction import messages, ray
from unbend.refraction.image import ground_displacement
from unbend.refraction.published.bertram import manual
from unbend.refraction.status_codes import FAR_BRANCH, STATUS_NAMES
from unbend.units import ARCSEC, DEGREE, MICRORADIAN, Array


def one_angle(
    atmosphere: str,
    camera_height: float,
    ground_height: float,
    nadir_angle: float,
    *,
    index: str | IndexModel = "ciddor",
    radius: float = ray.DEFAULT_RADIUS_M,
    method: str = "spherical",
    distance: float | None = None,
) -> dict[str, Any]:
    """One refraction angle through a standard atmosphere, as ``unbend angle`` prints it.

    Heights [m above sea level], nadir angle [degrees], formula of the index (with its light, or by
    its name), radius of the earth [m]. ``distance`` [m] is the slant range: if the ray crosses the
    ground's height twice, it decides which crossing is taken. Published methods have only the near
    one. In the result ``status`` is ``ok``; ``beyond_grazing`` for two crossings without a
    distance, where the near one is taken; or ``far_branch`` where the far one is. ``ground_m``,
    the displacement on the ground, is None where the straight apparent ray passes over the horizon
    and only the bent one lands.

    >>> round(one_angle("us1976", 1e4, 0.0, 75.0, index="gyer")["r_c_arcsec"], 6)
    61.778543
    """
    if distance is not None and not 0.0 < distance < math.inf:
        raise messages.angle_distance(distance=distance)
    if isinstance(index, str):
        index = IndexModel(index)
    if index.name in INDEX_OF_ONE_LIGHT and index.wavelength_m != DEFAULT_WAVELENGTH_M:
        raise messages.angle_wavelength(index=index.name)
    air = standard_atmosphere(atmosphere, index=index.name, wavelength_m=index.wavelength_m)
    zeta = nadir_angle * DEGREE
    r_c, status = ray.angle_and_status(
        air,
        camera_height,
        ground_height,
        zeta,
        radius,
        method=method,
        distance=math.nan if distance is None else distance,
    )
    angle = float(r_c)
    code = int(status)
    displacement = ground_displacement(
        camera_height, ground_height, zeta, angle, radius, far=code == FAR_BRANCH
    )
    ground = float(displacement)
    return {
        "r_c_arcsec": angle / ARCSEC,
        "r_c_urad": angle / MICRORADIAN,
        "r_c_rad": angle,
        "ground_m": None if math.isnan(ground) else ground,
        "status": STATUS_NAMES[code],
        "atmosphere": atmosphere,
        "index": index.name,
        "wavelength_m": air.index.light_m,
        "method": method,
        "camera_height_m": camera_height,
        "ground_height_m": ground_height,
        "nadir_angle_deg": nadir_angle,
        "distance_m": distance,
        "radius_m": radius,
    }


@dataclass(frozen=True, eq=False)
class RadialTable:
    """The refraction of one camera height over one ground; (n,) arrays over the nadir angle.

    ``r_c_rad`` is NaN where there is no angle; ``status`` (codes of `status_codes`) gives the
    reason. ``shift_ground_m``, the horizontal displacement on the ground, is also NaN where the
    straight apparent ray passes over the horizon and only the bent one lands. For an image taken
    vertically ``radius_px`` is the distance from the principal point and ``dr_px`` the correction
    to be added to it; both are NaN without a principal distance. ``wavelength_m`` is that of the
    light in vacuum. ``k_rad`` is R at 45 degrees, the K of the Manual of Photogrammetry, and
    ``k_manual_rad`` the K by the formula of the manual (NaN where that is not defined).
    """

    h_c_m: float
    h_g_m: float
    nadir_angle_rad: Array
    r_c_rad: Array
    shift_ground_m: Array
    radius_px: Array
    dr_px: Array
    status: NDArray[np.uint8]
    k_rad: float
    k_manual_rad: float
    wavelength_m: float


def radial_table(
    profile: Profile,
    h_c: float,
    h_g: float,
    nadir_angle: Array,
    *,
    focal_px: float | None = None,
    radius: float = ray.DEFAULT_RADIUS_M,
    method: str = "spherical",
) -> RadialTable:
    """Refraction angles and image shifts over the nadir angle, for one flying height.

    h_c, h_g : heights of camera and ground above sea level [m], the camera's the greater.
    nadir_angle : (n,) apparent nadir angles [rad], 0 to below 90 degrees.
    focal_px : principal distance [px], for the shift in a vertical image.
    radius, method : as for `refraction_angle`.

    Without a window and without distortion. Accuracy is that of the method; the shift is
    f (tan(zeta - R) - tan zeta), without cancellation.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> table = radial_table(air, 6000.0, 0.0, np.array([0.5]), focal_px=20000.0)
    >>> table.dr_px.round(3).tolist(), round(table.k_rad * 1e6, 2)
    ([-0.836], 58.92)
    """
    zeta = np.asarray(nadir_angle, dtype=np.float64)
    if not bool(np.all((zeta >= 0.0) & (zeta < 90.0 * DEGREE))):
        raise messages.radial_angle(least_deg=zeta.min() / DEGREE, largest_deg=zeta.max() / DEGREE)
    if not h_c > h_g:
        raise messages.radial_heights(h_c=h_c, h_g=h_g)
    if focal_px is not None and not 0.0 < focal_px < math.inf:
        raise messages.radial_focal(focal_px=focal_px)
    k = ray.refraction_angle(profile, h_c, h_g, 45.0 * DEGREE, radius, method=method)
    air = ray.rays_by(profile, method)
    r_c, status = ray.bend(air, h_c, h_g, np.sin(zeta), np.cos(zeta), radius=radius)
    ground = ground_displacement(h_c, h_g, zeta, r_c, radius)
    f = math.nan if focal_px is None else focal_px
    # f (tan(zeta - R) - tan(zeta)), without cancellation; + 0.0 makes 0.0 of -0.0.
    dr_px = f * np.sin(-r_c) / (np.cos(zeta) * np.cos(zeta - r_c)) + 0.0
    return RadialTable(
        h_c_m=h_c,
        h_g_m=h_g,
        nadir_angle_rad=zeta,
        r_c_rad=r_c,
        shift_ground_m=ground,
        radius_px=f * np.tan(zeta),
        dr_px=dr_px,
        status=status,
        k_rad=k,
        k_manual_rad=float(manual(profile, h_c, h_g, 45.0 * DEGREE, radius)),
        wavelength_m=profile.index.light_m,
    )


def angles_to(largest_deg: float, step_deg: float = 5.0) -> Array:
    """Nadir angles [rad]: whole steps from 0 on, and ``largest_deg`` as the last.

    >>> (angles_to(12.0, 5.0) / DEGREE).round(9).tolist()
    [0.0, 5.0, 10.0, 12.0]
    """
    if not (0.0 < largest_deg < 90.0 and step_deg > 0.0):
        raise messages.radial_angle_angles_to(largest_deg=largest_deg, step_deg=step_deg)
    steps = np.arange(0.0, largest_deg - 1e-9 * step_deg, step_deg)
    return np.append(steps, largest_deg) * DEGREE


@dataclass(frozen=True, eq=False)
class Comparison:
    """Refraction angles of several methods in the same air over one ground.

    ``exact_rad`` (h, z) is the spherical form at ``h_c_m`` (h,) and ``nadir_angle_rad`` (z,);
    ``error_rad`` (m, h, z) is method minus exact, NaN where the method is not defined.
    """

    methods: tuple[str, ...]
    h_c_m: Array
    h_g_m: float
    nadir_angle_rad: Array
    exact_rad: Array
    error_rad: Array

    def good_to(self, limit_rad: float) -> Array:
        """(m, h) the last nadir angle [rad] of the table up to which all errors are within a limit.

        NaN where the method is not defined at any angle; -1 where its error is beyond the limit
        already at the first angle.
        """
        within = np.logical_and.accumulate(np.abs(self.error_rad) <= limit_rad, axis=2)
        count = within.sum(axis=2)
        # With a count of 0 the index is -1: the -1.0 at the end.
        angle = np.append(self.nadir_angle_rad, -1.0)[count - 1]
        return np.where(np.isfinite(self.error_rad).any(axis=2), angle, np.nan)


def compare_methods(
    profile: Profile,
    h_c: Array,
    h_g: float,
    nadir_angle: Array,
    *,
    methods: tuple[str, ...] = ray.METHODS[1:],
) -> Comparison:
    """Errors of refraction methods against the method ``spherical`` in the same air.

    profile : the air; its index should be that of the papers' light (``gyer``), 0.589 um: with
        another light the errors of the published methods include the difference.
    h_c, h_g : heights of cameras (h,) and ground above sea level [m].
    nadir_angle : (z,) apparent nadir angles [rad], ascending.

    The reference is good to 1e-9 arcsec.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> angles = np.arange(0.0, 86.0) * DEGREE
    >>> errors = compare_methods(air, np.array([3000.0]), 0.0, angles, methods=("plane", "manual"))
    >>> (errors.good_to(0.1 * ARCSEC) / DEGREE).round().tolist()
    [[74.0], [6.0]]
    """
    angles = np.asarray(nadir_angle, dtype=np.float64)
    heights = np.asarray(h_c, dtype=np.float64)
    rays = (profile, heights[:, None], h_g, angles[None, :])
    exact = ray.refraction_angle(*rays)
    error = np.stack([ray.refraction_angle(*rays, method=method) - exact for method in methods])
    return Comparison(methods, heights, h_g, angles, exact, error)
