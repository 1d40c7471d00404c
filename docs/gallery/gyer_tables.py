"""Gyer 1996, Tables 3 and 4: printed minus exact, and minus his own method."""

import numpy as np
from matplotlib.figure import Figure

from docs.gallery.plates import COLOURS
from unbend.refraction.printed_tables import paper_tables

SIZE = (8.2, 3.6)
ANGLES = (45, 60, 75, 80, 85)


def entries(degrees: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights of the camera [km], printed minus exact, printed minus as published [arcsec]."""
    columns = paper_tables("gyer1996").columns
    used = (columns["table"] == "3-4") & (columns["zeta_c_deg"] == degrees)
    printed, published, exact, h_c = (
        columns[name][used] for name in ("printed", "as_published", "exact", "h_c_m")
    )
    return h_c / 1000.0, printed - exact, printed - published


def rows() -> list[list[str]]:
    head = ["nadir angle", "entries", "largest error [arcsec]", "left with his step [arcsec]"]
    found = [head]
    for degrees in ANGLES:
        h_c, error, left = entries(degrees)
        numbers = f"{h_c.size}", f"{abs(error).max():.3f}", f"{abs(left).max():.3f}"
        found.append([f"{degrees}°", *numbers])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    left, right = figure.subplots(1, 2, sharex=True)
    for colour, degrees in zip(COLOURS, ANGLES, strict=False):
        h_c, error, rest = entries(degrees)
        left.plot(h_c, np.maximum(abs(error), 1e-3), ".", color=colour, label=f"{degrees}°")
        right.plot(h_c, rest, ".", color=colour)
    left.set_yscale("log")
    left.set_title("printed minus exact")
    left.set_ylabel("arcsec, without sign")
    right.set_title("printed minus his method, in steps of 1 km")
    right.set_ylabel("arcsec")
    right.set_ylim(-0.02, 0.02)
    for axis in (left, right):
        axis.set_xlabel("height of the camera [km]")
    figure.legend(loc="outside right center", title="nadir angle")
