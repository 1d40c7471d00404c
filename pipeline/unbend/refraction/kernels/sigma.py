"""Standard deviations of corrections, row by row, compiled.

Each source of error turns the ray, towards the nadir in its vertical plane (``along``) or square to
that plane (``across``), and so moves its pixel. A small turn dt of the ray's unit vector in the
camera frame moves the ideal image coordinates (u, v) by

    du = (dt_x - u dt_z) sqrt(u^2 + v^2 + 1),   dv = (dt_y - v dt_z) sqrt(u^2 + v^2 + 1).

A nadir angle that changes by d zeta turns the corrected ray by (1 - dR/dzeta) d zeta, R its
refraction angle R_c.

The two quantities x and y of the air that `uncertainty.sigmas` defines are ``air_x`` and ``air_y``
here: the air turns a ray behind a window by tan(zeta) air_x, and by air_y as far as the window's
normal is not vertical. x and y alone are coordinates of pixels.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import (
    CAMERA_HEIGHT,
    DIRECTION,
    IDEAL_U,
    IDEAL_V,
    NADIR_COSINE,
    NADIR_SINE,
    SPHERE_RADIUS,
)
from unbend.refraction.kernels.distortion import slopes
from unbend.refraction.kernels.jit import entry, jit, within
from unbend.refraction.kernels.sigma_heights import BentRay, height_derivatives
from unbend.refraction.kernels.sigma_rows import (
    AIR_DX,
    AIR_DY,
    ALL_ROWS,
    CABIN_DX,
    CABIN_DY,
    COLUMNS_TOGETHER,
    DROP,
    DX_DNCC,
    DX_DS,
    DY_DNCC,
    DY_DS,
    FIRST_RESULT,
    GROUND_DX,
    GROUND_DY,
    H_G,
    MODE_BY_TANGENT,
    N_GROUND,
    ONE_IF_KNOWN,
    R_C,
    RESULTS,
    SHARED_AIR_XY,
    SIGMA_AIR_X,
    SIGMA_BY_TANGENT,
    SIGMA_H_G,
    SIGMA_R_C,
    SIGMA_R_CC,
    SLOPE_BY_SECANT2,
    SLOPE_UU,
    SLOPE_UV,
    SLOPE_VV,
    STATION_DX,
    STATION_DY,
    X_PX,
    Y_PX,
)
from unbend.refraction.kernels.sigma_station import Vector, station_at
from unbend.refraction.kernels.sigma_tables import fill_positions, interpolate_air
from unbend.refraction.kernels.window import dot
from unbend.refraction.status_codes import FAR_BRANCH

_COPIED_ROWS = (
    IDEAL_U,
    IDEAL_V,
    DIRECTION,
    DIRECTION + 1,
    NADIR_SINE,
    NADIR_COSINE,
    SPHERE_RADIUS,
    CAMERA_HEIGHT,
)
"""Rows of a matrix of rays that are copied to the work matrix."""

# Up to this sine of its nadir angle a ray has no azimuth, and R / sin(zeta) is dR/dzeta.
_LARGEST_SINE_AT_NADIR = 1e-9


class _CameraRay(NamedTuple):
    """A ray in the image, and the directions in which it turns, in the camera frame."""

    u: float  # ideal image coordinates
    v: float
    depth: float  # sqrt(u^2 + v^2 + 1)
    along: Vector  # unit vector towards the nadir, square to the ray
    across: Vector  # unit vector square to the vertical plane of the ray


class _WindowTurns(NamedTuple):
    """How the window turns a ray; zero without a plane window."""

    along: float  # turn of the corrected ray towards the nadir, per unit of dN_c - dN_cc
    across: float  # turn across, per unit of dN_c - dN_cc
    tangent: float  # of the angle between the ray and the window's normal: dR_cc/dN_cc


class _Motion(NamedTuple):
    """How far a ray turns by the errors of its exposure."""

    tan_z: float  # tangent of the nadir angle zeta
    dr_dzeta: float  # dR/dzeta
    # How far the corrected ray turns across where the nadir turns across by 1: R / sin(zeta), or
    # dR/dzeta at the nadir.
    swing: float
    window: _WindowTurns
    d_h_c: float  # dR/dh_c [rad/m]
    d_h_g: float  # dR/dh_g [rad/m]
    yaw_along: float  # how a turn about the yaw axis turns the nadir in the ray's vertical plane
    yaw_across: float  # how such a turn turns the nadir across that plane


class _AirOfRay(NamedTuple):
    """Standard deviations by the air; see the module for ``air_x`` and ``air_y``."""

    sigma_r: float  # of R_c [rad]
    sigma_air_x: float
    shared_air_xy: float  # covariance of air_x and air_y over sigma of air_y
    sigma_air_y: float


class _PixelTurn(NamedTuple):
    """What turns of the ray do to one coordinate of its pixel [px/rad]."""

    along: float  # a turn towards the nadir
    across: float  # a turn square to the vertical plane


class _PixelSigmas(NamedTuple):
    """What errors do to one coordinate of a pixel: two sigmas and two derivatives."""

    air: float  # sigma by the air [px]
    station: float  # sigma by the place and attitude of the exposure [px]
    by_ground: float  # derivative by the height of the target [px/m]
    by_window: float  # derivative by N_c - N_cc at the window [px], 0 without a plane window


@jit
def _azimuth(east, north, sin_z):  # type: ignore[no-untyped-def]
    """Unit vector (east, north) in the azimuth of a ray.

    ``east`` and ``north`` are components of its unit vector, ``sin_z`` is the sine of its nadir
    angle. A ray at the nadir gets the azimuth of east: any azimuth is right there.
    """
    if not sin_z > _LARGEST_SINE_AT_NADIR:
        return 1.0, 0.0
    inverse = 1.0 / sin_z
    return east * inverse, north * inverse


@jit
def _turns_on_axis(axis, azimuth, ray):  # type: ignore[no-untyped-def]
    """Components of the directions along and across of a `BentRay` on one axis of the camera.

    ``axis`` is the unit vector of that axis in east, north and up. In this frame the direction
    along is (-cos(zeta) east, -cos(zeta) north, -sin(zeta)), with (east, north) the ``azimuth``,
    and the direction across is (-north, east, 0).
    """
    east, north = azimuth
    along = -ray.cos_z * (axis[0] * east + axis[1] * north) - ray.sin_z * axis[2]
    across = axis[1] * east - axis[0] * north
    return along, across


@jit
def _camera_ray(u, v, azimuth, ray, rotation):  # type: ignore[no-untyped-def]
    """The `_CameraRay` of a `BentRay` with the ideal image coordinates u, v.

    ``azimuth`` is its unit vector (east, north), ``rotation`` the rows from east-north-up to the
    camera frame.
    """
    along_0, across_0 = _turns_on_axis(rotation[0], azimuth, ray)
    along_1, across_1 = _turns_on_axis(rotation[1], azimuth, ray)
    along_2, across_2 = _turns_on_axis(rotation[2], azimuth, ray)
    return _CameraRay(
        u=u,
        v=v,
        depth=math.sqrt(u * u + v * v + 1.0),
        along=(along_0, along_1, along_2),
        across=(across_0, across_1, across_2),
    )


@jit
def _moved_pixel(ray, direction, camera, d_image):  # type: ignore[no-untyped-def]
    """How far x and y of a pixel move per turn of its `_CameraRay` towards ``direction`` [px/rad].

    ``direction`` is a unit vector in the camera frame, square to the ray. ``d_image`` are the
    derivatives of the distortion, du_d/du, du_d/dv and dv_d/dv. The equations are the module's.
    """
    uu, uv, vv = d_image
    du = direction[0] - ray.u * direction[2]
    dv = direction[1] - ray.v * direction[2]
    moved_x = camera.fx * ray.depth * (uu * du + uv * dv)
    moved_y = camera.fy * ray.depth * (uv * du + vv * dv)
    return moved_x, moved_y


@jit
def _pixel_turns(ray, camera, d_image):  # type: ignore[no-untyped-def]
    """The `_PixelTurn` of x and that of y for a `_CameraRay`; ``d_image`` as in `_moved_pixel`."""
    along_x, along_y = _moved_pixel(ray, ray.along, camera, d_image)
    across_x, across_y = _moved_pixel(ray, ray.across, camera, d_image)
    return _PixelTurn(along_x, across_x), _PixelTurn(along_y, across_y)


@jit
def _window_turns(ray, dr_dzeta, station):  # type: ignore[no-untyped-def]
    """The `_WindowTurns` of a `_CameraRay` at the window of a `Station`; ``dr_dzeta`` is dR/dzeta.

    At a window with the normal m the unit vector d of a ray turns by m / (m . d) - d per unit of
    dN_c - dN_cc (Gyer 1996, Eq. 36). The part along changes the nadir angle, and so R too.
    """
    if station.window_kind < 0:
        return _WindowTurns(0.0, 0.0, 0.0)
    normal = station.window_normal
    cos_out = (normal[0] * ray.u + normal[1] * ray.v + normal[2]) / ray.depth  # m . d
    along = dot(normal, ray.along) / cos_out * (1.0 - dr_dzeta)
    across = dot(normal, ray.across) / cos_out
    tangent = math.sqrt(max(0.0, 1.0 - cos_out * cos_out)) / cos_out
    return _WindowTurns(along, across, tangent)


@jit
def _motion(ray, azimuth, window, big_n_g, station):  # type: ignore[no-untyped-def]
    """The `_Motion` of a `BentRay` from a `Station`.

    ``azimuth`` is its unit vector (east, north), ``window`` are its `_WindowTurns`, ``big_n_g`` is
    N at its target.
    """
    d_h_c, d_h_g = height_derivatives(ray, big_n_g, station)
    # A turn about the yaw axis moves the nadir by nadir x axis, which is (axis_north, -axis_east)
    # in east and north. Its parts are those on the azimuth and on the direction across.
    east, north = azimuth
    axis_east = station.yaw_axis_east
    axis_north = station.yaw_axis_north
    is_at_nadir = not ray.sin_z > _LARGEST_SINE_AT_NADIR
    swing = ray.dr_dzeta if is_at_nadir else ray.angle * (1.0 / ray.sin_z)
    return _Motion(
        tan_z=ray.sin_z * (1.0 / ray.cos_z),
        dr_dzeta=ray.dr_dzeta,
        swing=swing,
        window=window,
        d_h_c=d_h_c,
        d_h_g=d_h_g,
        yaw_along=axis_north * east - axis_east * north,
        yaw_across=-axis_north * north - axis_east * east,
    )


@jit
def _air_sigma(turn, by_air_y, motion, air):  # type: ignore[no-untyped-def]
    """Sigma of one coordinate [px] by the air, for a ray through a plane window.

    The air moves the coordinate by ``by_air_x`` * air_x + ``by_air_y`` * air_y, where ``by_air_x``
    [px] is the effect of a turn by tan(zeta) towards the nadir. ``by_air_y`` [px] is what the lean
    of the window adds. ``turn`` is a `_PixelTurn`, ``air`` an `_AirOfRay`.
    """
    by_air_x = turn.along * motion.tan_z
    variance = by_air_x * by_air_x * air.sigma_air_x * air.sigma_air_x
    variance += 2.0 * by_air_x * by_air_y * air.shared_air_xy * air.sigma_air_y
    variance += by_air_y * by_air_y * air.sigma_air_y * air.sigma_air_y
    return 0.0 if variance < 0.0 else math.sqrt(variance)


@jit
def _station_sigma(turn, by_window, motion, station):  # type: ignore[no-untyped-def]
    """Sigma of one coordinate [px] by the attitude and the height of the exposure.

    ``turn`` is its `_PixelTurn`, ``motion`` the `_Motion` of the ray, ``station`` the `Station`.
    ``by_window`` [px] is the coordinate's derivative by N_c - N_cc at the window.
    """
    # A tilt turns the nadir but not the measured ray in the camera, so only R changes: by dR/dzeta,
    # not by the 1 - dR/dzeta of a ray that turns. A turn of the nadir towards the ray lessens zeta,
    # and R by dR/dzeta; a turn of the nadir across turns the ray across by R / sin(zeta).
    by_zeta = -motion.dr_dzeta * turn.along
    by_azimuth = motion.swing * turn.across
    by_nadir2 = by_zeta * by_zeta + by_azimuth * by_azimuth
    variance_of_turns = station.tilt_variance * by_nadir2
    by_yaw = by_zeta * motion.yaw_along + by_azimuth * motion.yaw_across
    variance_of_turns += station.yaw_excess_variance * (by_yaw * by_yaw)
    # The height changes R and, at the window, N_c - N_cc.
    by_height = turn.along * motion.d_h_c + by_window * station.window_gradient
    sigma_by_height = by_height * station.sigma_height
    return math.sqrt(variance_of_turns + sigma_by_height * sigma_by_height)


@jit
def _pixel_sigmas(turn, motion, air, station):  # type: ignore[no-untyped-def]
    """The `_PixelSigmas` of one coordinate of a pixel; ``turn`` is the `_PixelTurn` of that.

    ``motion`` is the `_Motion` of its ray, ``air`` the `_AirOfRay`, ``station`` the `Station`.
    """
    by_window = turn.along * motion.window.along + turn.across * motion.window.across
    by_air = abs(turn.along) * air.sigma_r
    if station.window_kind >= 0:
        # A window with a vertical normal would turn the ray by tan(zeta) (1 - dR/dzeta) along: that
        # is in air_x. The rest of what this window does, because it leans, is by air_y.
        by_level_window = turn.along * (motion.tan_z * (1.0 - motion.dr_dzeta))
        by_air_y = by_window - by_level_window
        by_air = _air_sigma(turn, by_air_y, motion, air)
    return _PixelSigmas(
        air=by_air,
        station=_station_sigma(turn, by_window, motion, station),
        by_ground=turn.along * motion.d_h_g,
        by_window=by_window,
    )


@jit
def _cabin_sigma(by_window, lever, station):  # type: ignore[no-untyped-def]
    """Sigma of one coordinate [px] by pressure and temperature in the cabin.

    N in the cabin, N_cc, turns the ray at the window: ``by_window`` [px] is the derivative by
    N_c - N_cc there. The cabin's air is also between the elements of the lens, and changes the
    principal distance: per pixel of that change the coordinate moves by ``lever``, the distorted
    image coordinate. The derivatives by N_cc and by the principal distance are -``by_window`` and
    -``lever``; the common sign changes no sigma.
    """
    by_pressure = by_window * station.cabin_by_pressure + lever * station.lens_by_pressure
    by_temperature = by_window * station.cabin_by_temperature + lever * station.lens_by_temperature
    return math.sqrt(by_pressure * by_pressure + by_temperature * by_temperature)


@jit
def _sigma_n_cabin(station):  # type: ignore[no-untyped-def]
    """Sigma of N in the cabin of a `Station`, by the errors of its pressure and temperature."""
    by_pressure = station.cabin_by_pressure
    by_temperature = station.cabin_by_temperature
    return math.sqrt(by_pressure * by_pressure + by_temperature * by_temperature)


@within
def _fill_sigmas(work, count, camera, station):  # type: ignore[no-untyped-def]
    """Fill the rows `SIGMA_R_C` to `DY_DNCC` of ``work`` for ``count`` observations of a `Station`.

    A loop without a branch over the rows of ``work`` runs four observations at a time. Without a
    plane window sigma of R_cc is 0, and the derivatives by N_cc are NaN.
    """
    one_if_window = 1.0 if station.window_kind >= 0 else math.nan
    sigma_n_cabin = _sigma_n_cabin(station)
    for i in range(count):
        # The ray, and what the errors do to it.
        secant = 1.0 / work[NADIR_COSINE, i]
        ray = BentRay(
            sin_z=work[NADIR_SINE, i],
            cos_z=work[NADIR_COSINE, i],
            radius=work[SPHERE_RADIUS, i],
            h_c=work[CAMERA_HEIGHT, i],
            drop=work[DROP, i],
            angle=work[R_C, i],
            dr_dzeta=work[SLOPE_BY_SECANT2, i] * secant * secant,
        )
        azimuth = _azimuth(work[DIRECTION, i], work[DIRECTION + 1, i], ray.sin_z)
        camera_ray = _camera_ray(work[IDEAL_U, i], work[IDEAL_V, i], azimuth, ray, station.rotation)
        window = _window_turns(camera_ray, ray.dr_dzeta, station)
        motion = _motion(ray, azimuth, window, work[N_GROUND, i], station)
        air = _AirOfRay(
            sigma_r=work[SIGMA_BY_TANGENT, i] * ray.sin_z * secant,
            sigma_air_x=work[SIGMA_AIR_X, i],
            shared_air_xy=work[SHARED_AIR_XY, i],
            sigma_air_y=station.sigma_air_y,
        )

        # What the errors do to its pixel.
        d_image = (work[SLOPE_UU, i], work[SLOPE_UV, i], work[SLOPE_VV, i])
        turn_x, turn_y = _pixel_turns(camera_ray, camera, d_image)
        in_x = _pixel_sigmas(turn_x, motion, air, station)
        in_y = _pixel_sigmas(turn_y, motion, air, station)
        x_lever = (work[X_PX, i] - camera.cx) / camera.fx
        y_lever = (work[Y_PX, i] - camera.cy) / camera.fy
        # s, the parameter of the leading mode of the air's errors, changes R and, at the window,
        # N_c - N_cc by mode_air_y.
        r_by_mode = work[MODE_BY_TANGENT, i] * motion.tan_z

        # All results are unknown where the ray is not known, or beyond the tables.
        one_if_known = math.nan if math.isnan(ray.dr_dzeta) else work[ONE_IF_KNOWN, i]
        work[SIGMA_R_C, i] = air.sigma_r * one_if_known
        work[AIR_DX, i] = in_x.air * one_if_known
        work[AIR_DY, i] = in_y.air * one_if_known
        work[STATION_DX, i] = in_x.station * one_if_known
        work[STATION_DY, i] = in_y.station * one_if_known
        work[GROUND_DX, i] = abs(in_x.by_ground) * work[SIGMA_H_G, i] * one_if_known
        work[GROUND_DY, i] = abs(in_y.by_ground) * work[SIGMA_H_G, i] * one_if_known
        work[SIGMA_R_CC, i] = window.tangent * sigma_n_cabin * one_if_known
        work[CABIN_DX, i] = _cabin_sigma(in_x.by_window, x_lever, station) * one_if_known
        work[CABIN_DY, i] = _cabin_sigma(in_y.by_window, y_lever, station) * one_if_known
        dx_ds = turn_x.along * r_by_mode + in_x.by_window * station.mode_air_y
        dy_ds = turn_y.along * r_by_mode + in_y.by_window * station.mode_air_y
        work[DX_DS, i] = dx_ds * one_if_known
        work[DY_DS, i] = dy_ds * one_if_known
        work[DX_DNCC, i] = -in_x.by_window * one_if_window * one_if_known
        work[DY_DNCC, i] = -in_y.by_window * one_if_window * one_if_known


@within
def _copy_to_work(work, first, count, observed, camera, traced):  # type: ignore[no-untyped-def]
    """Fill ``work`` with the rays and observations ``first`` to ``first`` + ``count`` - 1.

    Also with the derivatives of the distortion, and with `ONE_IF_KNOWN`: NaN for a ray without an
    angle, and for a ray to the far crossing of its target's height, which has no known sigmas.
    """
    rays = traced.rays
    angle = traced.angle
    for k in _COPIED_ROWS:
        for i in range(count):
            work[k, i] = rays[k, first + i]
    for i in range(count):
        j = first + i
        work[X_PX, i] = observed.x[j]
        work[Y_PX, i] = observed.y[j]
        work[R_C, i] = angle[j]
        work[H_G, i] = observed.h_g[j]
        work[SIGMA_H_G, i] = observed.sigma_h_g[j]
        is_far = traced.status[j] == FAR_BRANCH
        work[ONE_IF_KNOWN, i] = math.nan if math.isnan(angle[j]) or is_far else 1.0
        uu, uv, vv = slopes(rays[IDEAL_U, j], rays[IDEAL_V, j], camera.distortion)
        work[SLOPE_UU, i] = uu
        work[SLOPE_UV, i] = uv
        work[SLOPE_VV, i] = vv


@entry
def fill_sigma_columns(observed, pose, traced, air, sigmas):  # type: ignore[no-untyped-def]
    """Fill ``sigmas``, the columns of `Sigmas`, from observations and their rays; NaN if unknown.

    ``observed`` are `ObservationColumns`, ``traced`` their `TracedColumns`. ``pose`` are two
    values, the `CameraConstants` and the rotations (s, 3, 3) of exposures; ``air`` are two values,
    the matrix of stations (s, `STATION_COLUMNS`) and the `AirTables`.

    Consecutive rows of one exposure, up to `COLUMNS_TOGETHER`, are copied into ``work``, a small
    matrix, computed there, and copied back.
    """
    exposure = observed.exposure
    camera, rotation = pose
    stations, tables = air
    sigma_r_c = sigmas[0]  # in double precision, the others in single
    single_columns = sigmas[1:]
    work = np.empty((ALL_ROWS, COLUMNS_TOGETHER))
    end = 0
    while end < exposure.size:
        first = end
        e = exposure[first]
        while end < exposure.size and end - first < COLUMNS_TOGETHER and exposure[end] == e:
            end += 1
        count = end - first
        if not 0 <= e < stations.shape[0]:
            for k in range(RESULTS):
                for i in range(count):
                    work[FIRST_RESULT + k, i] = math.nan
        else:
            _copy_to_work(work, first, count, observed=observed, camera=camera, traced=traced)
            station = station_at(stations[e], rotation[e], tables)
            fill_positions(work, count, tables)
            interpolate_air(work, count, tables, station)
            _fill_sigmas(work, count, camera, station)
        for i in range(count):
            sigma_r_c[first + i] = work[FIRST_RESULT, i]
        for k in range(RESULTS - 1):
            column = single_columns[k]
            for i in range(count):
                column[first + i] = work[FIRST_RESULT + 1 + k, i]
