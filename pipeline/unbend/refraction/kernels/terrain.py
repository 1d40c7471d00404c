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

# Above all land [m]; and so deep under the ground a ray is not followed any further.
_SKY_M, _DEEP_M = 9_000.0, 500.0

# Steps end this far behind the edge of a cell, in cells.
_BEHIND = 1e-5
_CLOSE_M, _FLAT_M = 1e-6, 1e-7

# So much of the way over the radius a steep ray is earlier at an edge than its speed says: without
# air all of it.
_FASTER = 0.75

# So near to nodes of a tile its blocks are looked at, and cells of a block: steps fall short.
_ABOUT_TILE_M, _ABOUT_BLOCK_M = 5.0, 0.01


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


@jit
def _place(path, t):  # type: ignore[no-untyped-def]
    """Row, column and height at a straight distance from the camera; arc, sine and cosine of the
    ray's own direction there."""
    knot, bend = path.knot, path.bend
    angle, slope = bend[-1], 0.0
    for k in range(bend.size - 2, -1, -1):
        slope = angle + (t - knot[k]) * slope
        angle = bend[k] + (t - knot[k]) * angle
    turned = (angle + t * slope) * t
    angle *= t
    back = 1.0 - 0.5 * angle * angle
    sine = path.sin_c * back - path.cos_c * angle
    cosine = path.cos_c * back + path.sin_c * angle
    across, down = t * sine, path.r_c - t * cosine
    r = math.sqrt(across * across + down * down)
    height = path.h_c - t * cosine + across * across / (r + down)
    q = across / down
    q2 = q * q
    arc = path.r_e * q * (1.0 - q2 * (1.0 / 3.0 - q2 * (0.2 - q2 / 7.0)))
    row, column = path.row[-1], path.column[-1]
    for k in range(path.row.size - 2, -1, -1):
        row = row * arc + path.row[k]
        column = column * arc + path.column[k]
    return row, column, height, arc, sine - cosine * turned, cosine + sine * turned


@jit
def _velocity(path, at):  # type: ignore[no-untyped-def]
    """Rows, columns and metres of height per metre of the way, where `_place` is ``at``."""
    _, _, height, arc, sine, cosine = at
    turned = arc / path.r_e
    along = (sine + turned * cosine) / (1.0 + height / path.r_e)
    row = column = 0.0
    for k in range(path.row.size - 1, 0, -1):
        row = row * arc + k * path.row[k]
        column = column * arc + k * path.column[k]
    return row * along, column * along, turned * sine - cosine


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
    """Height above a bilinear patch, where `_place` is ``at``.

    A patch is the cell of a tile, and the row and column of its first node in the grid.
    """
    tiles, slot, i, j, first_row, first_column = patch
    right = at[1] - first_column
    upper = tiles[slot, i, j] + right * (tiles[slot, i, j + 1] - tiles[slot, i, j])
    lower = tiles[slot, i + 1, j] + right * (tiles[slot, i + 1, j + 1] - tiles[slot, i + 1, j])
    return at[2] - (upper + (at[0] - first_row) * (lower - upper))


@jit
def _crossing(path, patch, ends, sides, square):  # type: ignore[no-untyped-def]
    """Distance and height where a ray meets a patch between two distances, first above it.

    ``sides`` are the heights above it there, between which a straight way is above it by a
    parabola whose term of second order is ``square``: its root, then secant and bisection in turn.
    """
    (t_0, t_1), (f_0, f_1) = ends, sides
    fall = f_0 - f_1 + square
    share = 2.0 * f_0 / (fall + math.sqrt(max(fall * fall - 4.0 * square * f_0, 0.0)))
    t, height = t_0 + min(max(share, 0.0), 1.0) * (t_1 - t_0), math.nan
    for turn in range(100):
        if turn % 2 == 1:
            t = t_0 - f_0 * (t_1 - t_0) / (f_1 - f_0)
        elif turn > 0:
            t = 0.5 * (t_0 + t_1)
        at = _place(path, t)
        f, height = _above(patch, at), at[2]
        if abs(f) < _FLAT_M or t_1 - t_0 < _CLOSE_M:
            break
        if (f > 0.0) == (f_0 > 0.0):
            t_0, f_0 = t, f
        else:
            t_1, f_1 = t, f
    return t, height


