"""Size of refraction by height and nadir angle, in pixels and in metres."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.gallery.plates import BLUE, ORANGE
from unbend.atmosphere import standard_atmosphere
from unbend.refraction import refraction_angle
from unbend.refraction.image import ground_displacement

SIZE = (8.2, 3.8)
FOCAL_PX = 20_000.0
RADIUS_M = 6_371_000.0
HEIGHTS_M = (120, 500, 1000, 3000, 6000, 10_000)
ANGLES_DEG = (15, 30, 45, 60, 75)
LEVELS_PX = (0.01, 0.03, 0.1, 0.3, 1, 3, 10)
LEVELS_M = (0.001, 0.01, 0.1, 1, 10)


def effect(height: np.ndarray | int, degrees: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
    """Shift of a point on the axis of a camera that looks there [px], and metres on the ground."""
    h_c = np.array(height, float)
    zeta = np.radians(degrees)
    air = standard_atmosphere()
    r_c = refraction_angle(air, h_c, 0.0, zeta, RADIUS_M)
    shift_px = FOCAL_PX * np.tan(r_c)
    metres = ground_displacement(h_c, 0.0, zeta, r_c, RADIUS_M)
    return shift_px, abs(metres)


def rows() -> list[list[str]]:
    head = ["camera above the ground", *(f"{angle}°" for angle in ANGLES_DEG)]
    table = [head]
    for height in HEIGHTS_M:
        row = [f"{height} m"]
        for angle in ANGLES_DEG:
            shift_px, metres = effect(height, angle)
            row.append(f"{shift_px:.3f} px, {metres:.3f} m")
        table.append(row)
    return table


def contours(axis: Axes, values: np.ndarray, levels: tuple[float, ...], colour: str) -> None:
    """Lines of equal values (heights, angles) with their numbers."""
    lines = axis.contour(
        *grid(),
        values,
        levels=levels,
        colors=colour,
        linewidths=1.3,
    )
    axis.clabel(
        lines,
        fmt="%g",
        fontsize=8,
        colors=axis.xaxis.label.get_color(),
    )
    axis.set_yscale("log")
    axis.set_xlabel("nadir angle [°]")


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Nadir angles [degree] and heights [m] of the contours."""
    return np.linspace(1.0, 80.0, 160), np.geomspace(50.0, 10_000.0, 80)


def draw(figure: Figure, table: list[list[str]]) -> None:
    angle, height = grid()
    shift_px, metres = effect(height[:, None], angle)
    left, right = figure.subplots(1, 2, sharey=True)
    contours(left, shift_px, LEVELS_PX, BLUE)
    contours(right, metres, LEVELS_M, ORANGE)
    left.set_title("image shift [px], f = 20,000 px")
    right.set_title("metres on the ground")
    left.set_ylabel("height of the camera above the ground [m]")
    ticks = [50, *HEIGHTS_M]
    left.set_yticks(ticks, [str(tick) for tick in ticks])
    left.minorticks_off()
