"""Image observations: from measured pixels to the pixels of the straight chord.

The exact vector form; Gyer's Eq. 40-51 are its scalar twin (with the plus sign in Eq. 50, 51 that
the paper prints as a minus).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.geodesy import euler_radius
from pipeline.refraction.camera import Camera
from pipeline.refraction.ray import PublishedRays, RayTable, bend
from pipeline.refraction.status import (
    BAD_MEASUREMENT,
    NO_GROUND,
    NO_STATION,
    OK,
    OUTSIDE_CAMERA,
    OUTSIDE_PROFILE,
    STATUS_NAMES,
)
from pipeline.refraction.window import OPTICAL_AXIS, leave_compartment

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Exposures:
    """What the correction needs to know of each exposure; (s,) arrays.

    ``usable`` is False where an exposure has no position, attitude or cabin air;
    ``rotation`` (s, 3, 3) takes east-north-up to camera; ``refractivity_outside`` and
    ``refractivity_cabin`` are n - 1 on the two sides of the window (equal without one);
    ``radius_m`` replaces the ellipsoid's radius in the ray's azimuth when it is given.
    """

    usable: NDArray[np.bool_]
    rotation: Array
    latitude_rad: Array
    height_m: Array
    refractivity_outside: Array
    refractivity_cabin: Array
    radius_m: float | None = None


@dataclass(frozen=True, eq=False)
class Corrections:
    """Corrected observations; (n,) arrays, NaN where ``status`` says there is no correction.

    ``shift_ground_m`` is the horizontal displacement, at the target's height, of the point where
    the uncorrected straight ray would land.
    """

    dx_px: Array
    dy_px: Array
    x_px: Array
    y_px: Array
    zeta_c_rad: Array
    r_c_rad: Array
    r_cc_rad: Array
    shift_ground_m: Array
    status: NDArray[np.uint8]

    def rows(self, which: NDArray[np.intp]) -> Corrections:
        """Some of the rows."""
        return Corrections(*(getattr(self, field.name)[which] for field in fields(self)))

    def to_pandas(self) -> Any:
        """The corrections as a pandas DataFrame, status in words."""
        import pandas as pd

        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        return pd.DataFrame(columns | {"status": np.array(STATUS_NAMES)[self.status]})


_COLUMNS = tuple(field.name for field in fields(Corrections) if field.name != "status")


def correct_observations(
    x_px: Array,
    y_px: Array,
    h_g: Array,
    exposure: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
    *,
    window_normal: Array = OPTICAL_AXIS,
) -> Corrections:
    """Remove compartment and atmospheric refraction from image observations of one camera.

    Parameters
    ----------
    x_px, y_px : (n,) measured, distorted pixels.
    h_g : (n,) heights of the targets above sea level [m].
    exposure : (n,) rows of ``exposures``, -1 where the image has none.
    camera : interior orientation; corrected pixels are distorted again.
    table : the air outside and how rays bend in it, from `rays_by`.
    window_normal : (3,) unit vector in the camera frame.

    The change of direction is never a difference of directions; the shift (dx, dy) is good to
    1e-10 px, whatever the size of the pixel coordinates.
    """
    measured = np.isfinite(x_px) & np.isfinite(y_px)
    stationed = np.zeros(x_px.shape, dtype=bool)
    if exposures.usable.size:
        stationed = (exposure >= 0) & exposures.usable[np.maximum(exposure, 0)]
    u, v, covered = camera.rays(x_px, y_px)
    status = _first_reason(measured, stationed, np.isfinite(h_g), covered)
    columns = {name: np.full(x_px.shape, np.nan) for name in _COLUMNS}
    good = np.flatnonzero(status == OK)
    if good.size:
        traced, ray_status = _correct_covered(
            u[good], v[good], h_g[good], exposure[good], exposures, camera, table, window_normal
        )
        status[good] = ray_status
        for name, values in traced.items():
            columns[name][good] = values
    columns["x_px"] = x_px + columns["dx_px"]
    columns["y_px"] = y_px + columns["dy_px"]
    return Corrections(status=status, **columns)


def _correct_covered(
    u: Array,
    v: Array,
    h_g: Array,
    row: NDArray[np.int64],
    exposures: Exposures,
    camera: Camera,
    table: RayTable | PublishedRays,
    window_normal: Array,
) -> tuple[dict[str, Array], NDArray[np.uint8]]:
    """The correction where everything it needs is there; columns of `Corrections`, status."""
    scale = 1.0 / np.sqrt(u * u + v * v + 1.0)
    inside = np.stack([u * scale, v * scale, scale], axis=1)
    through_window, r_cc = leave_compartment(
        inside,
        exposures.refractivity_cabin[row],
        exposures.refractivity_outside[row],
        window_normal,
    )
    rotation = exposures.rotation[row]
    apparent = np.einsum("nji,nj->ni", rotation, inside + through_window)
    sin_z, cos_z = np.hypot(apparent[:, 0], apparent[:, 1]), -apparent[:, 2]
    h_c = exposures.height_m[row]
    if exposures.radius_m is None:
        azimuth = np.arctan2(apparent[:, 0], apparent[:, 1])
        radius = euler_radius(exposures.latitude_rad[row], azimuth)
    else:
        radius = np.full(u.shape, exposures.radius_m)
    # Rounding may leave the sine of a level ray 1e-16 above one.
    r_c, status = bend(table, h_c, h_g, np.minimum(sin_z, 1.0), np.clip(cos_z, -1.0, 1.0), radius)
    status[np.isnan(r_cc)] = OUTSIDE_CAMERA  # wholly reflected at the window
    status[np.isnan(exposures.refractivity_outside[row])] = OUTSIDE_PROFILE

    towards_chord = lower_ray(apparent, sin_z, cos_z, r_c)
    change = through_window + np.einsum("nij,nj->ni", rotation, towards_chord)
    depth = scale + change[:, 2]
    x_0, y_0 = camera.project(u, v)
    x_1, y_1 = camera.project(
        u + (change[:, 0] - u * change[:, 2]) / depth,
        v + (change[:, 1] - v * change[:, 2]) / depth,
    )
    uncorrected = landing_point(np.einsum("nji,nj->ni", rotation, inside), h_c, h_g, radius)
    corrected = landing_point(apparent + towards_chord, h_c, h_g, radius)
    return {
        "dx_px": x_1 - x_0,
        "dy_px": y_1 - y_0,
        "zeta_c_rad": np.arctan2(sin_z, cos_z),
        "r_c_rad": r_c,
        "r_cc_rad": r_cc,
        "shift_ground_m": np.sqrt(np.sum((uncorrected - corrected) ** 2, axis=1)),
    }, status


def _first_reason(
    measured: NDArray[np.bool_],
    stationed: NDArray[np.bool_],
    grounded: NDArray[np.bool_],
    covered: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Status before any ray: the first thing that is missing."""
    return np.select(
        [~measured, ~stationed, ~grounded, ~covered],
        [BAD_MEASUREMENT, NO_STATION, NO_GROUND, OUTSIDE_CAMERA],
        default=OK,
    ).astype(np.uint8)


