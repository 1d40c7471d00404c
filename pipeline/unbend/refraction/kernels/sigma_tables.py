"""What the air does to rays, interpolated in the tables of `AirTables`, compiled."""

import math
from typing import NamedTuple

from unbend.refraction.kernels.columns import (
    ANGLE_FACTOR,
    CAMERA_HEIGHT,
    MODE_SUMMAND,
    NADIR_COSINE,
    SIGMA_FACTOR,
    SPHERE_RADIUS,
)
from unbend.refraction.kernels.jit import jit, within
from unbend.refraction.kernels.sigma_rows import (
    COARSE_POSITION,
    DROP,
    GROUND_POSITION,
    H_G,
    INCIDENCE_POSITION,
    MODE_BY_TANGENT,
    N_GROUND,
    ONE_IF_KNOWN,
    SHARED_AIR_XY,
    SIGMA_AIR_X,
    SIGMA_BY_TANGENT,
    SLOPE_BY_SECANT2,
    WAY_POSITION,
)


class TablePlace(NamedTuple):
    """A place between two nodes of an axis of a table."""

    node: int  # below the place
    share: float  # of the way from this node to the next


class _OnSphere(NamedTuple):
    """How values on the sphere follow from those in the plane."""

    sigma_factor: float  # by which sigma_R of the plane is multiplied
    angle_factor: float  # by which dR/dzeta of the plane is multiplied
    mode: float  # what the mode changes in R / (tan(zeta) way), on the sphere


@jit
def _place_at(position, count):  # type: ignore[no-untyped-def]
    """The `TablePlace` at a position on an axis of ``count`` nodes.

    The position is a number of nodes from the first, with a fraction; beyond the axis it gets the
    place at the axis' end.
    """
    inside = min(max(position, 0.0), count - 1.0)
    node = min(int(inside), count - 2)
    return TablePlace(node, inside - node)


@jit
def linear(table, place):  # type: ignore[no-untyped-def]
    """The value of a table (n,) at a `TablePlace`, linear between two nodes."""
    i = place.node
    return table[i] + place.share * (table[i + 1] - table[i])


@jit
def _bilinear(table, row_place, column_place):  # type: ignore[no-untyped-def]
    """The value of a table (c, w) between the four nodes around two places."""
    i = row_place.node
    j = column_place.node
    share = column_place.share
    low = table[i, j] + share * (table[i, j + 1] - table[i, j])
    high = table[i + 1, j] + share * (table[i + 1, j + 1] - table[i + 1, j])
    return low + row_place.share * (high - low)


@jit
def _on_sphere(factors, height, way, incidence, mode_in_plane):  # type: ignore[no-untyped-def]
    """The `_OnSphere` at three `TablePlace`, linear between the eight nodes around them.

    ``factors`` (f, j, k, 3) are those of `AirTables`; ``height``, ``way`` and ``incidence`` the
    places on its axes. The three bits of a corner's number state on which axes the corner is at the
    next node.
    """
    sigma_factor = 0.0
    angle_factor = 0.0
    mode = mode_in_plane
    for corner in range(8):
        next_height = corner >> 2
        next_way = (corner >> 1) & 1
        next_incidence = corner & 1
        by_height = height.share if next_height else 1.0 - height.share
        by_way = way.share if next_way else 1.0 - way.share
        by_incidence = incidence.share if next_incidence else 1.0 - incidence.share
        weight = by_height * by_way * by_incidence
        i = height.node + next_height
        j = way.node + next_way
        k = incidence.node + next_incidence
        sigma_factor += weight * factors[i, j, k, SIGMA_FACTOR]
        angle_factor += weight * factors[i, j, k, ANGLE_FACTOR]
        mode += weight * factors[i, j, k, MODE_SUMMAND]
    return _OnSphere(sigma_factor, angle_factor, mode)


