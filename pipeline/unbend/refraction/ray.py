"""The ray through a spherically stratified atmosphere, and its refraction angle at the camera.

Gyer 1996, Eq. 1-16, without his cancellations. A ray obeys n r sin(zeta) = k. The angle it
subtends at the centre of the earth is compared with that of the straight line that leaves the
camera in the same apparent direction; the difference is integrated directly
(`bend_by_difference` of `kernels.ray`). Near grazing, where that form has a singularity at the end
of its interval, the subtended angle itself is integrated with h = h_90 + s^2, which is smooth
through the lowest point P_90 (`bend_by_subtended`).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import Profile
from unbend.refraction import messages
from unbend.refraction.kernels.columns import FOR_NEXT_KERNEL, WORTH_A_TABLE, RayColumns
from unbend.refraction.kernels.threads import in_blocks
from unbend.refraction.published import PUBLISHED
from unbend.refraction.published.column import Method, finite
from unbend.refraction.ray_table import RayTable, ray_table
from unbend.refraction.status_codes import (
    BAD_MEASUREMENT,
    BEYOND_GRAZING,
    FAR_BRANCH,
    MISSES_GROUND,
    OK,
    OUTSIDE_PROFILE,
)
from unbend.units import Array

DEFAULT_RADIUS_M = 6_371_000.0


@dataclass(frozen=True, eq=False)
class PublishedRays:
    """A profile and the published method that bends rays in it; `bend` takes it as a table."""

    profile: Profile
    method: Method

    def bend(
        self, h_c: ArrayLike, h_g: ArrayLike, sin_z: ArrayLike, cos_z: ArrayLike, radius: ArrayLike
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Refraction angles R_c [rad] by the method, each with a status; arguments as for `bend`.

        R_c is NaN unless the status is ``ok``: ``bad_measurement`` where a height, the angle or the
        radius is not a valid number, ``outside_profile`` where the method does not cover the
        heights (such as a ground above the camera), ``misses_ground`` where it has no ray in that
        direction.
        """
        h_c, h_g, sin_z, cos_z, radius = finite(h_c, h_g, sin_z, cos_z, radius)
        zeta_c = np.arctan2(sin_z, cos_z)
        good = np.isfinite(h_c) & np.isfinite(h_g) & (radius > 0.0)
        good &= (zeta_c >= 0.0) & (zeta_c <= math.pi)
        r_c = np.full(good.shape, np.nan)
        r_c[good] = self.method(
            self.profile,
            h_c[good],
            h_g[good],
            zeta_c[good],
            radius[good],
        )
        status = np.where(good, OK, BAD_MEASUREMENT).astype(np.uint8)
        without_ray = np.isnan(r_c) & good
        # Straight down every ray reaches the ground, unless the heights are not covered.
        at_nadir = self.method(
            self.profile, h_c[without_ray], h_g[without_ray], 0.0, radius[without_ray]
        )
        is_covered = ~np.isnan(at_nadir)
        status[without_ray] = np.where(is_covered, MISSES_GROUND, OUTSIDE_PROFILE)
        return r_c, status


def rays_by(profile: Profile, method: str) -> RayTable | PublishedRays:
    """The air of a profile as `bend` takes it, for one of `METHODS`.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = rays_by(standard_atmosphere("us1976"), "plane")
    >>> r_c, status = bend(air, 6000.0, [0.0, 7000.0], 0.6, 0.8)
    >>> (r_c * 1e6).round(2).tolist(), status.tolist()
    ([44.25, nan], [0, 7])
    """
    if method == "spherical":
        return ray_table(profile)
    if method not in PUBLISHED:
        raise messages.method_name(method=method, known=", ".join(METHODS))
    return PublishedRays(profile, PUBLISHED[method])


