"""What standard deviations need to know of an exposure, as single numbers, compiled."""

from typing import NamedTuple

from unbend.refraction.kernels.columns import (
    CABIN_SIGMAS,
    HEIGHT_SHARE,
    LENS_SIGMAS,
    NODE_SHARE,
    REFRACTIVITY,
    RELATIVE_GRADIENT,
    SIGMA_HEIGHT,
    TABLE_NODE,
    TILT_VARIANCE,
    WINDOW_GRADIENT,
    WINDOW_KIND,
    WINDOW_NORMAL,
    YAW_AXIS_EAST,
    YAW_AXIS_NORTH,
    YAW_EXCESS_VARIANCE,
)
from unbend.refraction.kernels.jit import jit
from unbend.refraction.kernels.sigma_tables import TablePlace, linear

Vector = tuple[float, float, float]


class Station(NamedTuple):
    """One exposure: its columns of the matrix of stations, its rotation, its window."""

    refractivity: float  # N outside
    relative_gradient: float  # (dN/dh) / n outside [1/m]
    camera_place: TablePlace  # among the heights of cameras in the tables
    height_share: float  # of the way from the lowest camera to the highest
    tilt_variance: float  # [rad2]
    yaw_excess_variance: float  # variance of yaw less that of tilt [rad2]
    yaw_axis_east: float  # of the unit vector of the yaw axis: its part to the east,
    yaw_axis_north: float  # and to the north
    sigma_height: float  # [m]
    window_kind: int  # number of the kind of window in the tables, -1 without a plane window
    window_gradient: float  # relative_gradient less dN/dh of a cabin that follows the outside [1/m]
    window_normal: Vector  # in the camera frame
    cabin_by_pressure: float  # change of N in the cabin by one sigma of its pressure,
    cabin_by_temperature: float  # and of its temperature
    lens_by_pressure: float  # change of the principal distance [px] by the same
    lens_by_temperature: float
    rotation: tuple[Vector, Vector, Vector]  # rows, from east-north-up to the camera frame
    sigma_air_y: float  # sigma of y of `uncertainty.sigmas`, 0 without a plane window
    mode_air_y: float  # dy/ds, s the parameter of the leading mode, 0 without a plane window


@jit
def _vector(array):  # type: ignore[no-untyped-def]
    """The three numbers of an array (3,) as a tuple."""
    return (array[0], array[1], array[2])


@jit
def station_at(columns, rotation, air):  # type: ignore[no-untyped-def]
    """The `Station` of one row ``columns`` of the matrix of stations and its rotation (3, 3).

    ``air`` are the `AirTables`. The numbers are taken out of their arrays so that loops over
    observations read them once.
    """
    camera_place = TablePlace(int(columns[TABLE_NODE]), columns[NODE_SHARE])
    window_kind = int(columns[WINDOW_KIND])
    sigma_air_y = 0.0
    mode_air_y = 0.0
    if window_kind >= 0:
        sigma_air_y = linear(air.lean[window_kind], camera_place)
        mode_air_y = linear(air.mode_lean[window_kind], camera_place) / air.mode_sigma
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
        sigma_air_y=sigma_air_y,
        mode_air_y=mode_air_y,
    )