@within
def fill_positions(work, count, air):  # type: ignore[no-untyped-def]
    """Fill the positions of ``count`` rays on the axes of ``air``, the `AirTables`, into ``work``.

    That is the matrix of `sigma_rows`. Also filled are `DROP` and `ONE_IF_KNOWN`. The tables do not
    serve a ray to a target at or above the camera, nor a ray that is nearly level at the target:
    its `ONE_IF_KNOWN` becomes NaN, and its positions are 0, which any table has.

    The conditions are joined by &, which evaluates all of them, because branches are slower.
    """
    way_first = air.way_first
    way_step = air.way_step
    coarse_step = air.coarse_step
    incidence_step = air.incidence_step
    last_incidence = air.factors.shape[2] - 1.0
    ground_m = air.ground_m
    spacing_m = air.spacing_m
    for i in range(count):
        h_c = work[CAMERA_HEIGHT, i]
        cos_z = work[NADIR_COSINE, i]
        r_c = work[SPHERE_RADIUS, i] + h_c
        drop = h_c - work[H_G, i]
        r_g = work[SPHERE_RADIUS, i] + h_c - drop
        # cos^2 of the straight ray's nadir angle at the target.
        cos2_g = (r_c * r_c * cos_z * cos_z - drop * (r_c + r_g)) / (r_g * r_g)
        beyond_first_way = math.sqrt(drop) - way_first
        # In nodes of the axis of 1 / sqrt(cos z_g), which begins at 1.
        incidence = (1.0 / math.sqrt(math.sqrt(cos2_g)) - 1.0) / incidence_step
        is_served = (work[ONE_IF_KNOWN, i] == 1.0) & (drop > 0.0) & (cos_z > 0.0) & (cos2_g > 0.0)
        is_served &= incidence <= last_incidence
        work[DROP, i] = drop
        work[ONE_IF_KNOWN, i] = 1.0 if is_served else math.nan
        work[WAY_POSITION, i] = beyond_first_way / way_step if is_served else 0.0
        work[COARSE_POSITION, i] = beyond_first_way / coarse_step if is_served else 0.0
        work[INCIDENCE_POSITION, i] = incidence if is_served else 0.0
        work[GROUND_POSITION, i] = (work[H_G, i] - ground_m) / spacing_m if is_served else 0.0


@jit
def interpolate_air(work, count, air, station):  # type: ignore[no-untyped-def]
    """Fill `SIGMA_BY_TANGENT` to `N_GROUND` of ``count`` rays from their positions in the tables.

    ``work`` is the matrix of `sigma_rows`, ``air`` are the `AirTables`, ``station`` is the
    `Station` of the rays' exposure. A ray with a NaN gets NaN. `SIGMA_AIR_X` and `SHARED_AIR_XY`
    are zero without a plane window.
    """
    sigma = air.sigma
    factors = air.factors
    refractivity = air.refractivity
    camera = station.camera_place
    window_kind = station.window_kind
    height_nodes = factors.shape[0]
    height = _place_at(station.height_share * (height_nodes - 1), height_nodes)
    for i in range(count):
        drop = work[DROP, i]
        # In the plane: by the heights of the camera and the ways to the target.
        way = _place_at(work[WAY_POSITION, i], sigma.shape[1])
        sigma_in_plane = _bilinear(sigma, camera, way)
        angle_in_plane = _bilinear(air.angle, camera, way)
        mode_in_plane = _bilinear(air.mode, camera, way)
        work[SIGMA_AIR_X, i] = 0.0
        work[SHARED_AIR_XY, i] = 0.0
        if window_kind >= 0:
            work[SIGMA_AIR_X, i] = _bilinear(air.behind[window_kind, 0], camera, way)
            work[SHARED_AIR_XY, i] = _bilinear(air.behind[window_kind, 1], camera, way)
        # On the sphere. The tables contain values divided by the way, which is `DROP`.
        coarse_way = _place_at(work[COARSE_POSITION, i], factors.shape[1])
        incidence = _place_at(work[INCIDENCE_POSITION, i], factors.shape[2])
        sphere = _on_sphere(factors, height, coarse_way, incidence, mode_in_plane)
        work[SIGMA_BY_TANGENT, i] = sigma_in_plane * sphere.sigma_factor * drop
        work[SLOPE_BY_SECANT2, i] = angle_in_plane * sphere.angle_factor * drop
        work[MODE_BY_TANGENT, i] = sphere.mode * drop / air.mode_sigma
        ground = _place_at(work[GROUND_POSITION, i], refractivity.size)
        work[N_GROUND, i] = linear(refractivity, ground)