def bend(
    table: RayTable | PublishedRays,
    h_c: ArrayLike,
    h_g: ArrayLike,
    sin_zeta_c: ArrayLike,
    cos_zeta_c: ArrayLike,
    *,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    distance: ArrayLike = math.nan,
) -> tuple[Array, NDArray[np.uint8]]:
    """Refraction angles R_c of rays [rad], each with a status of `status_codes`.

    table : the profile, from `ray_table` or `rays_by`.
    h_c, h_g : heights of camera and target above sea level [m]; broadcast with the others.
    sin_zeta_c, cos_zeta_c : of the apparent nadir angle at the camera, 0 to 180 degrees: no
        arccosine loses digits near the nadir. That they belong to one angle is not checked.
    radius : of the sphere [m].
    distance : slant range to the target [m], NaN where unknown. Where a ray meets h_g twice, on
        both sides of its lowest point P_90, it decides which crossing is meant; without it the
        near one is taken and the status is ``beyond_grazing``. Published methods do not use it.

    R_c is positive when the apparent ray is farther from the nadir than the straight one, and NaN
    where there is none, for the reason that the status gives. Against 40-digit arithmetic 1e-9
    arcsec, also near grazing; 1e-8 in ducts, 1e-7 through P_90. Fastest where rays from one height
    follow each other.
    """
    if isinstance(table, PublishedRays):
        return table.bend(h_c, h_g, sin_zeta_c, cos_zeta_c, radius)
    shape, flat = as_columns(h_c, h_g, sin_zeta_c, cos_zeta_c, radius, distance)
    r_c = np.empty(flat[0].shape)
    status = np.empty(flat[0].shape, np.uint8)

    def bend_block(rows: slice) -> None:
        rays = RayColumns(*(column[rows] for column in flat))
        _bend_rows(table, rays, r_c[rows], status[rows])

    in_blocks(bend_block, flat[0].size)
    return r_c.reshape(shape), status.reshape(shape)


def _bend_rows(table: RayTable, rays: RayColumns, r_c: Array, status: NDArray[np.uint8]) -> None:
    """Fill ``r_c`` [rad] and ``status`` of rays by three kernels, the fastest first.

    A kernel gives rays that it cannot bend the status `LEFT`, for the next one. A kernel is
    imported, and compiled, when the first ray needs it.
    """
    remaining = np.arange(r_c.size)
    if remaining.size > WORTH_A_TABLE:  # enough rays to share a table of moments
        from unbend.refraction.kernels.moments import bend_steep_rays

        bend_steep_rays(table.fine, rays, r_c, status)
        remaining = np.flatnonzero(status == FOR_NEXT_KERNEL)
    if remaining.size:
        from unbend.refraction.kernels.ray import bend_rays

        bend_rays(table.pieces, rays, remaining, r_c, status)
        remaining = remaining[status[remaining] == FOR_NEXT_KERNEL]
    if remaining.size:
        from unbend.refraction.kernels.grazing import bend_grazing_rays

        bend_grazing_rays(table.pieces, rays, remaining, r_c, status)


