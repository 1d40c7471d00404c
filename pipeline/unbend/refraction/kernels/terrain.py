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


class _Path(NamedTuple):
    """A ray: apparent nadir angle, height of the camera [m], radius of the sphere and with the
    camera [m]; distances and divided differences of R_c / distance; row and column as polynomials
    in the arc from the camera."""

    sin_c: float
    cos_c: float
    h_c: float
    r_e: float
    r_c: float
    knot: np.ndarray
    bend: np.ndarray
    row: np.ndarray
    column: np.ndarray


class _Place(NamedTuple):
    """Where a ray is: row, column and height; arc, sine and cosine of its own direction there."""

    row: float
    column: float
    height: float
    arc: float
    sine: float
    cosine: float


class _Patch(NamedTuple):
    """The cell of a tile, and the row and column of its first node in the grid."""

    tiles: np.ndarray
    slot: int
    i: int
    j: int
    first_row: float
    first_column: float


class _Edges(NamedTuple):
    """Rows and columns between which a box lies."""

    top: float
    bottom: float
    left: float
    right: float


class _Box(NamedTuple):
    """The tile about a place and its slot; the cell in the tile; lowest and highest node, edges."""

    tile: int
    slot: int
    cell: tuple[int, int]
    low: float
    high: float
    edges: _Edges


class _Passage(NamedTuple):
    """Heights above a patch along a straight way over it.

    ``f``, ``f_1`` at its ends; ``f_turn`` at the nearest turn of that height between them (or at
    the end), which is at the distance ``t_turn``; ``square`` what ``f`` has of second order.
    """

    f: float
    f_1: float
    t_turn: float
    f_turn: float
    square: float


@jit
def _place(path, t):  # type: ignore[no-untyped-def]
    """The `_Place` at a straight distance from the camera."""
    knot = path.knot
    bend = path.bend
    angle = bend[-1]
    slope = 0.0
    for k in range(bend.size - 2, -1, -1):
        slope = angle + (t - knot[k]) * slope
        angle = bend[k] + (t - knot[k]) * angle
    turned = (angle + t * slope) * t
    angle *= t
    back = 1.0 - 0.5 * angle * angle
    sine = path.sin_c * back - path.cos_c * angle
    cosine = path.cos_c * back + path.sin_c * angle
    across = t * sine
    down = path.r_c - t * cosine
    r = math.sqrt(across * across + down * down)
    height = path.h_c - t * cosine + across * across / (r + down)
    q = across / down
    q2 = q * q
    arc = path.r_e * q * (1.0 - q2 * (1.0 / 3.0 - q2 * (0.2 - q2 / 7.0)))
    row = path.row[-1]
    column = path.column[-1]
    for k in range(path.row.size - 2, -1, -1):
        row = row * arc + path.row[k]
        column = column * arc + path.column[k]
    return _Place(row, column, height, arc, sine - cosine * turned, cosine + sine * turned)


@jit
def _velocity(path, at):  # type: ignore[no-untyped-def]
    """Rows, columns and metres of height per metre of the way, where `_place` is ``at``."""
    arc = at.arc
    turned = arc / path.r_e
    along = (at.sine + turned * at.cosine) / (1.0 + at.height / path.r_e)
    row = 0.0
    column = 0.0
    for k in range(path.row.size - 1, 0, -1):
        row = row * arc + k * path.row[k]
        column = column * arc + k * path.column[k]
    return row * along, column * along, turned * at.sine - at.cosine


@jit
def _exit(low, high, place, speed):  # type: ignore[no-untyped-def]
    """Way to the edge of the interval from low to high; infinite for what stands still."""
    if speed > 0.0:
        return (high - place + _BEHIND) / speed
    if speed < 0.0:
        return (low - place - _BEHIND) / speed
    return math.inf


