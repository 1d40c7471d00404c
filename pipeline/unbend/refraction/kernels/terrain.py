"""Curved rays to the first place where they meet a terrain, compiled.

The terrain is bilinear between the nodes of a grid, which is cut into square tiles; of each tile,
and of blocks of it, the lowest and the highest node are known, so that a ray steps over what it
cannot meet. A ray waits where it needs a tile that is not in memory.

A ray is followed in steps, each over one tile, block or cell. Distances t and lengths of steps are
straight distances from the camera [m]; heights f are those of the ray above the terrain [m].
"""

import math
from typing import NamedTuple

import numpy as np

from unbend.refraction.kernels.columns import (
    BLOCK,
    CHART_DEGREE,
    EMERGES,
    HIDDEN,
    LANDED,
    NO_TERRAIN,
    PASSES,
    WAITS,
)
from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.kernels.terrain_boxes import TO_BE_READ, Surroundings, surroundings_at
from unbend.refraction.kernels.terrain_paths import (
    Path,
    RayPlace,
    fill_path,
    place_at,
    velocity_at,
)

_ABOVE_ALL_LAND_M = 9_000.0
_DEEP_M = 500.0  # so deep under the ground a ray is not followed any further

_BEHIND_EDGE = 1e-5  # steps end this far behind the edge of a cell, in cells
_BEYOND_NODE_M = 1e-6  # steps to the height of a node end this far beyond it
_SHORTEST_STEP_M = 1e-3  # from above all land

_FLAT_M = 1e-7  # the search for a crossing ends at a height above the terrain that is less,
_NARROW_M = 1e-6  # or where the crossing is known within this distance
_CLEAR_M = 1e-6  # a ray under the terrain is out of it when this high above: less is rounding

# A ray that goes down crosses the grid faster and faster. Over a step of t [m] its mean speed is
# larger than that at the begin by the share t cos(zeta) / r_e without air, by about 0.75 of that in
# air. Steps to edges are shorter by this share.
_SPEED_UP = 0.75

_MOST_GUESSES = 100  # in the search for a crossing
# d(height of the landing) / d(height of the terrain) where the terrain jumps between two cells: as
# on level terrain.
_FACTOR_AT_SEAM = 1.0

_GOES_ON = 255
"""Result of a step that decides nothing; the others are `LANDED` to `WAITS`."""


class _Patch(NamedTuple):
    """A cell of a tile, between four nodes."""

    tiles: np.ndarray  # those of the `TerrainGrid`
    slot: int  # of the tile
    i: int  # row and column of the cell's first node in the tile
    j: int
    first_row: float  # row and column of that node in the grid
    first_column: float


class _Passage(NamedTuple):
    """Heights f of a ray above the terrain along a straight step over it; f < 0 under it."""

    f_0: float  # at the begin of the step [m]; NaN in a hole
    f_1: float  # at its end [m]
    t_turn: float  # distance of the turn at which f is nearest to zero, or else of the end [m]
    f_turn: float  # f there [m]
    square: float  # term of second order of f over the whole step [m]


class _Step(NamedTuple):
    """A straight step of a ray over its surroundings."""

    t: float  # distance from the camera at the begin [m]
    length: float  # [m]
    place_0: RayPlace  # of the ray at the begin
    place_1: RayPlace  # and at the end
    surroundings: Surroundings  # of the begin: what the step leads over
    patch: _Patch
    passage: _Passage


@jit
def _way_behind_edge(low, high, position, speed):  # type: ignore[no-untyped-def]
    """Way [m] of a ray to just behind the edge of the interval from low to high.

    ``position``, between them, is its row or column, ``speed`` is the change of that per metre.
    Infinite where the speed is zero.
    """
    if speed > 0.0:
        return (high - position + _BEHIND_EDGE) / speed
    if speed < 0.0:
        return (low - position - _BEHIND_EDGE) / speed
    return math.inf


@jit
def _height_above_patch(patch, place):  # type: ignore[no-untyped-def]
    """Height [m] of a `RayPlace` above a bilinear `_Patch`; negative under it, NaN in a hole."""
    tiles = patch.tiles
    slot = patch.slot
    i = patch.i
    j = patch.j
    right = place.column - patch.first_column
    upper = tiles[slot, i, j] + right * (tiles[slot, i, j + 1] - tiles[slot, i, j])
    lower = tiles[slot, i + 1, j] + right * (tiles[slot, i + 1, j + 1] - tiles[slot, i + 1, j])
    return place.height - (upper + (place.row - patch.first_row) * (lower - upper))