def as_columns(*values: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    """The shape that ``values`` broadcast to, and each of them as a flat column of that size.

    Compiled functions take writable columns only: read-only and broadcast arrays are copied.
    """
    arrays = [np.asarray(value, np.float64) for value in values]
    shape = np.broadcast_shapes(*(array.shape for array in arrays))
    columns = []
    for array in arrays:
        is_usable = array.flags.c_contiguous and array.flags.writeable
        if array.shape == shape and is_usable:
            columns.append(array.reshape(-1))
        else:
            copied = np.array(np.broadcast_to(array, shape))
            columns.append(copied.reshape(-1))
    return shape, columns


METHODS: tuple[str, ...] = ("spherical", *PUBLISHED)


def refraction_angle(
    profile: Profile | str,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    *,
    method: str = "spherical",
    distance: ArrayLike = math.nan,
) -> Any:
    """Refraction angle R_c at the camera [rad].

    profile : the air, from `standard_atmosphere` or a mission, or the name of a standard
        atmosphere.
    h_c, h_g : heights of camera and target above sea level [m]; ``h_g`` may lie above ``h_c``.
    zeta_c : apparent nadir angle [rad], 0 to pi. Numbers outside are refused (RAY-BAD-MEASUREMENT):
        they may be degrees.
    radius, distance : as for `bend`.
    method : one of `METHODS`; all but ``spherical`` are those of `unbend.refraction.published`.

    Arguments broadcast. Scalars give a float and raise `PhysicsError` where there is no angle;
    arrays give NaN there (`bend` gives the reason for each).

    Source: Gyer 1996, Eq. 1, 11, 12 and 15 in a form free of cancellation.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.units import ARCSEC, DEGREE
    >>> air = standard_atmosphere("us1976", index="gyer")
    >>> round(refraction_angle(air, 10000.0, 0.0, 45.0 * DEGREE) / ARCSEC, 6)
    16.378452
    """
    check_nadir_angles(zeta_c)
    if isinstance(profile, str):
        profile = standard_atmosphere(profile)
    r_c, _ = angle_and_status(
        profile,
        h_c,
        h_g,
        zeta_c,
        radius,
        method=method,
        distance=distance,
    )
    return r_c if r_c.ndim else float(r_c)


LARGEST_ANGLE_RAD = math.pi * (1.0 + 1e-6)  # pi, also as a float32


def check_nadir_angles(zeta_c: ArrayLike) -> None:
    """Refuse (PhysicsError RAY-BAD-MEASUREMENT) nadir angles [rad] outside 0 to pi.

    NaN and infinite angles pass: they give a status.
    """
    angles = np.atleast_1d(np.asarray(zeta_c, np.float64))
    is_outside = np.isfinite(angles) & ((angles < 0.0) | (angles > LARGEST_ANGLE_RAD))
    count = int(is_outside.sum())
    if not count:
        return
    first = np.argwhere(is_outside)[0].tolist()
    where = "zeta_c"
    if np.ndim(zeta_c):
        where = f"zeta_c[{', '.join(map(str, first))}]"
    raise messages.nadir_angles_outside(
        where=where,
        count=count,
        total=angles.size,
        first=float(angles[tuple(first)]),
    )


def angle_and_status(
    profile: Profile,
    h_c: ArrayLike,
    h_g: ArrayLike,
    zeta_c: ArrayLike,
    radius: ArrayLike = DEFAULT_RADIUS_M,
    *,
    method: str = "spherical",
    distance: ArrayLike = math.nan,
) -> tuple[Array, NDArray[np.uint8]]:
    """Refraction angles R_c [rad] and their statuses; arguments as for `refraction_angle`.

    Scalars without an angle raise `PhysicsError`; in arrays R_c is NaN, and the status gives the
    reason.
    """
    zeta = np.asarray(zeta_c, dtype=np.float64)
    is_angle = (zeta >= 0.0) & (zeta <= LARGEST_ANGLE_RAD)
    zeta = np.where(is_angle, np.minimum(zeta, math.pi), np.nan)
    r_c, statuses = bend(
        rays_by(profile, method),
        h_c,
        h_g,
        np.sin(zeta),
        np.cos(zeta),
        radius=radius,
        distance=distance,
    )
    if statuses.ndim > 0:
        return r_c, statuses
    status = int(statuses)
    if status in (OK, BEYOND_GRAZING, FAR_BRANCH):
        return r_c, statuses
    where = f"h_c = {h_c!r} m, h_g = {h_g!r} m, zeta_c = {np.degrees(zeta_c):.6f} deg, "
    where += f"radius = {radius!r} m"
    if status == OUTSIDE_PROFILE:
        raise messages.ray_outside_profile(
            where=where, bottom_m=profile.bottom_m, top_m=profile.top_m, method=method
        )
    if status == MISSES_GROUND:
        raise messages.ray_misses_ground(where=where)
    raise messages.ray_bad_measurement(where=where)