@jit
def _above(patch, at):  # type: ignore[no-untyped-def]
    """Height above a bilinear `_Patch`, where `_place` is ``at``."""
    tiles, slot, i, j, first_row, first_column = patch
    right = at.column - first_column
    upper = tiles[slot, i, j] + right * (tiles[slot, i, j + 1] - tiles[slot, i, j])
    lower = tiles[slot, i + 1, j] + right * (tiles[slot, i + 1, j + 1] - tiles[slot, i + 1, j])
    return at.height - (upper + (at.row - first_row) * (lower - upper))


@jit
def _crossing(path, patch, ends, sides, square):  # type: ignore[no-untyped-def]
    """Distance and height where a ray meets a patch between two distances, first above it.

    ``sides`` are the heights above it there, between which a straight way is above it by a
    parabola whose term of second order is ``square``: its root, then secant and bisection in turn.
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
        at = _place(path, t)
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
def _in_patch(path, patch, ends, at, at_1):  # type: ignore[no-untyped-def]
    """The `_Passage` between two distances, where `_place` is ``at`` and ``at_1``."""
    t, t_1 = ends
    tiles, slot, i, j, _, _ = patch
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
        f_turn = _above(patch, _place(path, t_turn))
    return _Passage(f, f_1, t_turn, f_turn, square)


@jit
def _box_at(grid, row, column, height):  # type: ignore[no-untyped-def]
    """The `_Box` of the tile about a place, or of its block where the tile's nodes are needed.

    They are where the height is between those of the tile. Its slot in memory is `_NOT_NEEDED`
    elsewhere and `_TO_BE_READ` where it is not there yet.
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
    return _Box(tile, slot, cell, low, high, edges)


@jit
def _change(side, now, gap, t):  # type: ignore[no-untyped-def]
    """What becomes of a ray that is on a side of the terrain (1 above, -1 under) after another (0
    where that is unknown), perhaps behind a gap; LANDED where the terrain has a step."""
    if side == 0 and now < 0:
        return NO_TERRAIN if gap or t > 0.0 else HIDDEN
    if side > 0 and now < 0:
        return NO_TERRAIN if gap else LANDED
    return EMERGES if side < 0 and now > 0 else WAITS


@jit
def _at_end(landed, side, gap):  # type: ignore[no-untyped-def]
    """What becomes of a ray that was followed to its end."""
    if landed:
        return LANDED
    if side != 0 and not gap:
        return PASSES
    return NO_TERRAIN


