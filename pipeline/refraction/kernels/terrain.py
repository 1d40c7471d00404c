"""Curved rays to the first place where they meet a terrain, compiled.

The terrain is bilinear between the nodes of a grid, which is cut into square tiles; of each tile,
and of blocks of it, the lowest and the highest node are known, so that a ray steps over what it
cannot meet. A ray waits where it needs a tile that is not in memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pipeline.refraction.kernels.columns import (
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
from pipeline.refraction.kernels.jit import entry, jit

# Above all land [m]; and so deep under the ground a ray is not followed any further.
_SKY_M, _DEEP_M = 9_000.0, 500.0

# Steps end this far behind the edge of a cell, in cells.
_BEHIND = 1e-7
_CLOSE_M, _FLAT_M = 1e-6, 1e-8


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
    """Row, column and height at a straight distance from the camera; arc, sine and cosine there."""
    knot, bend = path.knot, path.bend
    angle = bend[-1]
    for k in range(bend.size - 2, -1, -1):
        angle = bend[k] + (t - knot[k]) * angle
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
    return row, column, height, arc, sine, cosine


@jit
def _velocity(path, height, arc, sine, cosine):  # type: ignore[no-untyped-def]
    """Rows, columns and metres of height per metre of the way."""
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
def _surface(corner, row, column):  # type: ignore[no-untyped-def]
    """Height of the bilinear patch at a place in it, counted from its first node."""
    upper = corner[0, 0] + column * (corner[0, 1] - corner[0, 0])
    lower = corner[1, 0] + column * (corner[1, 1] - corner[1, 0])
    return upper + row * (lower - upper)


@jit
def _crossing(path, patch, ends, sides):  # type: ignore[no-untyped-def]
    """Distance and height where a ray meets a patch between two distances, on two sides of it.

    ``sides`` are the heights above it there. Secant and bisection in turn.
    """
    corner, first_row, first_column = patch
    (t_0, t_1), (f_0, f_1) = ends, sides
    t, height = t_0, math.nan
    for turn in range(100):
        t = 0.5 * (t_0 + t_1)
        if turn % 2 == 0:
            t = t_0 - f_0 * (t_1 - t_0) / (f_1 - f_0)
        row, column, height, _, _, _ = _place(path, t)
        f = height - _surface(corner, row - first_row, column - first_column)
        if abs(f) < _FLAT_M or t_1 - t_0 < _CLOSE_M:
            break
        if (f > 0.0) == (f_0 > 0.0):
            t_0, f_0 = t, f
        else:
            t_1, f_1 = t, f
    return t, height


@jit
def _in_patch(path, patch, t, t_1):  # type: ignore[no-untyped-def]
    """Heights above a patch at two distances, the nearest turn of that height between them (or the
    second distance) with what it is there, and the change of the ray's height."""
    corner, first_row, first_column = patch
    row, column, height, _, _, _ = _place(path, t)
    row_1, column_1, height_1, _, _, _ = _place(path, t_1)
    f = height - _surface(corner, row - first_row, column - first_column)
    f_1 = height_1 - _surface(corner, row_1 - first_row, column_1 - first_column)
    twist = corner[0, 0] - corner[0, 1] - corner[1, 0] + corner[1, 1]
    square = -twist * (row_1 - row) * (column_1 - column)
    linear = f_1 - f - square
    t_turn, f_turn = t_1, f_1
    if f * f_1 > 0.0 and square * f > 0.0 and 0.0 < -linear / (2.0 * square) < 1.0:
        share = -linear / (2.0 * square)
        t_turn = t + share * (t_1 - t)
        row, column, height_t, _, _, _ = _place(path, t_turn)
        f_turn = height_t - _surface(corner, row - first_row, column - first_column)
    return f, f_1, t_turn, f_turn, height_1 - height