@jit
def _crossing(path, patch, ends, end_heights, square):  # type: ignore[no-untyped-def]
    """Distance and height [m] at which a ray meets a `_Patch` between two distances ``ends`` [m].

    ``end_heights`` are the heights f of the ray above the patch at the ends: f > 0 at the first,
    f <= 0 at the second. Along a straight way f is a parabola with the term of second order
    ``square``: its smaller root is the first guess. Then secant and bisection alternate.
    """
    t_0, t_1 = ends
    f_0, f_1 = end_heights
    # f_0 - fall * share + square * share^2 = 0
    fall = f_0 - f_1 + square
    share = 2.0 * f_0 / (fall + math.sqrt(max(fall * fall - 4.0 * square * f_0, 0.0)))
    t = t_0 + min(max(share, 0.0), 1.0) * (t_1 - t_0)
    place = place_at(path, t)
    for guess in range(_MOST_GUESSES):
        f = _height_above_patch(patch, place)
        if abs(f) < _FLAT_M or t_1 - t_0 < _NARROW_M:
            break
        # The crossing stays between t_0, where the ray is above the patch, and t_1.
        if f > 0.0:
            t_0 = t
            f_0 = f
        else:
            t_1 = t
            f_1 = f
        # A secant after an even number of guesses, the middle after an odd one.
        t = t_0 - f_0 * (t_1 - t_0) / (f_1 - f_0) if guess % 2 == 0 else 0.5 * (t_0 + t_1)
        place = place_at(path, t)
    return t, place.height


@jit
def _passage_over_patch(path, patch, ends, place_0, place_1):  # type: ignore[no-untyped-def]
    """The `_Passage` over a `_Patch` between two distances ``ends`` [m] along a `Path`.

    ``place_0`` and ``place_1`` are the `RayPlace` there. Along a straight way the height f above
    the patch is a parabola, with a term of second order by the twist of the patch.
    """
    t_0, t_1 = ends
    tiles = patch.tiles
    slot = patch.slot
    i = patch.i
    j = patch.j
    f_0 = _height_above_patch(patch, place_0)
    f_1 = _height_above_patch(patch, place_1)
    twist = tiles[slot, i, j] - tiles[slot, i, j + 1] - tiles[slot, i + 1, j]
    twist += tiles[slot, i + 1, j + 1]
    square = -twist * (place_1.row - place_0.row) * (place_1.column - place_0.column)
    linear = f_1 - f_0 - square
    t_turn = t_1
    f_turn = f_1
    # Both ends are on one side of the patch, and the parabola comes nearer to it in between.
    if f_0 * f_1 > 0.0 and square * f_0 > 0.0 and 0.0 < -linear / (2.0 * square) < 1.0:
        share = -linear / (2.0 * square)
        t_turn = t_0 + share * (t_1 - t_0)
        f_turn = _height_above_patch(patch, place_at(path, t_turn))
    return _Passage(f_0, f_1, t_turn, f_turn, square)


@jit
def _side_of_terrain(f, previous_side):  # type: ignore[no-untyped-def]
    """Side of the terrain on which a ray ``f`` [m] above it is: 1 above, -1 under.

    A ray with the ``previous_side`` -1 is above only when it is more than `_CLEAR_M` above: after
    a landing, f has either sign by rounding.
    """
    threshold = _CLEAR_M if previous_side < 0 else 0.0
    return 1 if f > threshold else -1


@jit
def _result_of_sides(previous_side, side, gap, t):  # type: ignore[no-untyped-def]
    """What becomes of a ray at the seam of two cells, by its side of the terrain before and after.

    Sides are 1 above, -1 under; ``previous_side`` is 0 where terrain was not known so far. ``gap``
    states that the terrain in between is unknown, ``t`` is the distance from the camera [m]. A ray
    without a gap that was above the last cell and is under this one has `LANDED` at the seam.
    """
    if previous_side == 0 and side < 0:
        return NO_TERRAIN if gap or t > 0.0 else HIDDEN
    if previous_side > 0 and side < 0:
        return NO_TERRAIN if gap else LANDED
    if previous_side < 0 and side > 0:
        return EMERGES
    return _GOES_ON


@jit
def _result_at_end(has_landed, side, gap):  # type: ignore[no-untyped-def]
    """What becomes of a ray that was followed to the end of its way.

    ``side`` is where terrain was last known: 1 above it, -1 under it, 0 never known; ``gap`` states
    that the terrain is unknown since then.
    """
    if has_landed:
        return LANDED
    if side != 0 and not gap:
        return PASSES
    return NO_TERRAIN