@jit
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is missing.

    ``ray`` is its number; the columns of ``state`` are changed. ``side`` is 1 above the terrain,
    -1 below, 0 where that is not known yet. A ray that landed is followed on under the terrain, to
    see whether it comes out again.
    """
    end = state.end[ray]
    t = state.t[ray]
    side = state.side[ray]
    gap = state.gap[ray]
    landed = not math.isnan(state.height[ray])
    result = WAITS
    state.wanted[ray] = -1
    at = _place(path, t)
    while result == WAITS and t < end:
        height = at.height
        v_row, v_column, rise = _velocity(path, at)
        if height > _SKY_M:
            t = end if rise >= 0.0 else t + max((height - _SKY_M) / -rise, _SHORTEST_STEP_M)
            at = _place(path, t)
            continue
        box = _box_at(grid, at.row, at.column, height)
        if box.slot == _TO_BE_READ:
            state.wanted[ray] = box.tile
            break
        top, bottom, left, right = box.edges
        over = height > box.high + _ABOUT_BLOCK_M
        under = height < box.low
        near = not (over or under)
        if near:  # one cell, of which the corners are looked at
            top = math.floor(at.row)
            left = math.floor(at.column)
            bottom = top + 1.0
            right = left + 1.0

        # The step: to the edge of the box, and not beyond its highest or lowest node.
        step = min(_exit(top, bottom, at.row, v_row), _exit(left, right, at.column, v_column))
        f = height - box.high if over else height - box.low
        f_1 = f
        f_turn = f
        step = min(step * (1.0 - _FASTER * min(step, end - t) * at.cosine / path.r_e), end - t)
        if over and rise < 0.0:
            step = min(step, f / -rise + _CLOSE_M)
        if under and rise > 0.0:
            step = min(step, (box.low - height) / rise + _CLOSE_M)

        # Heights above the terrain on the way.
        patch = _Patch(grid.tiles, box.slot, box.cell[0], box.cell[1], top, left)
        after = _place(path, t + step)
        t_turn = t
        square = 0.0
        if near:
            f, f_1, t_turn, f_turn, square = _in_patch(path, patch, (t, t + step), at, after)
        if math.isnan(f) or (over and under):
            gap = True
            t = t + step
            at = after
            continue

        # What becomes of the ray on it.
        now = 1 if f > (_CLOSE_M if side < 0 else 0.0) else -1
        result = _change(side, now, gap, t)
        side = now
        gap = False
        if result == LANDED:  # at a step of the terrain
            state.distance[ray] = t
            state.height[ray] = height
            state.factor[ray] = 1.0
            landed = True
            result = WAITS
        elif near and not landed and (f_1 <= 0.0 or f_turn <= 0.0) and result == WAITS:
            share = (t_turn - t) / step
            of_second_order = square * share * share
            found = _crossing(path, patch, (t, t_turn), (f, f_turn), of_second_order)
            state.distance[ray] = found[0]
            state.height[ray] = found[1]
            state.factor[ray] = abs((after.height - height) * share / (f_turn - f))
            landed = True
            f_turn = f_1
        if landed and result == WAITS:
            side = -1
            if max(f_1, f_turn) > _CLOSE_M:
                result = EMERGES
            elif f_1 < -_DEEP_M:
                result = LANDED
        t = t + step
        at = after
    if t >= end and result == WAITS:
        result = _at_end(landed, side, gap)
    state.t[ray] = t
    state.side[ray] = side
    state.gap[ray] = gap
    state.result[ray] = result


@jit
def _fill_path(rays, i, row, column, powers):  # type: ignore[no-untyped-def]
    """Fill row and column of ray i as polynomials in the arc, from those of its chart.

    ``powers`` (2, `CHART_DEGREE` + 1) is room for powers of east and of north; the first are 1.
    """
    easts = powers[0]
    norths = powers[1]
    chart = rays.chart[i]
    east = rays.east[i] / rays.reach[chart]
    north = rays.north[i] / rays.reach[chart]
    for power in range(CHART_DEGREE):
        easts[power + 1] = east * easts[power]
        norths[power + 1] = north * norths[power]
    row[:] = 0.0
    column[:] = 0.0
    term = 0
    for degree in range(CHART_DEGREE + 1):
        for power in range(degree + 1):
            share = easts[degree - power] * norths[power]
            row[degree] += rays.charts[chart, 0, term] * share
            column[degree] += rays.charts[chart, 1, term] * share
            term += 1


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays that ``which`` numbers over a `TerrainGrid`, from where they are.

    ``rays`` is a `TerrainRays`; the columns of ``state``, a `TerrainState`, are changed.
    """
    row = np.empty(CHART_DEGREE + 1)
    column = np.empty(CHART_DEGREE + 1)
    powers = np.ones((2, CHART_DEGREE + 1))
    for i in which:
        _fill_path(rays, i, row, column, powers)
        h_c = rays.h_c[i]
        r_e = rays.r_e[i]
        path = _Path(
            rays.sin_c[i],
            rays.cos_c[i],
            h_c,
            r_e,
            r_e + h_c,
            rays.knot[i],
            rays.bend[i],
            row,
            column,
        )
        _follow(path, grid, i, state)


@entry
def divide_differences(knot, value):  # type: ignore[no-untyped-def]
    """Newton's divided differences of ``value`` (n, k) at ``knot`` (n, k), in its place."""
    for i in range(knot.shape[0]):
        for order in range(1, knot.shape[1]):
            for k in range(knot.shape[1] - 1, order - 1, -1):
                value[i, k] = (value[i, k] - value[i, k - 1]) / (knot[i, k] - knot[i, k - order])


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
