"""The standard deviations of a correction: by the air, by the station, by the ground.

They are of three kinds and are kept apart. The error of the air is common to the block: it is not
noise of an observation, and the adjustment gets it as one parameter. That of the station is common
to an image, that of the ground to a point.

That parameter s is the leading mode of the air's covariance. With L L^T the covariance of the air's
state x, and E the matrix of what its columns do to rays that represent the block (towards the nadir
and across, through the window), the first right singular vector u of E is the direction L u in
which one parameter explains most of their variance,

    x(s) = x + (s / sigma) L u,   variance_share = |E u|^2 / |E|^2.

That does not depend on the units of x, nor on air that no ray of the block passes. The unit of s is
the refraction: sigma^2 = |E u|^2 / |R|^2 over the rays, and a positive s turns them by more of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.profile import Profile
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures
from unbend.refraction.kernels.columns import (
    CABIN_SIGMAS,
    HEIGHT_SHARE,
    NODE_SHARE,
    REFRACTIVITY,
    RELATIVE_GRADIENT,
    SIGMA_HEIGHT,
    STATION_COLUMNS,
    TABLE_NODE,
    TILT_VARIANCE,
    WINDOW_GRADIENT,
    WINDOW_KIND,
    WINDOW_NORMAL,
    YAW_AXIS_EAST,
    YAW_AXIS_NORTH,
    YAW_EXCESS_VARIANCE,
)
from unbend.refraction.ray import DEFAULT_RADIUS_M
from unbend.refraction.uncertainty import sigmas
from unbend.refraction.uncertainty.air_tables import air_sigma_tables
from unbend.refraction.uncertainty.sensitivity import sensitivity
from unbend.refraction.uncertainty.sigmas import AirMode, Uncertainty
from unbend.units import Array, Integers, Mask, Rows

_MOST_EXPOSURES = 24  # with rays that represent a block
_RAYS_PER_SIDE = 5  # rows, and columns, of rays in an image
_LARGEST_ZETA = np.radians(88.0)
_ZETA_MARGIN = np.radians(0.5)  # beyond the borders of images

_SLOPE_STEP_M = 0.5  # below and above, for the slopes of the air

# Points along the borders of an image, in units of its width and height: nine on each side.
_ALONG_SIDE = np.linspace(0.0, 1.0, 9)
_OPPOSITE_SIDES = np.repeat([0.0, 1.0], _ALONG_SIDE.size)
_BORDER_X = np.concatenate([_ALONG_SIDE, _ALONG_SIDE, _OPPOSITE_SIDES])
_BORDER_Y = np.concatenate([_OPPOSITE_SIDES, _ALONG_SIDE, _ALONG_SIDE])


@dataclass(frozen=True, eq=False)
class WindowRays:
    """Rays (n,) that leave cameras, and how the window turns them."""

    h_c: Array  # height of the camera [m]
    zeta_c: Array  # nadir angle at the camera [rad]
    kind: Integers  # of the window: `OPEN`, `SEALED`, `SCHEDULED` or `FOLLOWING`
    towards: Array  # turn of the ray towards the nadir per unit of dN_c - dN_cc (`window_turn`)
    across: Array  # its turn square to that, per unit of dN_c - dN_cc


def window_turn(direction: Array, down: Array, normal: Array) -> tuple[Array, Array]:
    """How far rays turn towards the nadir, and across, per unit of dN_c - dN_cc at a plane window.

    All arguments are unit vectors (n, 3) in one frame: of the rays, of the nadir, ``down``, and of
    the window's normal. n times the sine of the angle to the normal is the same on both sides
    (Gyer 1996, Eq. 36), so a ray d turns by normal / (normal . d) - d.

    >>> ray, down = np.array([[0.6, 0.0, 0.8]]), np.array([[0.0, 0.0, 1.0]])
    >>> [float(side[0].round(12)) for side in window_turn(ray, down, down)]  # tan(zeta)
    [0.75, 0.0]
    """
    cosine = _scalar_products(down, direction)
    square_sine = np.maximum(1.0 - cosine * cosine, 0.0)
    sine = np.sqrt(square_sine)
    divisor = np.where(sine > 0.0, sine, 1.0)
    to_nadir = (down - cosine[:, None] * direction) / divisor[:, None]
    sideways = np.cross(direction, to_nadir)
    cosine_to_normal = _scalar_products(normal, direction)
    towards = _scalar_products(normal, to_nadir) / cosine_to_normal
    across = _scalar_products(normal, sideways) / cosine_to_normal
    return towards, across


def _scalar_products(first: Array, second: Array) -> Array:
    """(n,) scalar products of (n, 3) vectors."""
    return np.asarray(np.einsum("ij,ij->i", first, second))


def rays_of_exposures(
    exposures: Exposures,
    cameras: Sequence[tuple[Camera, Mask]],
    kinds: Integers,
) -> WindowRays:
    """Rays evenly spread over the images of at most 24 exposures, up to 88 degrees from the nadir.

    ``cameras`` are cameras, each with the mask (s,) of its exposures; ``kinds`` (s,) are the kinds
    of windows of the exposures. The directions are those before the window, which turns them by
    less than 1e-3.
    """
    sampled = _sampled_exposures(exposures)
    rows = [np.empty(0, np.int64)]
    directions = [np.empty((0, 3))]
    for camera, is_of_camera in cameras:
        directions_of_image = _directions_of_image(camera)
        exposures_of_camera = sampled[is_of_camera[sampled]]
        rows.append(np.repeat(exposures_of_camera, len(directions_of_image)))
        directions.append(np.tile(directions_of_image, (exposures_of_camera.size, 1)))
    row = np.concatenate(rows)
    direction = np.concatenate(directions)
    down = -exposures.rotation[row, :, 2]
    cosine = _scalar_products(down, direction)
    zeta = np.arccos(np.clip(cosine, -1.0, 1.0))
    is_below_horizon = zeta < _LARGEST_ZETA
    row = row[is_below_horizon]
    towards, across = window_turn(
        direction[is_below_horizon], down[is_below_horizon], exposures.normals[row]
    )
    return WindowRays(
        h_c=exposures.height_m[row],
        zeta_c=zeta[is_below_horizon],
        kind=kinds[row],
        towards=towards,
        across=across,
    )


def _sampled_exposures(exposures: Exposures) -> Rows:
    """Numbers of at most 24 exposures, evenly among the usable ones."""
    usable = np.flatnonzero(exposures.usable)
    count = min(usable.size, _MOST_EXPOSURES)
    evenly = np.linspace(0, usable.size - 1, count)
    return np.asarray(usable[evenly.astype(int)])


def _directions_of_image(camera: Camera) -> Array:
    """(k, 3) unit vectors in the camera frame, evenly over the image where it is calibrated."""
    side = (np.arange(_RAYS_PER_SIDE) + 0.5) / _RAYS_PER_SIDE
    grid_x, grid_y = np.meshgrid(side, side)
    x = grid_x.ravel() * camera.width_px
    y = grid_y.ravel() * camera.height_px
    u, v, covered = camera.rays(x, y)
    vectors = np.stack([u, v, np.ones(u.size)], axis=1)
    vectors = vectors[covered]
    length = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors / length[:, None])


def leading_mode(
    profile: Profile,
    covariance: ProfileCovariance,
    rays: WindowRays,
    h_g: Array | float,
    *,
    radius: float = DEFAULT_RADIUS_M,
) -> AirMode | None:
    """The direction in the state of the air that explains most of the variance of rays by the air.

    ``rays`` (n,) represent a block, ``h_g`` () or (n,) are heights of their targets [m above sea
    level], ``radius`` is that of the sphere [m].

    The error of a ray is that of R, and behind a plane window that of R - R_cc, in the ray's
    vertical plane and across it. None if no ray has an angle, or if the covariance moves no ray.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> air = standard_atmosphere("us1976")
    >>> variance = np.zeros(2 * air.layers.edge.size + 1)
    >>> variance[air.layers.edge.size] = 0.001**2  # of ln p
    >>> covariance = ProfileCovariance(air, 0.0, np.diag(variance))
    >>> zeta = np.array([0.2, 0.6, 1.0])
    >>> rays = WindowRays(3000.0 + 0.0 * zeta, zeta, np.zeros(3, np.int64), 0.0 * zeta, 0.0 * zeta)
    >>> mode = leading_mode(air, covariance, rays, 0.0)
    >>> mode.sigma, round(mode.variance_share, 6)
    (0.000999998, 1.0)
    >>> mode.state[air.layers.edge.size].round(6).item()  # more pressure, more refraction
    0.001
    """
    traced = sensitivity(
        profile,
        rays.h_c,
        h_g,
        rays.zeta_c,
        radius,
        anchor_height_m=covariance.anchor_height_m,
    )
    is_refracted = traced.valid & (np.abs(traced.r_c) > 0.0)
    if not bool(is_refracted.any()):
        return None
    root = sigmas.CovarianceRoot.of(covariance)
    turns = _turns_at_windows(profile, root, rays)
    by_turn = (1.0 - traced.d_zeta_c) * rays.towards
    along = traced.gradient @ root.matrix + by_turn[:, None] * turns
    across = rays.across[:, None] * turns
    along = along[is_refracted]
    across = across[is_refracted]
    effects = np.concatenate([along, across])
    _, singular, directions = np.linalg.svd(effects, full_matrices=False)
    if not np.any(singular > 0.0):
        return None
    r = traced.r_c[is_refracted]
    # A positive parameter is more refraction; 1 if the mode changes the refraction by exactly 0.
    sense = np.sign(r @ along @ directions[0]) or 1.0
    u = directions[0] * sense
    sigma = singular[0] / np.linalg.norm(r)
    return AirMode(
        state=root.matrix @ u,
        sigma=float(f"{sigma:.6g}"),  # six digits, as in the manifest, which then has it exactly
        variance_share=float(singular[0] ** 2 / np.sum(singular**2)),
    )


def _turns_at_windows(profile: Profile, root: sigmas.CovarianceRoot, rays: WindowRays) -> Array:
    """(n, r) changes of N_c - N_cc at rays by the columns of ``root``; 0 without a window."""
    turns = np.zeros((rays.kind.size, root.matrix.shape[1]))
    for kind in np.unique(rays.kind):
        if kind != sigmas.OPEN:
            rows = rays.kind == kind
            h_c = rays.h_c[rows]
            turns[rows] = sigmas.window_errors(profile, root, h_c, int(kind))
    return turns


@dataclass(frozen=True, eq=False)
class StationSigmas:
    """Standard deviations of s exposures; (s,) arrays, NaN where unknown.

    A turn about the vertical does not change the refraction: yaw matters as far as its axis is not
    vertical.
    """

    tilt_rad: Array  # of the attitude about each of two axes square to the yaw axis
    yaw_rad: Array  # of the attitude about the yaw axis
    yaw_axis: Array  # (s, 3) unit vectors in the camera frame: the vertical axis of the aircraft
    height_m: Array  # of the projection centre; NaN counts as 0
    # (s, 4) change of N in the cabin by one sigma of its pressure and of its temperature, and then
    # of the principal distance [px] by the same; None: unknown.
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

    covariance : of the profile's layers, None where it is not known: then ``air_*`` are NaN.
    exposures, stations : of s exposures.
    cameras : each with the mask (s,) of its exposures.
    ground_heights_m : lowest and highest ground, above sea level [m].
    window_kinds : (s,) `OPEN`, `SEALED`, `SCHEDULED` or `FOLLOWING`; by default all are `OPEN`.
    typical_ground_m : height of the targets of the rays that give the leading mode [m]; by default
        the middle between the lowest and the highest ground below the cameras.

    Returns None if no exposure is usable and inside the profile. The sigmas are of first order.
    Against changed inputs and random atmospheres (tests/refraction/test_uncertainty.py): station
    and ground 1 %, air as `air_sigma_tables`. There are no sigmas for targets above the camera or
    beyond the lowest point of the ray, nor within 1.7 degrees of level at the ground.

    >>> from unbend.atmosphere import standard_atmosphere
    >>> from unbend.refraction import Camera, correct_observations, ray_table
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
    kinds = np.full(usable.shape, sigmas.OPEN)
    if window_kinds is not None:
        kinds[usable] = window_kinds[usable]
    if typical_ground_m is None:
        low = max(ground_heights_m[0], profile.bottom_m)
        high = min(ground_heights_m[1], heights.min())
        typical_ground_m = 0.5 * (low + high)
    mode = None
    if covariance is not None:
        usable_exposures = replace(exposures, usable=usable)
        rays = rays_of_exposures(usable_exposures, cameras, kinds)
        mode = leading_mode(profile, covariance, rays, typical_ground_m, radius=radius)
    camera_m, tables = air_sigma_tables(
        profile,
        covariance,
        (float(heights.min()), float(heights.max())),
        ground_heights_m,
        largest_zeta_rad=_largest_zeta(exposures, usable, cameras),
        radius=radius,
        window_kinds=_kinds_that_turn(kinds),
        mode=mode,
    )
    columns = _station_columns(profile, exposures, stations, kinds, camera_m)
    return Uncertainty(tables, columns, mode)


def _kinds_that_turn(kinds: Integers) -> list[int]:
    """The kinds of windows among ``kinds`` that turn rays, sorted: all except `OPEN`.

    A kind's number in this list is its row in the tables.
    """
    kinds_of_windows: list[int] = np.unique(kinds[kinds != sigmas.OPEN]).tolist()
    return kinds_of_windows


def _largest_zeta(
    exposures: Exposures,
    usable: Mask,
    cameras: Sequence[tuple[Camera, Mask]],
) -> float:
    """The largest nadir angle [rad] on the borders of the usable images, plus half a degree.

    A camera with borders beyond its calibrated radius counts as one that sees the horizon.
    """
    largest = 0.0
    for camera, is_of_camera in cameras:
        down = -exposures.rotation[usable & is_of_camera, :, 2]
        if down.size == 0:
            continue
        x = _BORDER_X * camera.width_px
        y = _BORDER_Y * camera.height_px
        u, v, covered = camera.rays(x, y)
        length = np.sqrt(u * u + v * v + 1.0)
        directions = np.stack([u, v, np.ones(u.size)]) / length
        least_cosine = 0.0  # of the horizon
        if bool(covered.all()):
            cosines = down @ directions
            least_cosine = float(cosines.min(initial=1.0))
        zeta = float(np.arccos(least_cosine) + _ZETA_MARGIN)
        largest = max(largest, zeta)
    return largest


def _station_columns(
    profile: Profile,
    exposures: Exposures,
    stations: StationSigmas,
    kinds: Integers,
    node_m: Array,
) -> Array:
    """(s, 19) matrix of stations with the columns `REFRACTIVITY` to `LENS_SIGMAS`.

    ``kinds`` (s,) are those of windows, ``node_m`` (c,) the heights of cameras in the tables [m].
    """
    n = exposures.refractivity_outside
    is_known = exposures.usable & np.isfinite(n)
    h = np.where(is_known, exposures.height_m, node_m[0])
    slope_of_n, slope_of_log_p = _slopes_of_air(profile, h)
    nodes_up_to = np.searchsorted(node_m, h, side="right")
    node = np.clip(nodes_up_to - 1, 0, node_m.size - 2)
    above_node = h - node_m[node]
    to_next_node = node_m[node + 1] - node_m[node]
    yaw_axis = np.einsum("sji,sj->si", exposures.rotation, stations.yaw_axis)  # east, north, up
    table = np.full((h.size, STATION_COLUMNS), np.nan)
    table[:, REFRACTIVITY] = n
    table[:, RELATIVE_GRADIENT] = slope_of_n / (1.0 + n)
    table[:, TABLE_NODE] = node
    table[:, NODE_SHARE] = above_node / to_next_node
    table[:, HEIGHT_SHARE] = (h - node_m[0]) / (node_m[-1] - node_m[0])
    table[:, TILT_VARIANCE] = stations.tilt_rad**2
    table[:, YAW_EXCESS_VARIANCE] = stations.yaw_rad**2 - stations.tilt_rad**2
    table[:, YAW_AXIS_EAST] = yaw_axis[:, 0]
    table[:, YAW_AXIS_NORTH] = yaw_axis[:, 1]
    table[:, SIGMA_HEIGHT] = np.nan_to_num(stations.height_m)
    table[:, WINDOW_KIND] = -1.0
    table[:, WINDOW_GRADIENT] = 0.0
    table[:, WINDOW_NORMAL:CABIN_SIGMAS] = exposures.normals
    if stations.cabin is not None:
        table[:, CABIN_SIGMAS:] = stations.cabin
    for number, kind in enumerate(_kinds_that_turn(kinds)):
        rows = kinds == kind
        slope_in_cabin = slope_of_log_p[rows] * sigmas.cabin_response(profile, h[rows], kind)
        table[rows, WINDOW_KIND] = number
        table[rows, WINDOW_GRADIENT] = table[rows, RELATIVE_GRADIENT] - slope_in_cabin
        if kind == sigmas.FOLLOWING:  # N_c - N_cc is the same at any height
            table[rows, WINDOW_GRADIENT] = 0.0
    return table


def _slopes_of_air(profile: Profile, h: Array) -> tuple[Array, Array]:
    """(s,) derivatives of N and of ln p with height [1/m] at heights ``h`` (s,) [m].

    Differences over half a metre below and above, within the profile.
    """
    low = np.maximum(h - _SLOPE_STEP_M, profile.bottom_m)
    high = np.minimum(h + _SLOPE_STEP_M, profile.top_m)
    thickness = high - low
    rise_of_n = profile.refractivity(high) - profile.refractivity(low)
    pressure_ratio = profile.pressure(high) / profile.pressure(low)
    return rise_of_n / thickness, np.log(pressure_ratio) / thickness