@jit
def _length_of_step(path, place, velocity, surroundings, remaining_way):  # type: ignore[no-untyped-def]
    """Length [m] of a step from a `RayPlace` to the edge of its `Surroundings`.

    Over a box it ends where the ray is as low as the highest node, under a box where it is as high
    as the lowest node. It is at most ``remaining_way`` [m].
    """
    edges = surroundings.edges
    to_row = _way_behind_edge(edges.top, edges.bottom, place.row, velocity.row)
    to_column = _way_behind_edge(edges.left, edges.right, place.column, velocity.column)
    to_edge = min(to_row, to_column)  # at the velocity at the begin; may be infinite
    faster_by = _SPEED_UP * min(to_edge, remaining_way) * place.cosine / path.r_e
    step = min(to_edge * (1.0 - faster_by), remaining_way)
    if surroundings.is_over and velocity.rise < 0.0:
        to_highest = (place.height - surroundings.box.high) / -velocity.rise
        step = min(step, to_highest + _BEYOND_NODE_M)
    if surroundings.is_under and velocity.rise > 0.0:
        to_lowest = (surroundings.box.low - place.height) / velocity.rise
        step = min(step, to_lowest + _BEYOND_NODE_M)
    return step


@jit
def _passage_of_step(path, patch, surroundings, ends, places):  # type: ignore[no-untyped-def]
    """The `_Passage` of a step between two distances ``ends`` [m] and the two ``places`` there.

    Over a box the height above its highest node replaces f on the whole step, and under a box the
    height above its lowest node: it has the sign of f.
    """
    place_0, place_1 = places
    if surroundings.is_near:
        return _passage_over_patch(path, patch, ends, place_0, place_1)
    box = surroundings.box
    f = place_0.height - box.high if surroundings.is_over else place_0.height - box.low
    return _Passage(f, f, ends[0], f, 0.0)


@jit
def _lands(surroundings, passage):  # type: ignore[no-untyped-def]
    """Whether a ray that is above the terrain comes down to it on a step over one cell."""
    return surroundings.is_near and (passage.f_1 <= 0.0 or passage.f_turn <= 0.0)


@jit
def _distance_down_to_land(place, rise, t, end):  # type: ignore[no-untyped-def]
    """Distance [m] from the camera at which a ray has come down to `_ABOVE_ALL_LAND_M`.

    The ray is at a `RayPlace` above that, at the distance ``t`` [m], and changes its height by
    ``rise`` [m/m]. For a ray that rises it is ``end``, the end of its way.
    """
    if rise >= 0.0:
        return end
    return t + max((place.height - _ABOVE_ALL_LAND_M) / -rise, _SHORTEST_STEP_M)


@jit
def _put_landing(state, ray, distance, height, factor):  # type: ignore[no-untyped-def]
    """Put the landing of the ray with this number into the `TerrainState`."""
    state.distance[ray] = distance
    state.height[ray] = height
    state.factor[ray] = factor


@jit
def _land_in_cell(path, step):  # type: ignore[no-untyped-def]
    """Distance [m], height [m] and factor of the landing of a ray on a `_Step` over a cell.

    The ray lands between the begin of the step and the turn of its `_Passage`. The factor is
    d(height of the landing) / d(height of the terrain).
    """
    passage = step.passage
    share = (passage.t_turn - step.t) / step.length
    square = passage.square * share * share
    ends = (step.t, passage.t_turn)
    end_heights = (passage.f_0, passage.f_turn)
    distance, height = _crossing(path, step.patch, ends, end_heights, square)
    # Terrain that is higher by df is met where the ray is higher by df times its change of height
    # over its change of f.
    rise = step.place_1.height - step.place_0.height
    factor = abs(rise * share / (passage.f_turn - passage.f_0))
    return distance, height, factor


@jit
def _result_under_ground(passage):  # type: ignore[no-untyped-def]
    """What becomes of a landed ray on a step that begins under the terrain, or lands on it.

    On a step that lands, f is zero or less at the turn of the `_Passage`, so that only the end can
    be out of the ground.
    """
    if max(passage.f_1, passage.f_turn) > _CLEAR_M:
        return EMERGES
    if passage.f_1 < -_DEEP_M:
        return LANDED
    return _GOES_ON


@jit
def _result_of_step(path, step, ray, state):  # type: ignore[no-untyped-def]
    """What becomes of a ray on a `_Step` over known terrain; `_GOES_ON` if that is still open.

    ``ray`` is its number in ``state``, the `TerrainState`, into which the new side and a landing
    are put.
    """
    passage = step.passage
    previous_side = state.side[ray]
    has_landed = not math.isnan(state.height[ray])

    # Where this box or cell meets the last one.
    side = _side_of_terrain(passage.f_0, previous_side)
    result = _result_of_sides(previous_side, side, state.gap[ray], step.t)
    state.side[ray] = side
    state.gap[ray] = False
    if result == LANDED:
        # A landing does not end the ray: it may come out of the terrain again.
        _put_landing(state, ray, step.t, step.place_0.height, _FACTOR_AT_SEAM)
        has_landed = True
        result = _GOES_ON

    # Over this cell.
    if result == _GOES_ON and not has_landed and _lands(step.surroundings, passage):
        distance, height, factor = _land_in_cell(path, step)
        _put_landing(state, ray, distance, height, factor)
        has_landed = True

    # Under the terrain.
    if result == _GOES_ON and has_landed:
        state.side[ray] = -1
        result = _result_under_ground(passage)
    return result


