"""The tables of the three papers, recomputed: as printed, as published, and exact.

*As published* is the paper's own method, *exact* the spherical kernel of this package in the same
air. `paper_tables` returns columns; the printed figures stand in ``refraction/data``.
"""

import csv
import math
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.layers import stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel, refractivity_gyer
from unbend.refraction import messages
from unbend.refraction.published import saastamoinen
from unbend.refraction.published.gyer import STEP_M, gyer1996, plane_first_term, subtended_angle
from unbend.refraction.ray import bend, refraction_angle
from unbend.refraction.ray_table import RayTable
from unbend.refraction.window import SCHEDULE_TEMPERATURE_K, refract_at_window, scheduled_pressure
from unbend.units import ARCSEC, DEGREE, HECTOPASCAL, MICRORADIAN, Array

GYER_RADIUS_M = BERTRAM_RADIUS_M = 6_378_000.0

_DATA = files("unbend.refraction").joinpath("data")
_DIAGONAL = 45.0 * DEGREE
_PLACES = ("table", "quantity", "unit", "h_c_m", "h_g_m", "zeta_c_deg")
_COLUMNS = (*_PLACES, "printed", "as_published", "exact")

Figures = tuple[str | ArrayLike, ...]
"""What `_COLUMNS` holds for one quantity, to be broadcast."""


def printed_table(name: str) -> dict[str, Array]:
    """A table as printed, by column; ``name`` is a file of ``data/`` without its ending.

    >>> printed_table("gyer1996_table7")["r_cc_arcsec"][-1].item()
    19.44
    """
    rows = list(csv.DictReader(_DATA.joinpath(f"{name}.csv").read_text("ascii").splitlines()))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def gyer_air() -> Profile:
    """The air behind Gyer's Tables 3 to 7.

    The temperatures of ARDC 1959, which his Table 2 shows (its heading says 1976), with M0 and R*
    as he states them after Eq. 53, and Eq. 13. With ARDC's own constants, 5e-5 apart, Table 2 fits
    better and Tables 3 and 4 less well (0.0151 arcsec for 0.0146 at worst; 347 of 440 entries to
    the printed digit for 363).
    """
    ardc = standard_atmosphere("ardc1959", index="gyer")
    edge = ardc.layers.edge
    temperature = ardc.virtual_temperature(ardc.break_heights_m)
    layers = stack_layers(
        edge, temperature, np.zeros(edge.size), ardc.layers.source, anchor=(0.0, 101325.0)
    )
    return Profile(layers, ardc.gravity, IndexModel("gyer"), "gyer1996")


def gyer_rows() -> Iterator[Figures]:
    table = printed_table("gyer1996_table2")
    h = table["h_km"] * 1e3
    ardc = standard_atmosphere("ardc1959", index="gyer")
    for name, unit, key, value in (
        ("temperature", "K", "temperature_k", ardc.temperature(h)),
        ("pressure", "hPa", "pressure_mbar", ardc.pressure(h) / HECTOPASCAL),
        ("n - 1", "1e-6", "refractivity_n_minus_1_e6", ardc.refractivity(h) * 1e6),
    ):
        yield "2", name, unit, h, np.nan, np.nan, table[key], value, np.nan
    air = gyer_air()
    table = printed_table("gyer1996_tables3_4")
    at, ray = rays_of(table, air)
    published, exact = gyer1996(*ray), refraction_angle(*ray)
    yield "3-4", "R_c", "arcsec", *at, table["r_c_arcsec"], published / ARCSEC, exact / ARCSEC
    table = printed_table("gyer1996_table5")  # what the plane form lacks
    at, ray = rays_of(table, air)
    printed = table["r_spherical_minus_plane_arcsec"]
    published = gyer1996(*ray) - plane_first_term(*ray, step=STEP_M)
    exact = refraction_angle(*ray) - plane_first_term(*ray)
    yield "5", "R_c spherical - plane", "arcsec", *at, printed, published / ARCSEC, exact / ARCSEC
    yield from table_6(air)
    yield from table_7(air)


def rays_of(table: dict[str, Array], air: Profile) -> tuple[Figures, tuple[Any, ...]]:
    """The places of the figures of a table, and the arguments of a method for them."""
    at = table["h_c_km"] * 1e3, table["h_g_km"] * 1e3, table["zeta_c_deg"]
    return at, (air, at[0], at[1], at[2] * DEGREE, GYER_RADIUS_M)


