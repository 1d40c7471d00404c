"""Curved rays to the first place where they meet a terrain, compiled.

The terrain is bilinear between the nodes of a grid, which is cut into square tiles; of each tile,
and of blocks of it, the lowest and the highest node are known, so that a ray steps over what it
cannot meet. A ray waits where it needs a tile that is not in memory.
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
    TILE,
    WAITS,
)
from unbend.refraction.kernels.jit import entry, jit
from unbend.refraction.kernels.terrain_paths import Path, fill_path, place_at, velocity_at

_SKY_M = 9_000.0  # above all land
_DEEP_M = 500.0  # so deep under the ground a ray is not followed any further

_BEHIND = 1e-5  # steps end this far behind the edge of a cell, in cells
_CLOSE_M = 1e-6  # steps of the search for a crossing, and heights above the terrain
_FLAT_M = 1e-7  # a height above the terrain that is none
_SHORTEST_STEP_M = 1e-3  # down from the sky

# So much of the way over the radius a steep ray is earlier at an edge than its speed says: without
# air all of it.
_FASTER = 0.75

# So near to nodes of a tile its blocks are looked at, and cells of a block: steps fall short.
_ABOUT_TILE_M = 5.0
_ABOUT_BLOCK_M = 0.01

_MOST_HALVINGS = 100

# Slots of tiles that are not in memory.
_NOT_NEEDED = -1
_TO_BE_READ = -2


class _Patch(NamedTuple):
    """A cell of a tile, between four nodes."""

    tiles: np.ndarray  # those of the `TerrainGrid`
    slot: int  # of the tile
    i: int  # row and column of the cell's first node in the tile
    j: int
    first_row: float  # row and column of that node in the grid
    first_column: float


class _Edges(NamedTuple):
    """Rows and columns between which a box lies."""

    top: float
    bottom: float
    left: float
    right: float


class _Box(NamedTuple):
    """The tile about a place, or the block of the tile where its nodes are needed."""

    tile: int  # number of the tile, -1 beside the grid
    slot: int  # of the tile, or `_NOT_NEEDED`, `_TO_BE_READ`
    cell: tuple[int, int]  # row and column of the place's cell in the tile
    low: float  # lowest node [m]; infinite where all are unknown
    high: float  # highest node [m]; minus infinite where all are unknown
    edges: _Edges


class _Surroundings(NamedTuple):
    """What a ray has about it: a box that it is above or below, or else one cell of that box."""

    box: _Box
    edges: _Edges  # of the box, or of the cell
    is_over: bool  # the ray is above all nodes of the box
    is_under: bool  # the ray is below all nodes; both where all nodes are unknown
    is_near: bool  # neither: the corners of the cell are looked at


class _Passage(NamedTuple):
    """Heights of a ray above the terrain along a straight step over it."""

    f: float  # at the begin of the step [m]; NaN in a hole
    f_1: float  # at its end [m]
    t_turn: float  # distance of the turn of this height that is nearest to zero, or of the end [m]
    f_turn: float  # at the turn [m]
    square: float  # term of second order over the whole step [m]


@jit
def _exit(low, high, place, speed):  # type: ignore[no-untyped-def]
    """Way [m] to the edge of the interval from low to high; infinite for what stands still.

    ``place`` is a row or a column, ``speed`` its change per metre.
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

    ``sides`` are the heights above the patch at the ends, the first above zero. Between them the
    height of a straight way is a parabola with the term of second order ``square``: its root is the
    first guess, then secant and bisection in turn.
    """
    t_0, t_1 = ends
    f_0, f_1 = sides
    fall = f_0 - f_1 + square
    share = 2.0 * f_0 / (fall + math.sqrt(max(fall * fall - 4.0 * square * f_0, 0.0)))
    t = t_0 + min(max(share, 0.0), 1.0) * (t_1 - t_0)
    height = math.nan
    for turn in range(_MOST_HALVINGS):
        if turn % 2 == 1:
            t = t_0 - f_0 * (t_1 - t_0) / (f_1 - f_0)
        elif turn > 0:
            t = 0.5 * (t_0 + t_1)
        at = place_at(path, t)
        f = _above(patch, at)
        height = at.height
        if abs(f) < _FLAT_M or t_1 - t_0 < _CLOSE_M:
            break
        if (f > 0.0) == (f_0 > 0.0):
            t_0 = t
            f_0 = f
        else:
            t_1 = t
            f_1 = f
    return t, height


@jit
def _passage_over_patch(path, patch, ends, at, at_1):  # type: ignore[no-untyped-def]
    """The `_Passage` over a `_Patch` between two distances ``ends`` [m], at two places.

    The height above the patch is a parabola along a straight way: the term of second order comes
    from the twist of the patch.
    """
    t, t_1 = ends
    tiles = patch.tiles
    slot = patch.slot
    i = patch.i
    j = patch.j
    f = _above(patch, at)
    f_1 = _above(patch, at_1)
    twist = tiles[slot, i, j] - tiles[slot, i, j + 1] - tiles[slot, i + 1, j]
    twist += tiles[slot, i + 1, j + 1]
    square = -twist * (at_1.row - at.row) * (at_1.column - at.column)
    linear = f_1 - f - square
    t_turn = t_1
    f_turn = f_1
    if f * f_1 > 0.0 and square * f > 0.0 and 0.0 < -linear / (2.0 * square) < 1.0:
        share = -linear / (2.0 * square)
        t_turn = t + share * (t_1 - t)
        f_turn = _above(patch, place_at(path, t_turn))
    return _Passage(f, f_1, t_turn, f_turn, square)


@jit
def _box_at(grid, row, column, height):  # type: ignore[no-untyped-def]
    """The `_Box` of the tile about a place, or of a block of it where the tile's nodes are needed.

    The nodes are needed where the height is between the lowest and the highest of the tile. The
    slot is `_TO_BE_READ` where they are not in memory yet, and `_NOT_NEEDED` elsewhere.
    """
    turn = 0
    if grid.around > 0:  # columns go round the earth
        turn = math.floor(column / grid.around) * grid.around
    i = math.floor(row)
    j = math.floor(column) - turn
    p = i // TILE
    q = j // TILE
    top = p * TILE
    left = q * TILE
    cell = (i - top, j - left)
    bottom = top + TILE
    right = left + TILE
    if grid.around > 0 and right > grid.around:
        right = grid.around
    low = np.inf
    high = -np.inf
    slot = _NOT_NEEDED
    tile = -1
    if 0 <= p < grid.low.shape[0] and 0 <= q < grid.low.shape[1]:
        tile = p * grid.low.shape[1] + q
        low = grid.low[p, q]
        high = grid.high[p, q]
        if math.isnan(low) or low - _ABOUT_TILE_M <= height <= high + _ABOUT_TILE_M:
            slot = grid.slot[p, q]
            if slot < 0:
                slot = _TO_BE_READ
            else:
                k = cell[0] // BLOCK
                m = cell[1] // BLOCK
                low = grid.block_low[slot, k, m]
                high = grid.block_high[slot, k, m]
                top = top + k * BLOCK
                left = left + m * BLOCK
                bottom = top + BLOCK
                right = min(left + BLOCK, right)
    edges = _Edges(float(top), float(bottom), float(left + turn), float(right + turn))
    return _Box(tile=tile, slot=slot, cell=cell, low=low, high=high, edges=edges)


@jit
def _change(side, now, gap, t):  # type: ignore[no-untyped-def]
    """What becomes of a ray that was on one ``side`` of the terrain and is on another ``now``.

    Sides are 1 above, -1 under, 0 unknown; ``gap`` says that the terrain in between is unknown,
    ``t`` is the distance from the camera [m]. A ray that is suddenly under the terrain has LANDED
    at a step of the terrain.
    """
    if side == 0 and now < 0:
        return NO_TERRAIN if gap or t > 0.0 else HIDDEN
    if side > 0 and now < 0:
        return NO_TERRAIN if gap else LANDED
    return EMERGES if side < 0 and now > 0 else WAITS


@jit
def _at_end(landed, side, gap):  # type: ignore[no-untyped-def]
    """What becomes of a ray that was followed to its end, when it is on ``side`` of the terrain."""
    if landed:
        return LANDED
    if side != 0 and not gap:
        return PASSES
    return NO_TERRAIN


@jit
def _surroundings(grid, at):  # type: ignore[no-untyped-def]
    """The `_Surroundings` of the `RayPlace` ``at``."""
    box = _box_at(grid, at.row, at.column, at.height)
    edges = box.edges
    is_over = at.height > box.high + _ABOUT_BLOCK_M
    is_under = at.height < box.low
    is_near = not (is_over or is_under)
    if is_near:
        top = float(math.floor(at.row))
        left = float(math.floor(at.column))
        edges = _Edges(top, top + 1.0, left, left + 1.0)
    return _Surroundings(box, edges, is_over, is_under, is_near)


@jit
def _step(path, at, velocity, around, way_left):  # type: ignore[no-untyped-def]
    """Length [m] of a step to the edge of the `_Surroundings` ``around``.

    Not beyond the height of their highest or lowest node, nor beyond ``way_left`` [m].
    """
    edges = around.edges
    to_row = _exit(edges.top, edges.bottom, at.row, velocity.row)
    to_column = _exit(edges.left, edges.right, at.column, velocity.column)
    step = min(to_row, to_column)
    step = min(step * (1.0 - _FASTER * min(step, way_left) * at.cosine / path.r_e), way_left)
    if around.is_over and velocity.rise < 0.0:
        step = min(step, (at.height - around.box.high) / -velocity.rise + _CLOSE_M)
    if around.is_under and velocity.rise > 0.0:
        step = min(step, (around.box.low - at.height) / velocity.rise + _CLOSE_M)
    return step


@jit
def _passage(path, patch, around, ends, places):  # type: ignore[no-untyped-def]
    """The `_Passage` of a step between two distances ``ends`` [m] and two ``places``.

    Over or under a box the height above its highest or lowest node stands for all heights.
    """
    at, after = places
    if around.is_near:
        return _passage_over_patch(path, patch, ends, at, after)
    f = at.height - around.box.high if around.is_over else at.height - around.box.low
    return _Passage(f, f, ends[0], f, 0.0)


@jit
def _lands(around, passage):  # type: ignore[no-untyped-def]
    """Whether a ray above the terrain comes down to it over one cell."""
    return around.is_near and (passage.f_1 <= 0.0 or passage.f_turn <= 0.0)


@jit
def _after_sky(at, rise, t, end):  # type: ignore[no-untyped-def]
    """The distance [m] at which a ray that is above all land comes down to it; else ``end``."""
    if rise >= 0.0:
        return end
    return t + max((at.height - _SKY_M) / -rise, _SHORTEST_STEP_M)


@jit
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is missing.

    ``ray`` is its number in the `TerrainState`, whose columns are changed. A ray that landed is
    followed on under the terrain, to see whether it comes out again.
    """
    end = state.end[ray]
    t = state.t[ray]
    side = state.side[ray]
    gap = state.gap[ray]
    has_landed = not math.isnan(state.height[ray])
    result = WAITS
    state.wanted[ray] = -1
    at = place_at(path, t)
    while result == WAITS and t < end:
        velocity = velocity_at(path, at)
        if at.height > _SKY_M:
            t = _after_sky(at, velocity.rise, t, end)
            at = place_at(path, t)
            continue
        around = _surroundings(grid, at)
        box = around.box
        if box.slot == _TO_BE_READ:
            state.wanted[ray] = box.tile
            break
        step = _step(path, at, velocity, around, end - t)
        after = place_at(path, t + step)
        patch = _Patch(
            tiles=grid.tiles,
            slot=box.slot,
            i=box.cell[0],
            j=box.cell[1],
            first_row=around.edges.top,
            first_column=around.edges.left,
        )
        passage = _passage(path, patch, around, (t, t + step), (at, after))
        f = passage.f
        f_1 = passage.f_1
        f_turn = passage.f_turn
        if math.isnan(f) or (around.is_over and around.is_under):
            gap = True
            t = t + step
            at = after
            continue

        # What becomes of the ray on this step.
        now = 1 if f > (_CLOSE_M if side < 0 else 0.0) else -1
        result = _change(side, now, gap, t)
        side = now
        gap = False
        if result == LANDED:  # at a step of the terrain
            state.distance[ray] = t
            state.height[ray] = at.height
            state.factor[ray] = 1.0
            has_landed = True
            result = WAITS
        elif _lands(around, passage) and not has_landed and result == WAITS:
            share = (passage.t_turn - t) / step
            square = passage.square * share * share
            ends = (t, passage.t_turn)
            distance, height = _crossing(path, patch, ends, (f, f_turn), square)
            state.distance[ray] = distance
            state.height[ray] = height
            state.factor[ray] = abs((after.height - at.height) * share / (f_turn - f))
            has_landed = True
            f_turn = f_1
        if has_landed and result == WAITS:
            side = -1
            if max(f_1, f_turn) > _CLOSE_M:
                result = EMERGES
            elif f_1 < -_DEEP_M:
                result = LANDED
        t = t + step
        at = after
    if t >= end and result == WAITS:
        result = _at_end(has_landed, side, gap)
    state.t[ray] = t
    state.side[ray] = side
    state.gap[ray] = gap
    state.result[ray] = result


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays that ``which`` numbers over a `TerrainGrid`, from where they are.

    ``rays`` is a `TerrainRays`; the columns of ``state``, a `TerrainState`, are changed.
    """
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
    """Fill lowest and highest node of the blocks of a tile; infinite where all are unknown."""
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
