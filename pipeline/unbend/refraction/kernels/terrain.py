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

_SKY_M = 9_000.0  # above all land
_DEEP_M = 500.0  # so deep under the ground a ray is not followed any further

_BEHIND = 1e-5  # steps end this far behind the edge of a cell, in cells
_BEYOND_M = 1e-6  # steps to the height of a node end this far beyond it
_SHORTEST_STEP_M = 1e-3  # down from the sky

_FLAT_M = 1e-7  # the search for a crossing ends at a height above the terrain that is less,
_NARROW_M = 1e-6  # or where the crossing is known to lie within this distance
_CLEAR_M = 1e-6  # a ray under the terrain comes out where it is this high above: less is rounding

# A ray that goes down moves over the grid faster and faster: on a step of t [m], on the average, by
# the share t cos(zeta) / r_e faster than at its begin without air, by about 0.75 of that in air.
# Steps to edges are shorter by as much.
_FASTER = 0.75

_MOST_GUESSES = 100  # in the search for a crossing
# d(height of the landing) / d(height of the terrain) where the terrain jumps between two cells: as
# on level terrain.
_FACTOR_AT_SEAM = 1.0

_GOES_ON = 255
"""What becomes of a ray on a step that decides nothing, beside `LANDED` to `WAITS`."""


class _Patch(NamedTuple):
    """A cell of a tile, between four nodes."""

    tiles: np.ndarray  # those of the `TerrainGrid`
    slot: int  # of the tile
    i: int  # row and column of the cell's first node in the tile
    j: int
    first_row: float  # row and column of that node in the grid
    first_column: float


class _Passage(NamedTuple):
    """Heights f of a ray above the terrain along a straight step over it."""

    f_0: float  # at the begin of the step [m]; NaN in a hole
    f_1: float  # at its end [m]
    t_turn: float  # distance of the turn at which f is nearest to zero, or else of the end [m]
    f_turn: float  # f there [m]
    square: float  # term of second order of f over the whole step [m]


class _Step(NamedTuple):
    """A straight step of a ray over its surroundings."""

    t: float  # distance from the camera at the begin [m]
    length: float  # [m]
    at: RayPlace  # the ray at the begin
    at_1: RayPlace  # and at the end
    around: Surroundings  # of the begin: what the step leads over
    patch: _Patch
    passage: _Passage


@jit
def _exit(low, high, place, speed):  # type: ignore[no-untyped-def]
    """Way [m] to just behind the edge of the interval from low to high, which holds ``place``.

    ``place`` is a row or a column, ``speed`` its change per metre. Infinite where that is zero.
    """
    if speed > 0.0:
        return (high - place + _BEHIND) / speed
    if speed < 0.0:
        return (low - place - _BEHIND) / speed
    return math.inf


@jit
def _above(patch, at):  # type: ignore[no-untyped-def]
    """Height [m] of the `RayPlace` ``at`` above a bilinear `_Patch`."""
    tiles = patch.tiles
    slot = patch.slot
    i = patch.i
    j = patch.j
    right = at.column - patch.first_column
    upper = tiles[slot, i, j] + right * (tiles[slot, i, j + 1] - tiles[slot, i, j])
    lower = tiles[slot, i + 1, j] + right * (tiles[slot, i + 1, j + 1] - tiles[slot, i + 1, j])
    return at.height - (upper + (at.row - patch.first_row) * (lower - upper))


@jit
def _crossing(path, patch, ends, sides, square):  # type: ignore[no-untyped-def]
    """Distance and height [m] at which a ray meets a patch between two distances ``ends`` [m].

    ``sides`` are the heights f of the ray above the patch at the ends: f > 0 at the first, f <= 0
    at the second. Along a straight way f is a parabola with the term of second order ``square``:
    its smaller root is the first guess. Then secant and bisection take turns.
    """
    t_0, t_1 = ends
    f_0, f_1 = sides
    # f_0 - fall * share + square * share^2 = 0
    fall = f_0 - f_1 + square
    share = 2.0 * f_0 / (fall + math.sqrt(max(fall * fall - 4.0 * square * f_0, 0.0)))
    t = t_0 + min(max(share, 0.0), 1.0) * (t_1 - t_0)
    at = place_at(path, t)
    for guess in range(_MOST_GUESSES):
        f = _above(patch, at)
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
        at = place_at(path, t)
    return t, at.height


