"""The standard deviations of a correction: by the air, by the station, by the ground.

They are of three kinds and are kept apart. The error of the air is common to the block: it is no
noise of an observation, and the adjustment gets it as one parameter (`leading_mode`). That of the
station is common to an image, that of the ground to a point.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.profile import Profile
from pipeline.refraction.camera.camera import Camera
from pipeline.refraction.image import Exposures
from pipeline.refraction.kernels.columns import (
    AXIS_E,
    AXIS_N,
    BEND,
    CABIN,
    NODE,
    NORMAL,
    SHARE,
    SIGMA_H,
    SPAN,
    STATION_COLUMNS,
    TILT2,
    WINDOW,
    WINDOW_BEND,
    YAW2,
    N,
)
from pipeline.refraction.ray import DEFAULT_RADIUS_M
from pipeline.refraction.uncertainty.air_sigma import OPEN, AirSigma, air_sigma, cabin_response
from pipeline.refraction.uncertainty.leading_mode import leading_mode, rays_of_exposures
from pipeline.refraction.uncertainty.sigmas import Uncertainty
from pipeline.units import Array, Integers, Mask

_SLOPE_STEP_M = 0.5
_BORDER = 9  # points along each side of an image


@dataclass(frozen=True, eq=False)
class StationSigmas:
    """How well each exposure is known; (s,) arrays, NaN where unknown.

    Parameters
    ----------
    tilt_rad : of the attitude about each of two axes square to the yaw axis.
    yaw_rad : about the yaw axis.
    yaw_axis : (s, 3) unit vectors in the camera frame: the aircraft's own vertical.
    height_m : of the projection centre. Where it is unknown it does not count.

    cabin : (s, 4) what one sigma of pressure and one of temperature in the cabin change in the
        refractivity there (first two), and in the principal distance [px]; by default unknown.

    A turn about the vertical changes nothing: yaw matters as far as its axis is not vertical.
    """

    tilt_rad: Array
    yaw_rad: Array
    yaw_axis: Array
    height_m: Array
    cabin: Array | None = None


def uncertainty_of(
    profile: Profile,
    covariance: ProfileCovariance | None,
    exposures: Exposures,
    stations: StationSigmas,
    cameras: Sequence[tuple[Camera, Mask]],
    *,
    ground_heights_m: tuple[float, float],
    window_kinds: Integers | None = None,
    typical_ground_m: float | None = None,
) -> Uncertainty | None:
    """Tables for the standard deviations of a block's corrections.

    Parameters
    ----------
    profile : the air; its layers are those of ``covariance``.
    covariance : of the profile, None where it is not known: then ``air_*`` are unknown.
    exposures, stations : of s exposures.
    cameras : each with the mask (s,) of its exposures.
    ground_heights_m : lowest and highest ground, above sea level [m].
    window_kinds : (s,) `OPEN`, `SEALED` or `SCHEDULED`; by default no window is in the way.
    typical_ground_m : height of the ground of the rays that the leading mode is that of; by default
        the middle of the heights of the ground that are below the cameras.

    None where no exposure can be used. The sigmas are of first order. Against changed inputs and
    drawn airs (tests/refraction/test_uncertainty.py): station and ground 1 %, air as `air_sigma`.
    There are none for targets above the camera or beyond the lowest point of the ray, nor within
    1.7 degrees of level at the ground.

    >>> from pipeline.atmosphere import standard_atmosphere
    >>> from pipeline.refraction import Camera, correct_observations, ray_table
    >>> air, one, none = standard_atmosphere("us1976"), np.ones(1), np.zeros(1)
    >>> down = Exposures(
    ...     one > 0.0, np.diag([1.0, -1.0, -1.0])[None], none, 3000.0 * one, 2e-4 * one, 2e-4 * one)
    >>> camera = Camera(10_000, 10_000, 10_000.0, 10_000.0, 5000.0, 5000.0)
    >>> half_a_degree = StationSigmas(0.0087 * one, 0.0087 * one, np.array([[0.0, 0.0, 1.0]]), none)
    >>> uncertainty = uncertainty_of(
    ...     air, None, down, half_a_degree, [(camera, one > 0.0)], ground_heights_m=(0.0, 0.0))
    >>> corrections = correct_observations(
    ...     9000.0 * one, 5000.0 * one, none, np.zeros(1, np.int64), down, camera=camera,
    ...     table=ray_table(air), uncertainty=uncertainty)
    >>> round(float(corrections.dx_px[0]), 3)
    -0.16
    >>> round(float(corrections.sigmas.station_dx_px[0]), 4)
    0.004
    """
    usable = exposures.usable & np.isfinite(exposures.refractivity_outside)
    if not bool(usable.any()):
        return None
    heights = exposures.height_m[usable]
    radius = exposures.radius_m or DEFAULT_RADIUS_M
    kinds = np.full(usable.shape, OPEN) if window_kinds is None else window_kinds
    kinds = np.where(usable, kinds, OPEN)
    low, high = max(ground_heights_m[0], profile.bottom_m), min(ground_heights_m[1], heights.min())
    ground_m = 0.5 * (low + high) if typical_ground_m is None else typical_ground_m
    mode = None
    if covariance is not None:
        seen = rays_of_exposures(replace(exposures, usable=usable), cameras, kinds)
        mode = leading_mode(profile, covariance, seen, ground_m, radius=radius)
    # The largest nadir angle that a border of an image shows, half a degree to spare.
    zeta, side, ends = [0.0], np.linspace(0.0, 1.0, _BORDER), np.repeat([0.0, 1.0], _BORDER)
    x, y = np.concatenate([side, side, ends]), np.concatenate([ends, side, side])
    for camera, exposed in cameras:
        down = -exposures.rotation[usable & exposed, :, 2]
        u, v, covered = camera.rays(x * camera.width_px, y * camera.height_px)
        rays = np.stack([u, v, np.ones(u.size)]) / np.sqrt(u * u + v * v + 1.0)
        least = float((down @ rays).min(initial=1.0)) if bool(covered.all()) else 0.0
        zeta.append(float(np.arccos(least) + np.radians(0.5)) if down.size else 0.0)
    air = air_sigma(
        profile,
        covariance,
        (float(heights.min()), float(heights.max())),
        ground_heights_m,
        largest_zeta_rad=max(zeta),
        radius=radius,
        window_kinds=sorted({int(kind) for kind in kinds} - {OPEN}),
        mode=mode,
    )
    return Uncertainty(air, _station_columns(profile, exposures, stations, kinds, air), mode)


def _station_columns(
    profile: Profile, exposures: Exposures, stations: StationSigmas, kinds: Integers, air: AirSigma
) -> Array:
    """(s, 19) columns `N` to `CABIN` of `kernels.columns`; ``kinds`` (s,) are those of windows."""
    camera_m, n = air.camera_m, exposures.refractivity_outside
    h = np.where(exposures.usable & np.isfinite(n), exposures.height_m, camera_m[0])
    columns = np.full((h.size, STATION_COLUMNS), np.nan)
    # Slopes over half a metre below and above, within the profile.
    low = np.maximum(h - _SLOPE_STEP_M, profile.bottom_m)
    high = np.minimum(h + _SLOPE_STEP_M, profile.top_m)
    slope = (profile.refractivity(high) - profile.refractivity(low)) / (high - low)
    thinner = np.log(profile.pressure(high) / profile.pressure(low)) / (high - low)
    node = np.clip(np.searchsorted(camera_m, h, side="right") - 1, 0, camera_m.size - 2)
    axis = np.einsum("sji,sj->si", exposures.rotation, stations.yaw_axis)
    columns[:, N] = n
    columns[:, BEND] = slope / (1.0 + n)
    columns[:, NODE] = node
    columns[:, SHARE] = (h - camera_m[node]) / (camera_m[node + 1] - camera_m[node])
    columns[:, SPAN] = (h - camera_m[0]) / (camera_m[-1] - camera_m[0])
    columns[:, TILT2] = stations.tilt_rad**2
    columns[:, YAW2] = stations.yaw_rad**2 - stations.tilt_rad**2
    columns[:, AXIS_E], columns[:, AXIS_N] = axis[:, 0], axis[:, 1]
    columns[:, SIGMA_H] = np.nan_to_num(stations.height_m)
    columns[:, WINDOW], columns[:, WINDOW_BEND] = -1.0, 0.0
    columns[:, NORMAL:CABIN] = exposures.normals
    if stations.cabin is not None:
        columns[:, CABIN:] = stations.cabin
    for number, kind in enumerate(air.window_kinds):
        rows = kinds == kind
        response = cabin_response(profile, h[rows], kind)
        columns[rows, WINDOW] = number
        columns[rows, WINDOW_BEND] = columns[rows, BEND] - thinner[rows] * response
    return columns
