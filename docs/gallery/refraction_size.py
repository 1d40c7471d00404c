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


def effect(h_c: float, degrees: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shift of a point on the axis of a camera that looks there [px], and metres on the ground."""
    zeta = np.radians(degrees)
    r_c = refraction_angle(standard_atmosphere(), h_c, 0.0, zeta, RADIUS_M)
    return FOCAL_PX * np.tan(r_c), abs(ground_displacement(h_c, 0.0, zeta, r_c, RADIUS_M))


def rows() -> list[list[str]]:
    found = [["camera above the ground", *(f"{angle}°" for angle in ANGLES_DEG)]]
    for h_c in HEIGHTS_M:
        pixels, metres = effect(float(h_c), np.array(ANGLES_DEG, float))
        cells = (f"{p:.3f} px, {m:.3f} m" for p, m in zip(pixels, metres, strict=True))
        found.append([f"{h_c} m", *cells])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    angle = np.linspace(1.0, 80.0, 160)
    height = np.geomspace(50.0, 10_000.0, 80)
    pixels, metres = (
        np.array(both) for both in zip(*(effect(h, angle) for h in height), strict=True)
    )
    panels = (
        (pixels, "image shift [px], f = 20,000 px", BLUE, (0.01, 0.03, 0.1, 0.3, 1, 3, 10)),
        (metres, "metres on the ground", ORANGE, (0.001, 0.01, 0.1, 1, 10)),
    )
    axes: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    for axis, (values, title, colour, levels) in zip(axes, panels, strict=True):
        lines = axis.contour(angle, height, values, levels=levels, colors=colour, linewidths=1.3)
        axis.clabel(lines, fmt="%g", fontsize=8, colors=axis.xaxis.label.get_color())
        axis.set_yscale("log")
        axis.set_title(title)
        axis.set_xlabel("nadir angle [°]")
    axes[0].set_ylabel("height of the camera above the ground [m]")
    axes[0].set_yticks([50, *HEIGHTS_M], ["50", *(f"{h}" for h in HEIGHTS_M)])
    axes[0].minorticks_off()