@jit
def _follow(path, grid, ray, state):  # type: ignore[no-untyped-def]
    """Follow one ray until it is known what becomes of it, or a tile is missing.

    ``ray`` is its number; the columns of ``state`` are changed. ``side`` is 1 above the terrain,
    -1 below, 0 where that is not known yet.
    """
    end, t, side, gap = state.end[ray], state.t[ray], state.side[ray], state.gap[ray]
    landed = not math.isnan(state.height[ray])
    result = NO_TERRAIN
    state.wanted[ray] = -1
    while True:
        if t >= end:
            known = side != 0 and not gap
            result = LANDED if landed else (PASSES if known else NO_TERRAIN)
            break
        row, column, height, arc, sine, cosine = _place(path, t)
        v_row, v_column, rise = _velocity(path, height, arc, sine, cosine)
        if height > _SKY_M:
            if rise >= 0.0:
                t = end
            else:
                t += max((height - _SKY_M) / -rise, 1e-3)
            continue
        # The node before it, and the tile; columns go round the earth.
        first_row, first_column = math.floor(row), math.floor(column)
        turn = 0
        if grid.around > 0:
            turn = math.floor(first_column / grid.around) * grid.around
        i, j = int(first_row), int(first_column - turn)
        tile_row, tile_column = i // TILE, j // TILE
        top, left = tile_row * TILE, tile_column * TILE
        low, high = np.inf, -np.inf
        if 0 <= tile_row < grid.low.shape[0] and 0 <= tile_column < grid.low.shape[1]:
            low, high = grid.low[tile_row, tile_column], grid.high[tile_row, tile_column]
            if math.isnan(low):
                state.wanted[ray] = tile_row * grid.low.shape[1] + tile_column
                result = WAITS
                break
        right = left + TILE
        if grid.around > 0 and right > grid.around:
            right = grid.around
        bottom = top + TILE
        slot = -1
        if low <= height and height <= high:
            slot = grid.slot[tile_row, tile_column]
            if slot < 0:
                state.wanted[ray] = tile_row * grid.low.shape[1] + tile_column
                result = WAITS
                break
            k, m = (i - top) // BLOCK, (j - left) // BLOCK
            low, high = grid.block_low[slot, k, m], grid.block_high[slot, k, m]
            top, left = top + k * BLOCK, left + m * BLOCK
            bottom, right = top + BLOCK, min(left + BLOCK, right)
        step = min(
            _exit(top, bottom, row, v_row), _exit(left + turn, right + turn, column, v_column)
        )
        if not (low <= height and height <= high):  # over or under all of it, as far as the edge
            if low > high:
                gap = True
                t += step
                continue
            now = 1 if height > high else -1
            if now == 1 and rise < 0.0:
                step = min(step, (height - high) / -rise + _CLOSE_M)
            elif now == -1 and rise > 0.0:
                step = min(step, (low - height) / rise + _CLOSE_M)
            if now != side:
                if side == 0 and now == -1:
                    result = NO_TERRAIN if gap or t > 0.0 else HIDDEN
                    break
                if side == 1 and gap:
                    result = NO_TERRAIN
                    break
                if side == 1:
                    state.distance[ray], state.height[ray] = t, height
                    state.factor[ray], landed = 1.0, True
                elif side == -1:
                    result = EMERGES
                    break
                side = now
            gap = False
            if landed and low - height > _DEEP_M:
                result = LANDED
                break
            t += step
            continue
        step = min(
            _exit(first_row, first_row + 1.0, row, v_row),
            _exit(first_column, first_column + 1.0, column, v_column),
        )
        t_1 = min(t + step, end)
        top, left = tile_row * TILE, tile_column * TILE
        corner = grid.tiles[slot, i - top : i - top + 2, j - left : j - left + 2]
        patch = (corner, first_row, first_column)
        f, f_1, t_turn, f_turn, fall = _in_patch(path, patch, t, t_1)
        if math.isnan(f):
            gap = True
            t = t_1
            continue
        now = 1 if f > 0.0 else -1
        if side == 0:
            side = now
            if now == -1:
                result = NO_TERRAIN if gap or t > 0.0 else HIDDEN
                break
        if side == 1 and now == -1:
            if gap:
                result = NO_TERRAIN
                break
            state.distance[ray], state.height[ray] = t, height
            state.factor[ray], landed = 1.0, True
        elif side == -1 and now == 1 and f > _CLOSE_M:
            result = EMERGES
            break
        side, gap = now, False
        if landed:
            if f_1 > _CLOSE_M or f_turn > _CLOSE_M:
                result = EMERGES
                break
            if f_1 < -_DEEP_M:
                result = LANDED
                break
        elif f_1 <= 0.0 or f_turn <= 0.0:
            found = _crossing(path, patch, (t, t_turn), (f, f_turn))
            state.distance[ray], state.height[ray] = found
            share = (t_turn - t) / (t_1 - t)
            state.factor[ray] = abs(fall * share / (f_turn - f))
            landed = True
            if f_1 > _CLOSE_M:
                result = EMERGES
                break
        side = 1 if f_1 > 0.0 and not landed else (-1 if landed else side)
        t = t_1
    state.t[ray], state.side[ray], state.gap[ray], state.result[ray] = t, side, gap, result


@entry
def follow_rays(rays, which, grid, state):  # type: ignore[no-untyped-def]
    """Follow the rays that ``which`` numbers over a `TerrainGrid`, from where they are.

    ``rays`` is a `TerrainRays`; the columns of ``state``, a `TerrainState`, are changed.
    """
    row, column = np.empty(CHART_DEGREE + 1), np.empty(CHART_DEGREE + 1)
    for i in which:
        row[:] = column[:] = 0.0
        chart, term = rays.chart[i], 0
        scale = rays.reach[chart]
        for degree in range(CHART_DEGREE + 1):
            for power in range(degree + 1):
                share = rays.east[i] ** (degree - power) * rays.north[i] ** power / scale**degree
                row[degree] += rays.charts[chart, 0, term] * share
                column[degree] += rays.charts[chart, 1, term] * share
                term += 1
        h_c, r_e = rays.h_c[i], rays.r_e[i]
        path = _Path(
            rays.sin_c[i], rays.cos_c[i], h_c, r_e, r_e + h_c, rays.knot[i], rays.bend[i], row,
            column,
        )  # fmt: skip
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
