"""Gyer 1996, Figure 9: refraction in a standard minus that in air of a season and latitude."""

import numpy as np
from matplotlib.figure import Figure

from unbend.atmosphere import standard_atmosphere, standard_names
from unbend.refraction import refraction_angle
from unbend.units import ARCSEC

SIZE = (8.2, 4.2)
HEIGHTS = np.arange(1.0, 26.0)
NAMES = [name for name in standard_names() if name.startswith("supplements1966")]
SHOWN = (3.0, 6.0, 10.0, 20.0)


def difference(name: str, degrees: float) -> np.ndarray:
    """R in US 1976 less R in another atmosphere [arcsec], cameras at `HEIGHTS` [km]."""
    ray = (1000.0 * HEIGHTS, 0.0, np.radians(degrees), 6_378_000.0)
    standard, other = (standard_atmosphere(n, index="gyer") for n in ("us1976", name))
    return (refraction_angle(standard, *ray) - refraction_angle(other, *ray)) / ARCSEC


def label(name: str) -> str:
    """15N annual, 75N January, ..."""
    place, season = name.split("_")[1:]
    return f"{place.upper()} {season.capitalize()}"


def rows() -> list[list[str]]:
    head = [f"{angle}° from {h:.0f} km [arcsec]" for angle in (45, 85) for h in SHOWN]
    found = [["US 1976 minus", *head]]
    for name in NAMES:
        values = [difference(name, angle)[h == HEIGHTS][0] for angle in (45, 85) for h in SHOWN]
        found.append([label(name), *(f"{value:+.2f}" for value in values)])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    for axis, degrees in zip(figure.subplots(1, 2, sharey=True), (45, 85), strict=True):
        for name in NAMES:
            dash = "--" if "july" in name else "-"
            axis.plot(difference(name, degrees), HEIGHTS, dash, lw=1.4, label=label(name))
        axis.set_title(f"nadir angle {degrees}°")
        axis.set_xlabel("R in US 1976 minus R there [arcsec]")
    figure.axes[0].set_ylabel("height of the camera [km]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=8)
