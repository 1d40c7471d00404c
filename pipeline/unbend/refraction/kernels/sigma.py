"""Standard deviations of corrections, row by row, compiled.

Each source of error turns the ray, towards the nadir in its vertical plane (``along``) or square to
that (``across``), and so moves its pixel. A small turn dt of the ray's unit vector in the camera
frame moves the ideal image coordinates (u, v) by

    du = (dt_x - u dt_z) sqrt(u^2 + v^2 + 1),   dv = (dt_y - v dt_z) sqrt(u^2 + v^2 + 1).

A nadir angle that changes by d zeta turns the corrected ray by (1 - dR/dzeta) d zeta.
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import (
    CABIN_SIGMAS,
    CAMERA_HEIGHT,
    DIRECTION,
    HEIGHT_SHARE,
    IDEAL_U,
    IDEAL_V,
    LENS_SIGMAS,
    NADIR_COSINE,
    NADIR_SINE,
    NODE_SHARE,
    REFRACTIVITY,
    RELATIVE_GRADIENT,
    SIGMA_HEIGHT,
    SPHERE_RADIUS,
    TABLE_NODE,
    TILT_VARIANCE,
    WINDOW_GRADIENT,
    WINDOW_KIND,
    WINDOW_NORMAL,
    YAW_AXIS_EAST,
    YAW_AXIS_NORTH,
    YAW_EXCESS_VARIANCE,
)
from unbend.refraction.kernels.distortion import slopes
from unbend.refraction.kernels.jit import entry, jit, within
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
    SHARED_XY,
    SIGMA_BY_TANGENT,
    SIGMA_H_G,
    SIGMA_R_C,
    SIGMA_R_CC,
    SIGMA_X,
    SLOPE_BY_SECANT2,
    SLOPE_UU,
    SLOPE_UV,
    SLOPE_VV,
    STATION_DX,
    STATION_DY,
    X_PX,
    Y_PX,
)
from unbend.refraction.kernels.sigma_tables import TablePlace, fill_positions, interpolate, linear
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
"""Rows of a matrix of rays that are copied to the room."""

_AT_NADIR = 1e-9  # the sine below which R / sin(zeta) is dR/dzeta, and no azimuth is known

Vector = tuple[float, float, float]


class Station(NamedTuple):
    """One exposure: its columns of the matrix of stations, its rotation, its window."""

    refractivity: float  # N outside
    relative_gradient: float  # N'/n there [1/m]
    camera_place: TablePlace  # among the heights of cameras in the tables
    height_share: float  # of the way from the lowest camera to the highest
    tilt_variance: float  # [rad2]
    yaw_excess_variance: float  # variance of yaw less that of tilt [rad2]
    yaw_axis_east: float  # of the unit vector of the yaw axis
    yaw_axis_north: float
    sigma_height: float  # [m]
    window_kind: int  # number of the kind of window in the tables, -1 without a plane window
    window_gradient: float  # N'/n less the cabin's share that follows it [1/m]
    window_normal: Vector  # in the camera frame
    cabin_by_pressure: float  # what one sigma of the cabin's pressure changes in N there,
    cabin_by_temperature: float  # and one of its temperature
    lens_by_pressure: float  # what they change in the principal distance [px]
    lens_by_temperature: float
    rotation: tuple[Vector, Vector, Vector]  # from east-north-up to the camera frame
    sigma_y: float  # sigma of y of `uncertainty.sigmas`, 0 without a plane window
    mode_y: float  # dy/ds, s the parameter of the leading mode, 0 without a plane window


class _BentRay(NamedTuple):
    """A ray and its refraction angle."""

    sin_z: float  # of the apparent nadir angle zeta
    cos_z: float
    radius: float  # of the sphere [m]
    h_c: float  # height of the camera [m]
    drop: float  # height of the camera above the target [m]
    r: float  # R_c [rad]


class _CameraRay(NamedTuple):
    """A ray in the image, and the directions in which it turns, in the camera frame."""

    u: float  # ideal image coordinates
    v: float
    depth: float  # sqrt(u^2 + v^2 + 1)
    along: Vector  # unit vector towards the nadir, square to the ray
    across: Vector  # unit vector square to the vertical plane of the ray


class _Motion(NamedTuple):
    """How far a ray turns by the errors of its exposure."""

    tan_z: float  # tangent of the nadir angle
    dr_dzeta: float
    swing: float  # R / sin(zeta), or dR/dzeta at the nadir
    window_along: float  # turn towards the nadir per unit of dN_c - dN_cc at the window
    window_across: float  # turn across per unit of dN_c - dN_cc
    d_h_c: float  # dR/dh_c [rad/m]
    d_h_g: float  # dR/dh_g [rad/m]
    yaw_along: float  # how a turn about the yaw axis turns the nadir in the ray's vertical plane
    yaw_across: float  # how such a turn turns the nadir across that plane


class _AirOfRay(NamedTuple):
    """Standard deviations by the air; x and y as in `uncertainty.sigmas`."""

    sigma_r: float  # of R_c [rad]
    sigma_x: float
    shared: float  # covariance of x and y over sigma of y
    sigma_y: float


class _PixelTurn(NamedTuple):
    """What turns of the ray do to one coordinate of its pixel [px/rad]."""

    along: float  # a turn towards the nadir
    across: float  # a turn square to the vertical plane


class _PixelSigmas(NamedTuple):
    """Standard deviations of one coordinate of a pixel."""

    air: float  # [px]
    station: float  # [px]
    by_ground: float  # derivative by the height of the target [px/m], with its sign


@jit
def _vector(v):  # type: ignore[no-untyped-def]
    """The numbers of an array (3,)."""
    return (v[0], v[1], v[2])


@jit
def _station(columns, rotation, air):  # type: ignore[no-untyped-def]
    """The `Station` of one row ``columns`` of the matrix of stations and its rotation (3, 3).

    Numbers, and no arrays, so that loops read them once.
    """
    camera_place = TablePlace(int(columns[TABLE_NODE]), columns[NODE_SHARE])
    window_kind = int(columns[WINDOW_KIND])
    sigma_y = 0.0
    mode_y = 0.0
    if window_kind >= 0:
        sigma_y = linear(air.lean[window_kind], camera_place)
        mode_y = linear(air.mode_lean[window_kind], camera_place) / air.mode_sigma
    return Station(
        refractivity=columns[REFRACTIVITY],
        relative_gradient=columns[RELATIVE_GRADIENT],
        camera_place=camera_place,
        height_share=columns[HEIGHT_SHARE],
        tilt_variance=columns[TILT_VARIANCE],
        yaw_excess_variance=columns[YAW_EXCESS_VARIANCE],
        yaw_axis_east=columns[YAW_AXIS_EAST],
        yaw_axis_north=columns[YAW_AXIS_NORTH],
        sigma_height=columns[SIGMA_HEIGHT],
        window_kind=window_kind,
        window_gradient=columns[WINDOW_GRADIENT],
        window_normal=_vector(columns[WINDOW_NORMAL : WINDOW_NORMAL + 3]),
        cabin_by_pressure=columns[CABIN_SIGMAS],
        cabin_by_temperature=columns[CABIN_SIGMAS + 1],
        lens_by_pressure=columns[LENS_SIGMAS],
        lens_by_temperature=columns[LENS_SIGMAS + 1],
        rotation=(_vector(rotation[0]), _vector(rotation[1]), _vector(rotation[2])),
        sigma_y=sigma_y,
        mode_y=mode_y,
    )


@jit
def _by_heights(ray, dr_dzeta, n_g, station):  # type: ignore[no-untyped-def]
    """dR/dh_c and dR/dh_g [rad/m] of a `_BentRay`.

    The equations are those of `unbend.refraction.uncertainty.sensitivity`, with beta the chord's
    and z_g the ray's angle at the target; ``dr_dzeta`` is dR/dzeta_c, ``n_g`` N at the target.

        sin(beta) - sin(z_g) = (r_c sin(zeta) (N_g - N_c) / (1 + N_g)
                                - r_c (sin(zeta) - sin(zeta - R))) / r_g
        dR/dh_g = -sin(beta - z_g) / (chord cos(z_g))
        dR/dh_c = tan(zeta) (dR/dzeta (N_c' / n_c + 1 / r_c) - N_c' / n_c)
                  - sin(R) / (chord cos(zeta))
    """
    sin_z = ray.sin_z
    cos_z = ray.cos_z
    drop = ray.drop
    r = ray.r
    r_c = ray.radius + ray.h_c
    r_g = ray.radius + ray.h_c - drop
    n_c = station.refractivity
    sin_r = r * (1.0 - r * r / 6.0)
    # Of the chord's nadir angle zeta - R at the camera.
    cos_chord = cos_z * (1.0 - 0.5 * r * r) + sin_z * sin_r
    sin_chord = sin_z * (1.0 - 0.5 * r * r) - cos_z * sin_r
    down = math.sqrt(r_c * r_c * cos_chord * cos_chord - drop * (r_c + r_g))  # r_g cos(beta)
    chord = drop * (r_c + r_g) / (r_c * cos_chord + down)
    turned = r_c * sin_r * (cos_z + 0.5 * r * sin_z)
    sine_difference = (r_c * sin_z * (n_g - n_c) / (1.0 + n_g) - turned) / r_g
    sin_g = r_c * sin_chord / r_g - sine_difference
    cos_g = math.sqrt(1.0 - sin_g * sin_g)
    d_h_g = -2.0 * sine_difference / ((down / r_g + cos_g) * chord * cos_g)
    tan_z = sin_z / cos_z
    gradient = station.relative_gradient
    d_h_c = tan_z * (dr_dzeta * (gradient + 1.0 / r_c) - gradient) - sin_r / (chord * cos_z)
    return d_h_c, d_h_g


@jit
def _turns_about(axis, east, north, sin_z, cos_z):  # type: ignore[no-untyped-def]
    """Parts of the `_CameraRay` directions along and across on one axis of the camera.

    ``axis`` is the axis in east, north and up; ``east``, ``north`` the unit vector of the azimuth.
    """
    along = -cos_z * (axis[0] * east + axis[1] * north) - sin_z * axis[2]
    across = axis[1] * east - axis[0] * north
    return along, across


@jit
def _camera_ray(u, v, azimuth, ray, rotation):  # type: ignore[no-untyped-def]
    """The `_CameraRay` of a `_BentRay`; ``azimuth`` is its unit vector (east, north)."""
    east, north = azimuth
    along_0, across_0 = _turns_about(rotation[0], east, north, ray.sin_z, ray.cos_z)
    along_1, across_1 = _turns_about(rotation[1], east, north, ray.sin_z, ray.cos_z)
    along_2, across_2 = _turns_about(rotation[2], east, north, ray.sin_z, ray.cos_z)
    return _CameraRay(
        u=u,
        v=v,
        depth=math.sqrt(u * u + v * v + 1.0),
        along=(along_0, along_1, along_2),
        across=(across_0, across_1, across_2),
    )


@jit
def _pixel_motion(ray, turn, camera, d_image):  # type: ignore[no-untyped-def]
    """What a turn of a `_CameraRay` towards the unit vector ``turn`` does to x and y [px/rad].

    ``d_image`` are the derivatives of the distortion, du_d/du, du_d/dv and dv_d/dv.
    """
    uu, uv, vv = d_image
    du = turn[0] - ray.u * turn[2]
    dv = turn[1] - ray.v * turn[2]
    moved_x = camera.fx * ray.depth * (uu * du + uv * dv)
    moved_y = camera.fy * ray.depth * (uv * du + vv * dv)
    return moved_x, moved_y


@jit
def _pixel_sigmas(turn, motion, air, station):  # type: ignore[no-untyped-def]
    """The `_PixelSigmas` of one coordinate, with ``turn`` its `_PixelTurn`.

    ``motion`` is a `_Motion`, ``air`` an `_AirOfRay`.
    """
    along = turn.along
    across = turn.across
    # Behind a plane window the air moves the pixel by straight * x + leaning * y: what the window
    # adds to its motion by N_c - N_cc is not all along tan(zeta) (1 - dR/dzeta) where it leans.
    by_window = along * motion.window_along + across * motion.window_across
    by_air = abs(along) * air.sigma_r
    if station.window_kind >= 0:
        straight = along * motion.tan_z
        leaning = by_window - along * (motion.tan_z * (1.0 - motion.dr_dzeta))
        variance = straight * straight * air.sigma_x * air.sigma_x
        variance += 2.0 * straight * leaning * air.shared * air.sigma_y
        variance += leaning * leaning * air.sigma_y * air.sigma_y
        by_air = 0.0 if variance < 0.0 else math.sqrt(variance)
    # A tilt turns the nadir: in the ray's vertical plane it changes zeta, across it the azimuth.
    by_zeta = -motion.dr_dzeta * along
    by_azimuth = motion.swing * across
    by_nadir2 = by_zeta * by_zeta + by_azimuth * by_azimuth
    variance_of_turns = station.tilt_variance * by_nadir2
    by_yaw = by_zeta * motion.yaw_along + by_azimuth * motion.yaw_across
    variance_of_turns += station.yaw_excess_variance * (by_yaw * by_yaw)
    by_height = along * motion.d_h_c + by_window * station.window_gradient
    by_height = by_height * station.sigma_height
    by_station = math.sqrt(variance_of_turns + by_height * by_height)
    return _PixelSigmas(by_air, by_station, along * motion.d_h_g)


@jit
def _cabin_sigma(by_refractivity, lever, station):  # type: ignore[no-untyped-def]
    """Sigma of one coordinate [px] by pressure and temperature in the cabin.

    ``by_refractivity`` [px] is what dN_c - dN_cc does to the coordinate at the window, ``lever``
    what a change of the principal distance does.
    """
    by_pressure = by_refractivity * station.cabin_by_pressure + lever * station.lens_by_pressure
    by_temperature = (
        by_refractivity * station.cabin_by_temperature + lever * station.lens_by_temperature
    )
    return math.sqrt(by_pressure * by_pressure + by_temperature * by_temperature)


@within
def _fill_sigmas(room, count, camera, station):  # type: ignore[no-untyped-def]
    """Fill the results of ``count`` observations of one `Station`.

    A loop without a branch over the rows of ``room`` runs four observations at a time.
    """
    has_window = station.window_kind >= 0
    one_if_window = 1.0 if has_window else math.nan
    n_0, n_1, n_2 = station.window_normal
    axis_east = station.yaw_axis_east
    axis_north = station.yaw_axis_north
    n_p = station.cabin_by_pressure
    n_t = station.cabin_by_temperature
    sigma_cabin = math.sqrt(n_p * n_p + n_t * n_t)
    for i in range(count):
        ray = _BentRay(
            sin_z=room[NADIR_SINE, i],
            cos_z=room[NADIR_COSINE, i],
            radius=room[SPHERE_RADIUS, i],
            h_c=room[CAMERA_HEIGHT, i],
            drop=room[DROP, i],
            r=room[R_C, i],
        )
        secant = 1.0 / ray.cos_z
        tan_z = ray.sin_z * secant
        slope = room[SLOPE_BY_SECANT2, i]
        one_if_known = math.nan if math.isnan(slope) else room[ONE_IF_KNOWN, i]
        dr_dzeta = slope * secant * secant
        sigma_r = room[SIGMA_BY_TANGENT, i] * ray.sin_z * secant
        d_h_c, d_h_g = _by_heights(ray, dr_dzeta, room[N_GROUND, i], station)

        # At the nadir any azimuth will do.
        inverse = 1.0 / ray.sin_z
        has_azimuth = ray.sin_z > _AT_NADIR
        east = room[DIRECTION, i] * inverse if has_azimuth else 1.0
        north = room[DIRECTION + 1, i] * inverse if has_azimuth else 0.0
        swing = ray.r * inverse if has_azimuth else dr_dzeta
        in_camera = _camera_ray(
            room[IDEAL_U, i], room[IDEAL_V, i], (east, north), ray, station.rotation
        )
        d_image = (room[SLOPE_UU, i], room[SLOPE_UV, i], room[SLOPE_VV, i])
        along_x, along_y = _pixel_motion(in_camera, in_camera.along, camera, d_image)
        across_x, across_y = _pixel_motion(in_camera, in_camera.across, camera, d_image)

        # At the window with the normal m a ray d turns by m / (m . d) - d per unit of dN_c - dN_cc.
        t_0, t_1, t_2 = in_camera.along
        q_0, q_1, q_2 = in_camera.across
        cos_out = (n_0 * in_camera.u + n_1 * in_camera.v + n_2) / in_camera.depth
        window_along = (n_0 * t_0 + n_1 * t_1 + n_2 * t_2) / cos_out * (1.0 - dr_dzeta)
        window_across = (n_0 * q_0 + n_1 * q_1 + n_2 * q_2) / cos_out
        tan_out = math.sqrt(max(0.0, 1.0 - cos_out * cos_out)) / cos_out
        motion = _Motion(
            tan_z=tan_z,
            dr_dzeta=dr_dzeta,
            swing=swing,
            window_along=window_along if has_window else 0.0,
            window_across=window_across if has_window else 0.0,
            d_h_c=d_h_c,
            d_h_g=d_h_g,
            yaw_along=axis_north * east - axis_east * north,
            yaw_across=-axis_north * north - axis_east * east,
        )
        air = _AirOfRay(sigma_r, room[SIGMA_X, i], room[SHARED_XY, i], station.sigma_y)
        x = _pixel_sigmas(_PixelTurn(along_x, across_x), motion, air, station)
        y = _pixel_sigmas(_PixelTurn(along_y, across_y), motion, air, station)

        # N in the cabin turns the ray at the window (Gyer 1996, Eq. 36); its air is in the lens.
        by_mode = room[MODE_BY_TANGENT, i] * tan_z
        window_x = along_x * motion.window_along + across_x * motion.window_across
        window_y = along_y * motion.window_along + across_y * motion.window_across
        x_lever = (room[X_PX, i] - camera.cx) / camera.fx
        y_lever = (room[Y_PX, i] - camera.cy) / camera.fy
        sigma_r_cc = (tan_out if has_window else 0.0) * sigma_cabin
        room[SIGMA_R_C, i] = sigma_r * one_if_known
        room[AIR_DX, i] = x.air * one_if_known
        room[AIR_DY, i] = y.air * one_if_known
        room[STATION_DX, i] = x.station * one_if_known
        room[STATION_DY, i] = y.station * one_if_known
        room[GROUND_DX, i] = abs(x.by_ground) * room[SIGMA_H_G, i] * one_if_known
        room[GROUND_DY, i] = abs(y.by_ground) * room[SIGMA_H_G, i] * one_if_known
        room[SIGMA_R_CC, i] = sigma_r_cc * one_if_known
        room[CABIN_DX, i] = _cabin_sigma(window_x, x_lever, station) * one_if_known
        room[CABIN_DY, i] = _cabin_sigma(window_y, y_lever, station) * one_if_known
        room[DX_DS, i] = (along_x * by_mode + window_x * station.mode_y) * one_if_known
        room[DY_DS, i] = (along_y * by_mode + window_y * station.mode_y) * one_if_known
        room[DX_DNCC, i] = -window_x * one_if_window * one_if_known
        room[DY_DNCC, i] = -window_y * one_if_window * one_if_known


@within
def _copy_to_room(room, rows, observed, camera, traced):  # type: ignore[no-untyped-def]
    """Fill rays, observations and derivatives of the distortion of ``rows`` (first, count)."""
    first, count = rows
    rays = traced.rays
    r_c = traced.r_c
    for k in _COPIED_ROWS:
        for i in range(count):
            room[k, i] = rays[k, first + i]
    for i in range(count):
        j = first + i
        room[X_PX, i] = observed.x[j]
        room[Y_PX, i] = observed.y[j]
        room[R_C, i] = r_c[j]
        room[H_G, i] = observed.h_g[j]
        room[SIGMA_H_G, i] = observed.sigma_h_g[j]
        is_far = traced.status[j] == FAR_BRANCH
        room[ONE_IF_KNOWN, i] = math.nan if math.isnan(r_c[j]) or is_far else 1.0
        uu, uv, vv = slopes(rays[IDEAL_U, j], rays[IDEAL_V, j], camera.distortion)
        room[SLOPE_UU, i] = uu
        room[SLOPE_UV, i] = uv
        room[SLOPE_VV, i] = vv


@entry
def fill_sigma_columns(observed, pose, traced, air, sigmas):  # type: ignore[no-untyped-def]
    """Fill the columns of `Sigmas` of `ObservationColumns` and their `TracedColumns`.

    ``pose`` are the `CameraConstants` and the rotations (s, 3, 3) of exposures, ``air`` the matrix
    of stations (s, `STATION_COLUMNS`) and the `AirTables`. NaN where nothing is known. Rows of one
    exposure that follow each other are taken together.
    """
    exposure = observed.exposure
    camera, rotation = pose
    stations, tables = air
    sigma_r = sigmas[0]  # in double precision, the others in single
    others = sigmas[1:]
    room = np.empty((ALL_ROWS, COLUMNS_TOGETHER))
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
                    room[FIRST_RESULT + k, i] = math.nan
        else:
            _copy_to_room(room, (first, count), observed, camera, traced)
            station = _station(stations[e], rotation[e], tables)
            fill_positions(room, count, tables)
            interpolate(room, count, tables, station)
            _fill_sigmas(room, count, camera, station)
        for i in range(count):
            sigma_r[first + i] = room[FIRST_RESULT, i]
        for k in range(RESULTS - 1):
            column = others[k]
            for i in range(count):
                column[first + i] = room[FIRST_RESULT + 1 + k, i]