def lower_ray(direction: Array, sin_z: Array, cos_z: Array, angle: Array) -> Array:
    """Change of unit vectors turned towards the nadir in their vertical planes.

    ``direction`` (n, 3) east, north, up; ``sin_z``, ``cos_z`` of its nadir angle; ``angle`` (n,)
    [rad]. Exact; zero for a ray at the nadir.

    >>> level = np.array([[1.0, 0.0, 0.0]])
    >>> change = lower_ray(level, np.array([1.0]), np.array([0.0]), np.array([0.1]))
    >>> (level + change).round(6).tolist()
    [[0.995004, 0.0, -0.099833]]
    """
    back = -2.0 * np.sin(0.5 * angle) ** 2
    sin_a = np.sin(angle)
    with np.errstate(invalid="ignore", divide="ignore"):
        inward = np.where(sin_z > 0.0, sin_a * cos_z / sin_z, 0.0)
    change = direction * back[:, None]
    change[:, 0] -= inward * direction[:, 0]
    change[:, 1] -= inward * direction[:, 1]
    change[:, 2] -= sin_a * sin_z
    return np.asarray(change)


def landing_point(direction: Array, h_c: Array, h_g: Array, radius: Array) -> Array:
    """Where straight rays first reach a height, from the camera: (n, 3) east, north, up [m].

    ``direction`` (n, 3) unit vectors; NaN where the line never gets there.
    """
    r_c, r_g = radius + h_c, radius + h_g
    cos_z = -direction[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.sqrt((r_c * cos_z) ** 2 - (h_c - h_g) * (r_c + r_g))
        # Downwards the nearer of two crossings, upwards the only one.
        distance = np.where(
            h_c >= h_g,
            (h_c - h_g) * (r_c + r_g) / (r_c * cos_z + q),
            r_c * cos_z + q,
        )
        distance = np.where(h_c == h_g, 0.0, distance)
        distance = np.where(distance >= 0.0, distance, np.nan)
    return np.asarray(direction * distance[:, None])


def ground_displacement(h_c: float, h_g: float, zeta_c: float, r_c: float, radius: float) -> float:
    """How far [m] a refraction angle moves the point where a straight ray reaches a height.

    >>> round(ground_displacement(10000.0, 0.0, 0.7853981633974483, 7.94e-5, 6371000.0), 3)
    1.592
    """
    angle = np.array([zeta_c, zeta_c - r_c])
    rays = np.stack([np.sin(angle), np.zeros(2), -np.cos(angle)], axis=1)
    ones = np.ones(2)
    apparent, true = landing_point(rays, h_c * ones, h_g * ones, radius * ones)
    return float(np.linalg.norm(apparent - true))