@jit
def _passage_over_patch(path, patch, ends, at_0, at_1):  # type: ignore[no-untyped-def]
    """The `_Passage` over a `_Patch` between two distances ``ends`` [m], at two places.

    Along a straight way f is a parabola: the term of second order comes from the twist of the
    patch.
    """
    t_0, t_1 = ends
    tiles = patch.tiles
    slot = patch.slot
    i = patch.i
    j = patch.j
    f_0 = _above(patch, at_0)
    f_1 = _above(patch, at_1)
    twist = tiles[slot, i, j] - tiles[slot, i, j + 1] - tiles[slot, i + 1, j]
    twist += tiles[slot, i + 1, j + 1]
    square = -twist * (at_1.row - at_0.row) * (at_1.column - at_0.column)
    linear = f_1 - f_0 - square
    t_turn = t_1
    f_turn = f_1
    # Both ends are on one side of the patch, and the parabola comes nearer to it in between.
    if f_0 * f_1 > 0.0 and square * f_0 > 0.0 and 0.0 < -linear / (2.0 * square) < 1.0:
        share = -linear / (2.0 * square)
        t_turn = t_0 + share * (t_1 - t_0)
        f_turn = _above(patch, place_at(path, t_turn))
    return _Passage(f_0, f_1, t_turn, f_turn, square)


@jit
def _side_now(f, side):  # type: ignore[no-untyped-def]
    """Side of the terrain of a ray ``f`` [m] above it that was on ``side``: 1 above, -1 under.

    A ray that was under the terrain is out only when it is clearly above: a landing leaves heights
    of either sign by rounding.
    """
    least = _CLEAR_M if side < 0 else 0.0
    return 1 if f > least else -1


@jit
def _change(side, now, gap, t):  # type: ignore[no-untyped-def]
    """What becomes of a ray that was on one ``side`` of the terrain and is on the side ``now``.

    Sides are 1 above, -1 under, 0 never known; ``gap`` says that the terrain in between is unknown,
    ``t`` is the distance from the camera [m]. A ray without a gap that was above the last cell and
    is under this one has LANDED where the two meet.
    """
    if side == 0 and now < 0:
        return NO_TERRAIN if gap or t > 0.0 else HIDDEN
    if side > 0 and now < 0:
        return NO_TERRAIN if gap else LANDED
    return EMERGES if side < 0 and now > 0 else _GOES_ON


@jit
def _at_end(has_landed, side, gap):  # type: ignore[no-untyped-def]
    """What becomes of a ray at the end of its way, where it is on ``side`` of the terrain."""
    if has_landed:
        return LANDED
    if side != 0 and not gap:
        return PASSES
    return NO_TERRAIN


@jit
def _length_of_step(path, at, velocity, around, way_left):  # type: ignore[no-untyped-def]
    """Length [m] of a step to the edge of the `Surroundings` ``around``.

    Not beyond the height of their highest or lowest node, nor beyond ``way_left`` [m].
    """
    edges = around.edges
    to_row = _exit(edges.top, edges.bottom, at.row, velocity.row)
    to_column = _exit(edges.left, edges.right, at.column, velocity.column)
    to_edge = min(to_row, to_column)  # at the velocity at the begin; may be infinite
    faster_by = _FASTER * min(to_edge, way_left) * at.cosine / path.r_e
    step = min(to_edge * (1.0 - faster_by), way_left)
    if around.is_over and velocity.rise < 0.0:
        to_highest = (at.height - around.box.high) / -velocity.rise
        step = min(step, to_highest + _BEYOND_M)
    if around.is_under and velocity.rise > 0.0:
        to_lowest = (around.box.low - at.height) / velocity.rise
        step = min(step, to_lowest + _BEYOND_M)
    return step


@jit
def _passage(path, patch, around, ends, places):  # type: ignore[no-untyped-def]
    """The `_Passage` of a step between two distances ``ends`` [m] and two ``places``.

    Over a box the height above its highest node stands for f on the whole step, and under a box
    that above its lowest node: it has the sign of f.
    """
    at_0, at_1 = places
    if around.is_near:
        return _passage_over_patch(path, patch, ends, at_0, at_1)
    f = at_0.height - around.box.high if around.is_over else at_0.height - around.box.low
    return _Passage(f, f, ends[0], f, 0.0)


@jit
def _lands(around, passage):  # type: ignore[no-untyped-def]
    """Whether a ray above the terrain comes down to it over one cell."""
    return around.is_near and (passage.f_1 <= 0.0 or passage.f_turn <= 0.0)


@jit
def _after_sky(at, rise, t, end):  # type: ignore[no-untyped-def]
    """Distance [m] at which a ray comes down to the height of land; ``end`` where it rises."""
    if rise >= 0.0:
        return end
    return t + max((at.height - _SKY_M) / -rise, _SHORTEST_STEP_M)


@jit
def _put_landing(state, ray, distance, height, factor):  # type: ignore[no-untyped-def]
    """Put where a ray landed into the `TerrainState`."""
    state.distance[ray] = distance
    state.height[ray] = height
    state.factor[ray] = factor


