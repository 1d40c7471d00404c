"""Derivatives of refraction angles by the heights of camera and target, compiled.

The equations are those of `unbend.refraction.uncertainty.sensitivity`. With beta the angle of the
chord to the vertical of the target, and z_g that of the ray there,

    sin(beta) - sin(z_g) = (r_c sin(zeta) (N_g - N_c) / (1 + N_g)
                            - r_c (sin(zeta) - sin(zeta - R))) / r_g
    dR/dh_g = -sin(beta - z_g) / (chord cos(z_g))
    dR/dh_c = tan(zeta) (dR/dzeta (N_c' / n_c + 1 / r_c) - N_c' / n_c)
              - sin(R) / (chord cos(zeta)),

where r_c and r_g are distances from the earth's centre and R is the refraction angle R_c.
"""

import math
from typing import NamedTuple

from unbend.refraction.kernels.jit import jit


class BentRay(NamedTuple):
    """A ray and its refraction angle."""

    sin_z: float  # of the apparent nadir angle zeta
    cos_z: float
    radius: float  # of the sphere [m]
    h_c: float  # height of the camera [m]
    drop: float  # height of the camera above the target [m]
    angle: float  # R [rad]
    dr_dzeta: float  # dR/dzeta


class _Chord(NamedTuple):
    """The chord from the camera to the target of a ray."""

    r_c: float  # distance of the camera from the earth's centre [m]
    r_g: float  # distance of the target from there [m]
    sin_r: float  # sine of R
    sin_chord: float  # sine of zeta - R, the chord's nadir angle at the camera
    down: float  # r_g cos(beta) [m], beta its angle to the vertical of the target
    length: float  # [m]


@jit
def _chord_of(ray):  # type: ignore[no-untyped-def]
    """The `_Chord` of a `BentRay`, with sine and cosine of R by their series."""
    r = ray.angle
    r_c = ray.radius + ray.h_c
    r_g = ray.radius + ray.h_c - ray.drop
    sin_r = r * (1.0 - r * r / 6.0)
    cos_chord = ray.cos_z * (1.0 - 0.5 * r * r) + ray.sin_z * sin_r
    sin_chord = ray.sin_z * (1.0 - 0.5 * r * r) - ray.cos_z * sin_r
    square_difference = ray.drop * (r_c + r_g)  # r_c^2 - r_g^2
    down = math.sqrt(r_c * r_c * cos_chord * cos_chord - square_difference)
    length = square_difference / (r_c * cos_chord + down)
    return _Chord(r_c=r_c, r_g=r_g, sin_r=sin_r, sin_chord=sin_chord, down=down, length=length)


@jit
def _by_target_height(ray, chord, big_n_c, big_n_g):  # type: ignore[no-untyped-def]
    """dR/dh_g [rad/m] of a `BentRay` and its `_Chord`, by the equations of the module.

    ``big_n_c`` and ``big_n_g`` are N at the camera and at the target.
    """
    # r_c (sin(zeta) - sin(zeta - R)), without a difference of near numbers.
    sine_change = chord.r_c * chord.sin_r * (ray.cos_z + 0.5 * ray.angle * ray.sin_z)
    sine_difference = (
        chord.r_c * ray.sin_z * (big_n_g - big_n_c) / (1.0 + big_n_g) - sine_change
    ) / chord.r_g
    sin_g = chord.r_c * chord.sin_chord / chord.r_g - sine_difference  # of z_g
    cos_g = math.sqrt(1.0 - sin_g * sin_g)
    # sin(beta - z_g) is 2 (sin(beta) - sin(z_g)) / (cos(beta) + cos(z_g)): the two are near.
    return -2.0 * sine_difference / ((chord.down / chord.r_g + cos_g) * chord.length * cos_g)


@jit
def height_derivatives(ray, big_n_g, station):  # type: ignore[no-untyped-def]
    """dR/dh_c and dR/dh_g [rad/m] of a `BentRay` from a `Station`; ``big_n_g`` is N at the target.

    The equations are those of the module.
    """
    chord = _chord_of(ray)
    tan_z = ray.sin_z / ray.cos_z
    gradient = station.relative_gradient  # N_c' / n_c
    by_turn = ray.dr_dzeta * (gradient + 1.0 / chord.r_c) - gradient
    d_h_c = tan_z * by_turn - chord.sin_r / (chord.length * ray.cos_z)
    d_h_g = _by_target_height(ray, chord, station.refractivity, big_n_g)
    return d_h_c, d_h_g