def table_6(air: Profile) -> Iterator[Figures]:
    """Table 6, rays that are level at the ground."""
    table = printed_table("gyer1996_table6")
    h_c, h_g = table["h_c_km"] * 1e3, table["h_g_km"] * 1e3
    # Eq. 1 with zeta_g = 90 degrees.
    k = (1.0 + air.refractivity(h_g)) * (GYER_RADIUS_M + h_g)
    zeta_c = np.arcsin(k / ((1.0 + air.refractivity(h_c)) * (GYER_RADIUS_M + h_c)))
    published = gyer1996(air, h_c, h_g, zeta_c, GYER_RADIUS_M)
    # A rounding error above the true angle would already miss the ground; 1e-12 rad is 2e-6 arcsec
    # of R_c here.
    exact = np.asarray(refraction_angle(air, h_c, h_g, zeta_c - 1e-12, GYER_RADIUS_M))
    # His distance is the arc at sea level. It cannot be had from the exact R_c, 1 arcsec of which
    # is 2 km of it.
    theta = subtended_angle(air, h_c, h_g, zeta_c, np.full(h_c.shape, GYER_RADIUS_M), step=STEP_M)
    degrees = zeta_c / DEGREE
    for name, unit, key, first, second in (
        ("zeta_c", "deg", "zeta_c_deg_for_zeta_g_90", degrees, degrees),
        ("distance", "km", "distance_km", GYER_RADIUS_M * theta / 1e3, np.nan),
        ("R_c", "arcsec", "r_c_arcsec", published / ARCSEC, exact / ARCSEC),
    ):
        yield "6", name, unit, h_c, h_g, degrees, table[key], first, second