@jit
def _land_in_cell(path, step):  # type: ignore[no-untyped-def]
    """Distance [m], height [m] and factor of the landing of a ray on a `_Step` over a cell.

    The ray lands between the begin of the step and the turn of its `_Passage`.
    """
    passage = step.passage
    share = (passage.t_turn - step.t) / step.length
    square = passage.square * share * share
    ends = (step.t, passage.t_turn)
    sides = (passage.f_0, passage.f_turn)
    distance, height = _crossing(path, step.patch, ends, sides, square)
    # Terrain that is higher by df is met where the ray is higher by df times its change of height
    # over its change of f.
    rise = step.at_1.height - step.at.height
    factor = abs(rise * share / (passage.f_turn - passage.f_0))
    return distance, height, factor


@jit
def _under_ground(passage):  # type: ignore[no-untyped-def]
    """What becomes of a landed ray on a step that begins under the terrain, or lands there.

    On a step that lands, f is zero or less at its turn, so that only the end can be out.
    """
    if max(passage.f_1, passage.f_turn) > _CLEAR_M:
        return EMERGES
    if passage.f_1 < -_DEEP_M:
        return LANDED
    return _GOES_ON


@jit
def _result_of_step(path, step, ray, state):  # type: ignore[no-untyped-def]
    """What becomes of a ray on a `_Step` over known terrain, or `_GOES_ON`.

    ``ray`` is its number in the `TerrainState`, into which a landing and the new side are put.
    """
    passage = step.passage
    side = state.side[ray]
    has_landed = not math.isnan(state.height[ray])

    # Where this box or cell meets the last one.
    now = _side_now(passage.f_0, side)
    result = _change(side, now, state.gap[ray], step.t)
    state.side[ray] = now
    state.gap[ray] = False
    if result == LANDED:
        # A landing does not end the ray: it may come out of the terrain again.
        _put_landing(state, ray, step.t, step.at.height, _FACTOR_AT_SEAM)
        has_landed = True
        result = _GOES_ON

    # Over this cell.
    if result == _GOES_ON and not has_landed and _lands(step.around, passage):
        distance, height, factor = _land_in_cell(path, step)
        _put_landing(state, ray, distance, height, factor)
        has_landed = True

    # Under the terrain.
    if result == _GOES_ON and has_landed:
        state.side[ray] = -1
        result = _under_ground(passage)
    return result


@jit
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is missing.

    ``ray`` is its number in the `TerrainState`, whose columns are changed. A ray that landed is
    followed on under the terrain, to see whether it comes out again.
    """
    end = state.end[ray]
    t = state.t[ray]
    at = place_at(path, t)
    result = _GOES_ON
    state.wanted[ray] = -1
    while result == _GOES_ON and t < end:
        velocity = velocity_at(path, at)
        if at.height > _SKY_M:
            state.side[ray] = 1
            t = _after_sky(at, velocity.rise, t, end)
            at = place_at(path, t)
            continue
        around = surroundings_at(grid, at)
        box = around.box
        if box.slot == TO_BE_READ:
            state.wanted[ray] = box.tile
            result = WAITS
            continue
        length = _length_of_step(path, at, velocity, around, end - t)
        t_1 = t + length
        at_1 = place_at(path, t_1)
        # Read only where around.is_near: else the slot may be none.
        patch = _Patch(
            tiles=grid.tiles,
            slot=box.slot,
            i=box.cell[0],
            j=box.cell[1],
            first_row=around.edges.top,
            first_column=around.edges.left,
        )
        passage = _passage(path, patch, around, (t, t_1), (at, at_1))
        # Over and under at once is a box of unknown nodes: see `Surroundings`.
        is_unknown = (around.is_over and around.is_under) or math.isnan(passage.f_0)
        if is_unknown:
            state.gap[ray] = True
        else:
            step = _Step(
                t=t,
                length=length,
                at=at,
                at_1=at_1,
                around=around,
                patch=patch,
                passage=passage,
            )
            result = _result_of_step(path, step, ray, state)
        t = t_1
        at = at_1
    if result == _GOES_ON:  # it was followed to its end
        has_landed = not math.isnan(state.height[ray])
        result = _at_end(has_landed, state.side[ray], state.gap[ray])
    state.t[ray] = t
    state.result[ray] = result


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays that ``which`` numbers over a `TerrainGrid`, from where they are.

    ``rays`` is a `TerrainRays`; the columns of ``state``, a `TerrainState`, are changed.
    """
    # Room for the polynomials of one path, and for powers, of which the first are 1.
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
    """Fill lowest and highest node of the blocks of a tile, its edges among them.

    Where all nodes of a block are NaN, unknown, the lowest is infinite and the highest minus that.
    """
    for k in range(low.shape[0]):
        for m in range(low.shape[1]):
            least = np.inf
            most = -np.inf
            for i in range(k * BLOCK, (k + 1) * BLOCK + 1):
                for j in range(m * BLOCK, (m + 1) * BLOCK + 1):
                    if tile[i, j] < least:
                        least = tile[i, j]
                    if tile[i, j] > most:
                        most = tile[i, j]
            low[k, m] = least
            high[k, m] = most
