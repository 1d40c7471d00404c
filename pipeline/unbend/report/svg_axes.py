"""Figures of the page: converts values to SVG paths, and finds the numbers along axes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from unbend.report.figure_data import Limits
from unbend.tables.manifest.results import ShiftField
from unbend.units import Array, round_step

Range = tuple[float, float]
"""The value at the left or lower end of an axis, and at the other end."""

Tick = tuple[float, str]
"""A value on an axis, and the text that is written there."""

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
MAX_DECADES = 7  # powers of ten with a number on a logarithmic axis

ARROW_HEAD_BACK = 0.34  # how far a head goes back from the tip, as a share of the arrow's length
ARROW_HEAD_SIDE = 0.2  # how far it goes to each side
LONGEST_ARROW = 0.92  # of the width of a cell: neighbours do not touch
REFERENCE_ARROW = 2.2  # length of the longest arrow over that of the reference, before rounding

MAP_LEFT_PX = 62.0  # left of the map, for the numbers of the latitudes
MAP_RIGHT_PX = 10.0  # right of the map
MAP_TOP_PX = 22.0  # above the map
MAX_MAP_HEIGHT = 0.9  # of the width of the figure
MIN_MAP_HEIGHT = 0.35  # of the width of the map: a single strip would be a line
MAP_MARGIN = 1.1  # extent of the map over that of the places on it
MIN_EXTENT_DEG = 2e-4  # 22 m: a single place has a map too
METRES_A_DEGREE = 111_200.0  # of a great circle


class PlotArea(NamedTuple):
    """The rectangle of a figure within its axes [px]."""

    left: float
    top: float
    width: float
    height: float


class Axes:
    """The axes of a figure: converts values x, y to pixels and to paths of SVG.

    ``box`` is left, top, width and height of the plot [px], ``x`` and ``y`` are the limits of the
    axes. With ``log_x`` the x axis is logarithmic, and its limits are extended to powers of ten.
    """

    def __init__(self, box: Sequence[float], x: Range, y: Range, *, log_x: bool = False) -> None:
        self.box = PlotArea(*box)
        self.log_x = log_x
        if log_x:
            x = whole_decades(x)
        self.x = separated(x)
        self.y = separated(y)

    def to_pixels(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Convert values (n,) to pixels, to the right and down from the corner of the figure."""
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
        """The pixel of one pair of values, to the right and down, rounded to a tenth."""
        across, down = self.to_pixels(x, y)
        return round(float(across), 1), round(float(down), 1)

    def line(self, x: ArrayLike, y: ArrayLike, end: str = "") -> str:
        """The path of a line through values (n,), with gaps at NaN; ``end`` "Z" closes it.

        >>> Axes((0, 0, 4, 4), (0, 4), (4, 0)).line([0, 1, np.nan, 3, 4], np.zeros(5))
        'M0.0 0.0L1.0 0.0M3.0 0.0L4.0 0.0'
        """
        across, down = self.to_pixels(x, y)
        path = ""
        pen = "M"  # SVG: move to the first place, and after a gap; L draws a line to the next
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
        """The path of a mark at each pair of values (n,) that is known.

        ``mark`` are SVG commands relative to its place; "h0" is a line without length, a dot.
        """
        across, down = self.to_pixels(x, y)
        places = np.column_stack([np.atleast_1d(across), np.atleast_1d(down)])
        is_known = np.isfinite(places).all(axis=1)
        path = ""
        for right_px, down_px in places[is_known]:
            path += f"M{right_px:.1f} {down_px:.1f}{mark}"
        return path

    def areas(self, corners: Array) -> str:
        """The path of m closed areas with corners (m, k, 2), x and y."""
        path = ""
        for area in corners:
            path += self.line(area[:, 0], area[:, 1], "Z")
        return path

    def band(self, low: Array, high: Array, y: Array) -> str:
        """The path of the area between two curves: x is ``low`` and ``high`` (n,) at ``y`` (n,)."""
        around_x = np.concatenate([low, high[::-1]])
        around_y = np.concatenate([y, y[::-1]])
        return self.line(around_x, around_y, "Z")

    def bars(self, first: float, step: float, counts: Sequence[float]) -> str:
        """The path of a histogram: a bar for each count, in bins of ``step`` from ``first`` on.

        Counts of zero have no bar.
        """
        limits = first + step * np.arange(len(counts) + 1.0)
        edges, zero = self.to_pixels(limits, 0.0)
        _, tops = self.to_pixels(0.0, np.array(counts, np.float64))
        path = ""
        for left, right, top in zip(edges[:-1], edges[1:], tops, strict=True):
            if top < zero:
                path += f"M{left + 0.5:.1f} {zero:.1f}V{top:.1f}H{right - 0.5:.1f}V{zero:.1f}Z"
        return path

    def ticks(self, limits: Range, most: int, begin_ns: int | None = None) -> list[Tick]:
        """Round values between limits with their texts, about ``most`` of them.

        ``limits`` are those of one of the two axes. If they are seconds after ``begin_ns``
        [Unix ns], the texts are times of day or dates.

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
    """Positive limits extended to powers of ten."""
    low, high = limits
    below = math.floor(math.log10(low))
    above = math.ceil(math.log10(high))
    return 10.0**below, 10.0**above


def separated(limits: Range) -> Range:
    """The limits, or if they are equal, those of half a unit to each side."""
    low, high = limits
    if high == low:
        return low - 0.5, high + 0.5
    return low, high


def ticks_of_numbers(low: float, high: float, most: int) -> list[Tick]:
    """Ticks at the multiples of a step of 1, 2 or 5 times a power of ten.

    The step is at least the range divided by ``most``.
    """
    step = round_step((high - low) / most)
    digits = max(0, -math.floor(math.log10(step)))
    first = math.ceil(low / step - 1e-9)  # a limit that is a multiple but for rounding counts
    last = math.floor(high / step + 1e-9)
    ticks = []
    for multiple in range(first, last + 1):
        value = multiple * step
        ticks.append((round(value, digits), f"{value:,.{digits}f}"))
    return ticks


def ticks_of_decades(low: float, high: float) -> list[Tick]:
    """Ticks at powers of ten; on a long axis only at every second, third, ..."""
    first = round(math.log10(low))
    last = round(math.log10(high))
    exponents = range(first, last + 1)
    stride = math.ceil(len(exponents) / MAX_DECADES)
    ticks = []
    for exponent in exponents[::stride]:
        value = 10.0**exponent
        ticks.append((value, f"{value:.12g}"))
    return ticks


def ticks_of_time(low_s: float, high_s: float, most: int, begin_ns: int) -> list[Tick]:
    """Ticks at round times of day, or at dates if a step is whole days.

    ``low_s``, ``high_s`` and the values of the ticks are seconds after ``begin_ns`` [Unix ns].
    """
    step_s = time_step((high_s - low_s) / most)
    if step_s >= DAY_S:
        shown = slice(5, 10)  # month and day of 2026-11-28T21:34:09
    elif step_s >= 60:
        shown = slice(11, 16)  # hours and minutes
    else:
        shown = slice(11, 19)  # seconds too
    from_s = begin_ns * 1e-9 + low_s
    first_s = -(-int(from_s) // step_s) * step_s  # rounded up to a multiple of the step
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
    """The path of arrows from the pixels ``x``, ``y`` (n,) by ``dx``, ``dy`` (n,) [px]."""
    columns = [np.atleast_1d(column).tolist() for column in (x, y, dx, dy)]
    path = ""
    for values in zip(*columns, strict=True):
        path += arrow(*values)
    return path


def arrow(x: float, y: float, dx: float, dy: float) -> str:
    """The path of one arrow from x, y by dx, dy [px]: a shaft, and two lines back from its tip."""
    tip = f"{x + dx:.1f} {y + dy:.1f}"
    path = f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
    for side in (ARROW_HEAD_SIDE, -ARROW_HEAD_SIDE):
        head_dx = -ARROW_HEAD_BACK * dx - side * dy
        head_dy = -ARROW_HEAD_BACK * dy + side * dx
        path += f"l{head_dx:.1f} {head_dy:.1f}M{tip}"
    return path


def field_arrows(axes: Axes, field: ShiftField) -> tuple[str, str, float]:
    """Arrows of the mean shifts over an image, and an arrow above it for reference.

    Returns the paths of both, and the shift that the reference arrow represents [px]: 1, 2 or 5
    times a power of ten. The longest arrow has 0.92 of the width of a cell.
    """
    dx = np.array(field.dx_px)
    dy = np.array(field.dy_px)
    longest = float(np.hypot(dx, dy).max()) or 1.0
    scale = LONGEST_ARROW * axes.box.width / field.columns / longest
    x, y = axes.to_pixels(np.array(field.x_px), np.array(field.y_px))
    shifts = arrows(x, y, dx * scale, dy * scale)
    reference = round_step(longest / REFERENCE_ARROW)
    example = arrow(axes.box.left + 44.0, axes.box.top - 11.0, reference * scale, 0.0)
    return shifts, example, reference


def map_axes(limits_deg: Limits, width: float) -> tuple[Axes, float]:
    """The axes of a map with equal scale in both directions, and the metres that it is wide.

    ``limits_deg`` are those of the places on it, ``width`` is that of the figure [px].
    """
    west, east = limits_deg[:2]
    south, north = limits_deg[2:]
    lon = 0.5 * (west + east)
    lat = 0.5 * (south + north)
    # Length of a degree of longitude over that of a degree of latitude; not 0 at the poles.
    shrink = max(math.cos(math.radians(lat)), 0.01)
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
