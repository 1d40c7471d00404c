"""Figures of the page: values become paths of an SVG, and the numbers along its axes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.report.figure_data import Limits
from unbend.tables.manifest.results import ShiftField
from unbend.units import Array, round_step

Range = tuple[float, float]
Tick = tuple[float, str]
"""A value on an axis, and the text beside it."""

DAY_S = 86_400
STEPS_WITHIN_A_DAY_S = (
    1,
    2,
    5,
    10,
    20,
    30,
    60,
    120,
    300,
    600,
    1200,
    1800,
    3600,
    7200,
    14_400,
    21_600,
    43_200,
)
MAX_DECADES = 7  # with a number of their own on a logarithmic axis

ARROW_HEAD_BACK = 0.34  # of an arrow's length, from its tip
ARROW_HEAD_SIDE = 0.2  # of an arrow's length, to each side
LONGEST_ARROW = 0.92  # of the width of a cell: neighbours do not touch
REFERENCE_ARROW = 2.2  # the longest arrow is at most so many times the arrow for reference

MAP_LEFT_PX = 62.0  # the numbers of the latitudes are there
MAP_RIGHT_PX = 10.0
MAP_TOP_PX = 22.0
MAX_MAP_HEIGHT = 0.9  # of the width of the page
MIN_MAP_HEIGHT = 0.35  # of its width: a single strip is no line
MAP_MARGIN = 1.1  # times what the places extend over
MIN_EXTENT_DEG = 2e-4  # 22 m: a single place has a map too
METRES_A_DEGREE = 111_200.0  # of a great circle


class PlotArea(NamedTuple):
    """The rectangle of a figure within its axes [px]."""

    left: float
    top: float
    width: float
    height: float


class Axes:
    """``box`` is left, top, width, height [px]; ``x``, ``y`` limits; ``log_x`` to powers of ten."""

    def __init__(self, box: Sequence[float], x: Range, y: Range, *, log_x: bool = False) -> None:
        self.box = PlotArea(*box)
        self.log_x = log_x
        if log_x:
            x = whole_decades(x)
        self.x = widened(x)
        self.y = widened(y)

    def at(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Pixels of places, to the right and down."""
        values = np.asarray(x, np.float64)
        low, high = self.x
        if self.log_x:
            with np.errstate(divide="ignore", invalid="ignore"):
                values = np.log10(values)
            low = math.log10(low)
            high = math.log10(high)
        across = np.asarray((values - low) / (high - low))
        bottom, top = self.y
        up = (np.asarray(y, np.float64) - bottom) / (top - bottom)
        right_px = self.box.left + self.box.width * across
        down_px = self.box.top + self.box.height * (1.0 - up)
        return right_px, down_px

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of one place, to a tenth."""
        across, down = self.at(x, y)
        return round(float(across), 1), round(float(down), 1)

    def line(self, x: ArrayLike, y: ArrayLike, end: str = "") -> str:
        """A line through places (n,), with gaps; ``end`` Z to close it.

        >>> Axes((0, 0, 4, 4), (0, 4), (4, 0)).line([0, 1, np.nan, 3, 4], np.zeros(5))
        'M0.0 0.0L1.0 0.0M3.0 0.0L4.0 0.0'
        """
        across, down = self.at(x, y)
        path = ""
        pen = "M"
        for right_px, down_px in zip(across.tolist(), down.tolist(), strict=True):
            if math.isfinite(right_px) and math.isfinite(down_px):
                path += f"{pen}{right_px:.1f} {down_px:.1f}"
                pen = "L"
            else:
                pen = "M"
        if path:
            path += end
        return path

    def marks(self, x: ArrayLike, y: ArrayLike, mark: str = "h0") -> str:
        """A mark at each known place (n,), drawn from there; a dot by default."""
        across, down = self.at(x, y)
        places = np.column_stack([np.atleast_1d(across), np.atleast_1d(down)])
        is_known = np.isfinite(places).all(axis=1)
        path = ""
        for right_px, down_px in places[is_known]:
            path += f"M{right_px:.1f} {down_px:.1f}{mark}"
        return path

    def areas(self, corners: Array) -> str:
        """Closed areas (m, k, 2) of x and y."""
        path = ""
        for area in corners:
            path += self.line(area[:, 0], area[:, 1], "Z")
        return path

    def band(self, low: Array, high: Array, y: Array) -> str:
        """What lies between two curves (n,) against ``y``."""
        around_x = np.concatenate([low, high[::-1]])
        around_y = np.concatenate([y, y[::-1]])
        return self.line(around_x, around_y, "Z")

    def bars(self, first: float, step: float, counts: Sequence[float]) -> str:
        """A bar from zero for each count."""
        limits = first + step * np.arange(len(counts) + 1.0)
        edges, zero = self.at(limits, 0.0)
        _, tops = self.at(0.0, np.array(counts, np.float64))
        path = ""
        for left, right, top in zip(edges[:-1], edges[1:], tops, strict=True):
            if top < zero:
                path += f"M{left + 0.5:.1f} {zero:.1f}V{top:.1f}H{right - 0.5:.1f}V{zero:.1f}Z"
        return path

    def ticks(self, limits: Range, most: int, begin_ns: int | None = None) -> list[Tick]:
        """Round values of an axis, texts; times of day of seconds after ``begin_ns`` [Unix ns].

        >>> Axes((0, 0, 1, 1), (0.13, 0.42), (0, 1)).ticks((0.13, 0.42), 4)
        [(0.2, '0.2'), (0.3, '0.3'), (0.4, '0.4')]
        """
        low = min(limits)
        high = max(limits)
        if begin_ns is not None:
            return ticks_of_time(low, high, most, begin_ns)
        if self.log_x and limits == self.x:
            return ticks_of_decades(low, high)
        return ticks_of_numbers(low, high, most)


def whole_decades(limits: Range) -> Range:
    """Limits of a logarithmic axis: the powers of ten around positive ones."""
    low, high = limits
    below = math.floor(math.log10(low))
    above = math.ceil(math.log10(high))
    return 10.0**below, 10.0**above


def widened(limits: Range) -> Range:
    """Limits that differ: half a unit to each side of a single value."""
    low, high = limits
    if high == low:
        return low - 0.5, high + 0.5
    return low, high


def ticks_of_numbers(low: float, high: float, most: int) -> list[Tick]:
    """Multiples of 1, 2 or 5 times a power of ten, at least a ``most``-th of the axis apart."""
    step = round_step((high - low) / most)
    digits = max(0, -math.floor(math.log10(step)))
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    ticks = []
    for multiple in range(first, last + 1):
        value = multiple * step
        ticks.append((round(value, digits), f"{value:,.{digits}f}"))
    return ticks


def ticks_of_decades(low: float, high: float) -> list[Tick]:
    """Powers of ten; every second, third, ... on a long axis."""
    first = round(math.log10(low))
    last = round(math.log10(high))
    exponents = range(first, last + 1)
    every = math.ceil(len(exponents) / MAX_DECADES)
    ticks = []
    for exponent in exponents[::every]:
        value = 10.0**exponent
        ticks.append((value, f"{value:.12g}"))
    return ticks


def ticks_of_time(low_s: float, high_s: float, most: int, begin_ns: int) -> list[Tick]:
    """Round times of day [s after ``begin_ns``], or dates where a step takes whole days."""
    step_s = time_step((high_s - low_s) / most)
    if step_s >= DAY_S:
        shown = slice(5, 10)  # month and day of 2026-11-28T21:34:09
    elif step_s >= 60:
        shown = slice(11, 16)  # hours and minutes
    else:
        shown = slice(11, 19)  # seconds too
    from_s = begin_ns * 1e-9 + low_s
    first_s = -(-int(from_s) // step_s) * step_s
    last_s = int(from_s + high_s - low_s)
    ticks = []
    for unix_s in range(first_s, last_s + 1, step_s):
        text = str(np.datetime64(unix_s, "s"))
        ticks.append((unix_s - begin_ns * 1e-9, text[shown]))
    return ticks


def time_step(least_s: float) -> int:
    """The smallest round step of time [s] that is not below ``least_s``.

    >>> time_step(70.0), time_step(100_000.0)
    (120, 172800)
    """
    for step_s in STEPS_WITHIN_A_DAY_S:
        if step_s >= least_s:
            return step_s
    return DAY_S * math.ceil(least_s / DAY_S)


def arrows(x: ArrayLike, y: ArrayLike, dx: ArrayLike, dy: ArrayLike) -> str:
    """Arrows (n,) from pixels by pixels, each with a head of a third of its length."""
    columns = [np.atleast_1d(column).tolist() for column in (x, y, dx, dy)]
    path = ""
    for values in zip(*columns, strict=True):
        path += arrow(*values)
    return path


def arrow(x: float, y: float, dx: float, dy: float) -> str:
    """A shaft, and two lines that go back from its tip."""
    tip = f"{x + dx:.1f} {y + dy:.1f}"
    path = f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
    for side in (ARROW_HEAD_SIDE, -ARROW_HEAD_SIDE):
        head_dx = -ARROW_HEAD_BACK * dx - side * dy
        head_dy = -ARROW_HEAD_BACK * dy + side * dx
        path += f"l{head_dx:.1f} {head_dy:.1f}M{tip}"
    return path


def field_arrows(axes: Axes, field: ShiftField) -> tuple[str, str, float]:
    """Arrows of a mean shift over an image, the longest 0.92 of a cell long; one for reference.

    Returns both paths, the second an arrow at the upper left, and the shift that it stands for
    [px], with one digit of 1, 2 or 5.
    """
    dx = np.array(field.dx_px)
    dy = np.array(field.dy_px)
    longest = float(np.hypot(dx, dy).max()) or 1.0
    scale = LONGEST_ARROW * axes.box.width / field.columns / longest
    x, y = axes.at(np.array(field.x_px), np.array(field.y_px))
    shifts = arrows(x, y, dx * scale, dy * scale)
    reference = round_step(longest / REFERENCE_ARROW)
    example = arrow(axes.box.left + 44.0, axes.box.top - 11.0, reference * scale, 0.0)
    return shifts, example, reference


def map_axes(limits_deg: Limits, width: float) -> tuple[Axes, float]:
    """Axes of west, east, south, north [deg] at equal scale, ``width`` wide, and metres across."""
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    lon = 0.5 * (west + east)
    lat = 0.5 * (south + north)
    shrink = max(math.cos(math.radians(lat)), 0.01)  # of a degree of longitude, from the equator
    map_width = width - (MAP_LEFT_PX + MAP_RIGHT_PX)
    across_deg = max(MAP_MARGIN * (east - west) * shrink, MIN_EXTENT_DEG)
    down_deg = max(MAP_MARGIN * (north - south), MIN_EXTENT_DEG, MIN_MAP_HEIGHT * across_deg)
    across_deg = max(across_deg, down_deg * map_width / (MAX_MAP_HEIGHT * width))
    map_height = round(map_width * down_deg / across_deg, 1)
    half_lon = 0.5 * across_deg / shrink
    half_lat = 0.5 * down_deg
    box = PlotArea(left=MAP_LEFT_PX, top=MAP_TOP_PX, width=map_width, height=map_height)
    axes = Axes(
        box,
        x=(lon - half_lon, lon + half_lon),
        y=(lat - half_lat, lat + half_lat),
    )
    return axes, across_deg * METRES_A_DEGREE