def table_7(air: Profile) -> Iterator[Figures]:
    """Table 7, the pressurised compartment."""
    table = printed_table("gyer1996_table7")
    h_c = table["h_c_km"] * 1e3
    outside = air.refractivity(h_c)
    cabin = refractivity_gyer(SCHEDULE_TEMPERATURE_K, scheduled_pressure(air.pressure(h_c)))
    ray = np.full((h_c.size, 3), [math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    bent = (air, h_c, 0.0, _DIAGONAL, GYER_RADIUS_M)
    r_c, exact = gyer1996(*bent), np.asarray(refraction_angle(*bent))
    # Eq. 38 with the sign of Eq. 39; tan(zeta_f) = 1.
    r_cc = (cabin - outside) / (1.0 + outside)
    exact_cc = refract_at_window(ray, cabin, outside)[1]
    at = h_c, 0.0, 45.0
    for name, unit, key, size, first, second in (
        ("n_c - 1", "1e-6", "n_c_minus_1_e6", 1e-6, outside, outside),
        ("n_cc - 1", "1e-6", "n_cc_minus_1_e6", 1e-6, cabin, cabin),
        ("R_c", "arcsec", "r_c_arcsec", ARCSEC, r_c, exact),
        ("R_cc", "arcsec", "r_cc_arcsec", ARCSEC, r_cc, exact_cc),
        ("R_c - R_cc", "arcsec", "r_c_minus_r_cc_arcsec", ARCSEC, r_c - r_cc, exact - exact_cc),
    ):
        yield "7", name, unit, *at, table[key], first / size, second / size


def saastamoinen_rows() -> Iterator[Figures]:
    """The compartment at 6000 m, p. 300 (Eq. 9 after Eq. 3a), and the errors he states, p. 297."""
    air, h_c = standard_atmosphere("us1962", index="gyer"), 6000.0
    # He works in whole microradians.
    n_h, n_a = round(79.0 * 472.0 / 249.0), round(79.0 * 747.0 / 278.0)
    r_ican = saastamoinen.saastamoinen1974_ican(air, h_c, 0.0, _DIAGONAL, 0.0)
    r = round(float(r_ican) / MICRORADIAN)
    exact_h = float(air.refractivity(h_c))
    exact_a = float(refractivity_gyer(278.0, air.pressure(2500.0)))
    exact_r = float(refraction_angle(air, h_c, 0.0, _DIAGONAL))
    for name, printed, published, exact in (
        ("n_H - 1", 150.0, n_h, exact_h),
        ("n_A - 1", 212.0, n_a, exact_a),
        ("R", 59.0, r, exact_r),
        ("Delta R", -62.0, n_h - n_a, exact_h - exact_a),
        ("R + Delta R", -3.0, r + n_h - n_a, exact_r + exact_h - exact_a),
    ):
        yield "p. 300", name, "urad", h_c, 0.0, 45.0, printed, published, exact / MICRORADIAN
    for name, method, top, bound in (
        ("Eq. 3a, 3b: largest error", saastamoinen.saastamoinen1974_ican, 20_000.0, 0.2),
        ("Eq. 6: largest error", saastamoinen.saastamoinen1974_quadratic, 9_000.0, 0.5),
    ):
        ray = (air, np.arange(1000.0, top + 1.0, 500.0), 0.0, _DIAGONAL)
        of_method, summed = method(*ray, 0.0), saastamoinen.saastamoinen1974(*ray, 0.0)
        published, exact = (
            np.max(np.abs(of_method - other)) / MICRORADIAN
            for other in (summed, refraction_angle(*ray))
        )
        yield "p. 297", name, "urad", np.nan, 0.0, 45.0, bound, published, exact


def hand_sum(z: Array, density: Array, carried: float | None = None) -> tuple[Array, Array]:
    """Bertram's trapezoid sum over printed densities, unrounded (1966, Tables 1 to 4).

    ``z``, ``density`` (n,) are heights [m] and densities there [kg m-3]; ``carried`` the sum at the
    first entry, where an earlier table has brought it so far; without it the first entry closes the
    triangle, or trapezoid, that begins at sea level. Returns (n - 1,) heights of the entries [m]
    and refraction at 45 degrees [rad].

    >>> z, r = hand_sum(np.array([0.0, 1000.0, 2000.0]), np.array([1.225, 1.112, 1.007]))
    >>> z.tolist(), (r * 1e6).round(1).tolist()
    ([500.0, 1500.0], [6.4, 18.2])
    """
    middle = 0.5 * (z[1:] + z[:-1])
    half_product = -0.5 * np.diff(density) * middle
    interval = z[1] - z[0]
    first = half_product[0] * middle[0] / interval if carried is None else carried
    running = first + np.concatenate([[0.0], np.cumsum(half_product[1:] + half_product[:-1])])
    return middle, 226e-6 * running / middle


def bertram_rows() -> Iterator[Figures]:
    ardc = standard_atmosphere("ardc1959", index="gyer")
    for number, suffix in enumerate(
        ("table1", "table2", "table3_arctic_january_75n", "table4_tropical_15n"), 1
    ):
        printed = printed_table(f"bertram1966_{suffix}")
        levels = printed_table(f"bertram1966_{suffix}_density")
        # Table 2 begins with the sum that Table 1 has reached.
        carried = printed["running_sum"][0] if number == 2 else None
        h_c, r = hand_sum(levels["z_m"], levels["density_kg_m3"], carried)
        if number <= 2:
            exact = np.asarray(refraction_angle(ardc, h_c, 0.0, _DIAGONAL, BERTRAM_RADIUS_M))
        else:
            # Air whose log density is linear between the heights, and goes on down to sea level.
            z, logs = levels["z_m"], np.log(levels["density_kg_m3"])
            if z[0] > 0.0:
                logs = np.append(logs[0] - (logs[1] - logs[0]) / (z[1] - z[0]) * z[0], logs)
                z = np.append(0.0, z)
            # exp(step u) to its eighth term: 1e-10 over 1 km.
            powers = np.array([1.0 / math.factorial(i) for i in range(8)])
            polynomial = powers * np.diff(logs)[:, None] ** np.arange(8)
            air = RayTable(z, 226e-6 * np.exp(logs[:-1, None]) * polynomial)
            diagonal = math.sqrt(0.5)
            exact = bend(air, h_c, 0.0, diagonal, diagonal, radius=BERTRAM_RADIUS_M)[0]
        figures = printed["refraction_urad"], r / MICRORADIAN, exact / MICRORADIAN
        yield str(number), "refraction", "urad", h_c, 0.0, 45.0, *figures


@dataclass(frozen=True, eq=False)
class PaperTable:
    """A paper's figures in long form, one row a figure, and notes about them.

    ``columns`` holds arrays of one length: table, quantity, unit (strings), h_c_m, h_g_m,
    zeta_c_deg, printed, as_published, exact, difference (printed - exact). What a row does not
    have is NaN. ``notes`` say where printed and exact part, and why.
    """

    columns: dict[str, NDArray[np.generic]]
    notes: tuple[str, ...]

    def rows(self) -> list[dict[str, str | float | None]]:
        """The figures row by row, None for what is not there."""
        lists = (column.tolist() for column in self.columns.values())
        return [
            {name: None if v != v else v for name, v in zip(self.columns, row, strict=True)}
            for row in zip(*lists, strict=True)
        ]


def paper_tables(paper: str) -> PaperTable:
    """The tables of a paper beside their recomputation.

    ``paper`` is one of gyer1996, saastamoinen1974 and bertram1966. Gyer's take about a second.

    >>> table = paper_tables("saastamoinen1974")
    >>> row = table.columns["quantity"].tolist().index("R + Delta R")
    >>> table.columns["printed"][row].item(), table.columns["as_published"][row].round(1).item()
    (-3.0, -3.0)
    """
    if paper not in _PAPERS:
        raise messages.paper_name(paper=paper, papers=", ".join(_PAPERS))
    blocks = [np.broadcast_arrays(*map(np.atleast_1d, figures)) for figures in _PAPERS[paper]()]
    columns = dict(zip(_COLUMNS, map(np.concatenate, zip(*blocks, strict=True)), strict=True))
    columns["difference"] = columns["printed"] - columns["exact"]
    notes = tomllib.loads(_DATA.joinpath("paper_notes.toml").read_text("utf-8"))
    return PaperTable(columns, tuple(notes[paper]))


_PAPERS: dict[str, Callable[[], Iterator[Figures]]] = {
    "gyer1996": gyer_rows,
    "saastamoinen1974": saastamoinen_rows,
    "bertram1966": bertram_rows,
}
