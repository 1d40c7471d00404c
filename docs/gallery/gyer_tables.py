"""Gyer 1996, Tables 3 and 4: printed minus exact, and minus his own method."""

import numpy as np
from matplotlib.figure import Figure

from docs.gallery.plates import COLOURS
from unbend.refraction.printed_tables import paper_tables

SIZE = (8.2, 3.6)
ANGLES_DEG = (45, 60, 75, 80, 85)


def entries(degrees: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights of the camera [km], printed minus exact, printed minus as published [arcsec]."""
    columns = paper_tables("gyer1996").columns
    is_table = columns["table"] == "3-4"
    used = is_table & (columns["zeta_c_deg"] == degrees)
    height_km = columns["h_c_m"][used] / 1000.0
    printed = columns["printed"][used]
    minus_exact = printed - columns["exact"][used]
    minus_published = printed - columns["as_published"][used]
    return height_km, minus_exact, minus_published


def rows() -> list[list[str]]:
    table = [["nadir angle", "entries", "largest error [arcsec]", "left with his step [arcsec]"]]
    for degrees in ANGLES_DEG:
        height_km, minus_exact, minus_published = entries(degrees)
        row = [
            f"{degrees}°",
            f"{height_km.size}",
            f"{abs(minus_exact).max():.3f}",
            f"{abs(minus_published).max():.3f}",
        ]
        table.append(row)
    return table


def draw(figure: Figure, table: list[list[str]]) -> None:
    left, right = figure.subplots(1, 2, sharex=True)
    for colour, degrees in zip(COLOURS, ANGLES_DEG, strict=False):
        height_km, minus_exact, minus_published = entries(degrees)
        error = np.maximum(abs(minus_exact), 1e-3)
        left.plot(height_km, error, ".", color=colour, label=f"{degrees}°")
        right.plot(height_km, minus_published, ".", color=colour)
    left.set_yscale("log")
    left.set_title("printed minus exact")
    left.set_ylabel("arcsec, without sign")
    left.set_xlabel("height of the camera [km]")
    right.set_title("printed minus his method, in steps of 1 km")
    right.set_ylabel("arcsec")
    right.set_ylim(-0.02, 0.02)
    right.set_xlabel("height of the camera [km]")
    figure.legend(loc="outside right center", title="nadir angle")
