"""Gyer 1996, Figure 9: refraction in a standard minus that in air of a season and latitude."""

import numpy as np
from matplotlib.figure import Figure

from unbend.atmosphere import standard_atmosphere, standard_names
from unbend.refraction import refraction_angle
from unbend.units import ARCSEC

SIZE = (8.2, 4.2)
HEIGHTS_KM = np.arange(1.0, 26.0)
SHOWN_KM = (3.0, 6.0, 10.0, 20.0)
ANGLES_DEG = (45, 85)
RADIUS_M = 6_378_000.0
NAMES = [name for name in standard_names() if name.startswith("supplements1966")]


def refraction(name: str, degrees: float) -> np.ndarray:
    """R [arcsec] in an atmosphere, from cameras at `HEIGHTS_KM` to the sea."""
    air = standard_atmosphere(name, index="gyer")
    h_c = 1000.0 * HEIGHTS_KM
    zeta = np.radians(degrees)
    return refraction_angle(air, h_c, 0.0, zeta, RADIUS_M) / ARCSEC


def difference(name: str, degrees: float) -> np.ndarray:
    """R in US 1976 less R in another atmosphere [arcsec], cameras at `HEIGHTS_KM`."""
    return refraction("us1976", degrees) - refraction(name, degrees)


def label(name: str) -> str:
    """15N annual, 75N January, ..."""
    place, season = name.split("_")[1:]
    return f"{place.upper()} {season.capitalize()}"


def rows() -> list[list[str]]:
    head = ["US 1976 minus"]
    for degrees in ANGLES_DEG:
        head += [f"{degrees}° from {h:.0f} km [arcsec]" for h in SHOWN_KM]
    table = [head]
    is_shown = np.isin(HEIGHTS_KM, SHOWN_KM)
    for name in NAMES:
        row = [label(name)]
        for degrees in ANGLES_DEG:
            row += [f"{value:+.2f}" for value in difference(name, degrees)[is_shown]]
        table.append(row)
    return table


def draw(figure: Figure, table: list[list[str]]) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    for axis, degrees in zip((left, right), ANGLES_DEG, strict=True):
        for name in NAMES:
            arcsec = difference(name, degrees)
            dash = "--" if "july" in name else "-"
            axis.plot(arcsec, HEIGHTS_KM, dash, lw=1.4, label=label(name))
        axis.set_title(f"nadir angle {degrees}°")
        axis.set_xlabel("R in US 1976 minus R there [arcsec]")
    left.set_ylabel("height of the camera [km]")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside right center",
        fontsize=8,
    )