@jit
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is not in memory.

    ``path`` is its `Path`, ``ray`` its number in ``state``, the `TerrainState`, where its values
    are changed. A ray that landed is followed further, under the terrain, to see whether it comes
    out again.
    """
    end = state.end[ray]
    t = state.t[ray]
    place = place_at(path, t)
    result = _GOES_ON
    state.wanted[ray] = -1
    while result == _GOES_ON and t < end:
        velocity = velocity_at(path, place)
        if place.height > _ABOVE_ALL_LAND_M:
            state.side[ray] = 1
            t = _distance_down_to_land(place, velocity.rise, t, end)
            place = place_at(path, t)
            continue
        surroundings = surroundings_at(grid, place)
        box = surroundings.box
        if box.slot == TO_BE_READ:
            state.wanted[ray] = box.tile
            result = WAITS
            continue
        length = _length_of_step(path, place, velocity, surroundings, end - t)
        t_1 = t + length
        place_1 = place_at(path, t_1)
        # Read only where surroundings.is_near: else the slot may be `_NOT_NEEDED`.
        patch = _Patch(
            tiles=grid.tiles,
            slot=box.slot,
            i=box.cell[0],
            j=box.cell[1],
            first_row=surroundings.edges.top,
            first_column=surroundings.edges.left,
        )
        passage = _passage_of_step(path, patch, surroundings, (t, t_1), (place, place_1))
        # Over and under at once is a box of unknown nodes: see `Surroundings`.
        is_unknown_box = surroundings.is_over and surroundings.is_under
        if is_unknown_box or math.isnan(passage.f_0):
            state.gap[ray] = True
        else:
            step = _Step(
                t=t,
                length=length,
                place_0=place,
                place_1=place_1,
                surroundings=surroundings,
                patch=patch,
                passage=passage,
            )
            result = _result_of_step(path, step, ray, state)
        t = t_1
        place = place_1
    if result == _GOES_ON:  # it was followed to its end
        has_landed = not math.isnan(state.height[ray])
        result = _result_at_end(has_landed, state.side[ray], state.gap[ray])
    state.t[ray] = t
    state.result[ray] = result


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays with the numbers ``which`` over ``grid``, from where ``state`` has them.

    ``rays`` are `TerrainRays`, ``grid`` is a `TerrainGrid`; the columns of ``state``, a
    `TerrainState`, are changed.
    """
    # Work arrays: the polynomials of one path, and powers from the power 0, which is 1.
    row = np.empty(CHART_DEGREE + 1)
    column = np.empty(CHART_DEGREE + 1)
    powers = np.ones((2, CHART_DEGREE + 1))
    for i in which:
        fill_path(rays, i, row, column, powers)
        h_c = rays.h_c[i]
        r_e = rays.r_e[i]
        path = Path(
            sin_c=rays.sin_c[i],
            cos_c=rays.cos_c[i],
            h_c=h_c,
            r_e=r_e,
            r_c=r_e + h_c,
            knot=rays.knot[i],
            bend=rays.bend[i],
            row=row,
            column=column,
        )
        _follow(path, grid, i, state)


@entry
def extremes_of_tile(tile, low, high):  # type: ignore[no-untyped-def]
    """Fill ``low`` and ``high`` with the lowest and the highest node [m] of each block of a tile.

    ``tile`` (TILE + 1, TILE + 1) are heights of nodes [m], NaN where unknown, ``low`` and ``high``
    are (TILE / BLOCK, TILE / BLOCK). Nodes on the edge of a block belong to it, so blocks share
    them. Where all nodes of a block are unknown, the lowest is infinite, the highest minus
    infinite.
    """
    for block_row in range(low.shape[0]):
        for block_column in range(low.shape[1]):
            lowest = np.inf
            highest = -np.inf
            for i in range(block_row * BLOCK, (block_row + 1) * BLOCK + 1):
                for j in range(block_column * BLOCK, (block_column + 1) * BLOCK + 1):
                    if tile[i, j] < lowest:
                        lowest = tile[i, j]
                    if tile[i, j] > highest:
                        highest = tile[i, j]
            low[block_row, block_column] = lowest
            high[block_row, block_column] = highest