@jit
def _in_patch(path, patch, ends, at, at_1):  # type: ignore[no-untyped-def]
    """Heights above a patch at two distances, where `_place` is ``at`` and ``at_1``; the nearest
    turn of that height between them (or the second distance) with what it is there; and what the
    first of these heights has of second order between the distances."""
    (t, t_1), (tiles, slot, i, j, _, _) = ends, patch
    f, f_1 = _above(patch, at), _above(patch, at_1)
    twist = tiles[slot, i, j] - tiles[slot, i, j + 1] - tiles[slot, i + 1, j]
    twist += tiles[slot, i + 1, j + 1]
    square = -twist * (at_1[0] - at[0]) * (at_1[1] - at[1])
    linear = f_1 - f - square
    t_turn, f_turn = t_1, f_1
    if f * f_1 > 0.0 and square * f > 0.0 and 0.0 < -linear / (2.0 * square) < 1.0:
        share = -linear / (2.0 * square)
        t_turn = t + share * (t_1 - t)
        f_turn = _above(patch, _place(path, t_turn))
    return f, f_1, t_turn, f_turn, square


@jit
def _box_at(grid, row, column, height):  # type: ignore[no-untyped-def]
    """The tile about a place and its slot in memory, -1 where its nodes are not needed and -2 where
    it has to be read first; the cell in the tile; and lowest node, highest node and edges of the
    tile, or of its block where the height is between those of the tile."""
    turn = 0
    if grid.around > 0:  # columns go round the earth
        turn = math.floor(column / grid.around) * grid.around
    i, j = math.floor(row), math.floor(column) - turn
    p, q = i // TILE, j // TILE
    top, left = p * TILE, q * TILE
    cell = i - top, j - left
    bottom, right = top + TILE, left + TILE
    if grid.around > 0 and right > grid.around:
        right = grid.around
    low, high, slot, tile = np.inf, -np.inf, -1, -1
    if 0 <= p < grid.low.shape[0] and 0 <= q < grid.low.shape[1]:
        tile = p * grid.low.shape[1] + q
        low, high = grid.low[p, q], grid.high[p, q]
        if math.isnan(low) or low - _ABOUT_TILE_M <= height <= high + _ABOUT_TILE_M:
            slot = grid.slot[p, q]
            if slot < 0:
                slot = -2
            else:
                k, m = cell[0] // BLOCK, cell[1] // BLOCK
                low, high = grid.block_low[slot, k, m], grid.block_high[slot, k, m]
                top, left = top + k * BLOCK, left + m * BLOCK
                bottom, right = top + BLOCK, min(left + BLOCK, right)
    edges = float(top), float(bottom), float(left + turn), float(right + turn)
    return tile, slot, cell, low, high, edges


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
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is missing.

    ``ray`` is its number; the columns of ``state`` are changed. ``side`` is 1 above the terrain,
    -1 below, 0 where that is not known yet. A ray that landed is followed on under the terrain, to
    see whether it comes out again.
    """
    end, t, side, gap = state.end[ray], state.t[ray], state.side[ray], state.gap[ray]
    landed = not math.isnan(state.height[ray])
    result = WAITS
    state.wanted[ray] = -1
    at = _place(path, t)
    while result == WAITS and t < end:
        row, column, height, _, _, cosine = at
        v_row, v_column, rise = _velocity(path, at)
        if height > _SKY_M:
            t = end if rise >= 0.0 else t + max((height - _SKY_M) / -rise, 1e-3)
            at = _place(path, t)
            continue
        tile, slot, (a, b), low, high, edges = _box_at(grid, row, column, height)
        top, bottom, left, right = edges
        if slot == -2:
            state.wanted[ray] = tile
            break
        over, under = height > high + _ABOUT_BLOCK_M, height < low
        near = not (over or under)
        if near:  # one cell, of which the corners are looked at
            top, left = math.floor(row), math.floor(column)
            bottom, right = top + 1.0, left + 1.0
        step = min(_exit(top, bottom, row, v_row), _exit(left, right, column, v_column))
        f = f_1 = f_turn = height - high if over else height - low
        step = min(step * (1.0 - _FASTER * min(step, end - t) * cosine / path.r_e), end - t)
        if over and rise < 0.0:
            step = min(step, f / -rise + _CLOSE_M)
        if under and rise > 0.0:
            step = min(step, -f / rise + _CLOSE_M)
        patch, after = (grid.tiles, slot, a, b, top, left), _place(path, t + step)
        t_turn, square = t, 0.0
        if near:
            f, f_1, t_turn, f_turn, square = _in_patch(path, patch, (t, t + step), at, after)
        if math.isnan(f) or (over and under):
            gap = True
            t, at = t + step, after
            continue
        now = 1 if f > (_CLOSE_M if side < 0 else 0.0) else -1
        result = _change(side, now, gap, t)
        side, gap = now, False
        if result == LANDED:  # at a step of the terrain
            state.distance[ray], state.height[ray], state.factor[ray] = t, height, 1.0
            landed, result = True, WAITS
        elif near and not landed and (f_1 <= 0.0 or f_turn <= 0.0) and result == WAITS:
            share = (t_turn - t) / step
            found = _crossing(path, patch, (t, t_turn), (f, f_turn), square * share * share)
            state.distance[ray], state.height[ray] = found
            state.factor[ray] = abs((after[2] - height) * share / (f_turn - f))
            landed, f_turn = True, f_1
        if landed and result == WAITS:
            side = -1
            if max(f_1, f_turn) > _CLOSE_M:
                result = EMERGES
            elif f_1 < -_DEEP_M:
                result = LANDED
        t, at = t + step, after
    if t >= end and result == WAITS:
        result = LANDED if landed else (PASSES if side != 0 and not gap else NO_TERRAIN)
    state.t[ray], state.side[ray], state.gap[ray], state.result[ray] = t, side, gap, result


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays that ``which`` numbers over a `TerrainGrid`, from where they are.

    ``rays`` is a `TerrainRays`; the columns of ``state``, a `TerrainState`, are changed.
    """
    row, column, easts, norths = np.ones((4, CHART_DEGREE + 1))
    for i in which:
        row[:] = column[:] = 0.0
        chart, term = rays.chart[i], 0
        east, north = rays.east[i] / rays.reach[chart], rays.north[i] / rays.reach[chart]
        for power in range(CHART_DEGREE):
            easts[power + 1], norths[power + 1] = east * easts[power], north * norths[power]
        for degree in range(CHART_DEGREE + 1):
            for power in range(degree + 1):
                share = easts[degree - power] * norths[power]
                row[degree] += rays.charts[chart, 0, term] * share
                column[degree] += rays.charts[chart, 1, term] * share
                term += 1
        h_c, r_e = rays.h_c[i], rays.r_e[i]
        knot, bend = rays.knot[i], rays.bend[i]
        path = _Path(rays.sin_c[i], rays.cos_c[i], h_c, r_e, r_e + h_c, knot, bend, row, column)
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
            least, most = np.inf, -np.inf
            for i in range(k * BLOCK, (k + 1) * BLOCK + 1):
                for j in range(m * BLOCK, (m + 1) * BLOCK + 1):
                    if tile[i, j] < least:
                        least = tile[i, j]
                    if tile[i, j] > most:
                        most = tile[i, j]
            low[k, m], high[k, m] = least, most
