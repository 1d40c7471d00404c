"""The tables of three papers and their recomputation: as printed, as published, and exact.

*As published* is computed by the method of the paper, *exact* by the spherical kernel of this
package in the same air. `paper_tables` returns columns. The printed figures are in
``refraction/data``.
"""

import csv
import math
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial
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
from unbend.refraction.published.column import Method
from unbend.refraction.published.gyer import STEP_M, gyer1996, plane_first_term, subtended_angle
from unbend.refraction.ray import bend, refraction_angle
from unbend.refraction.ray_table import RayTable
from unbend.refraction.window import SCHEDULE_TEMPERATURE_K, refract_at_window, scheduled_pressure
from unbend.units import ARCSEC, DEGREE, HECTOPASCAL, MICRORADIAN, Array

GYER_RADIUS_M = 6_378_000.0
BERTRAM_RADIUS_M = 6_378_000.0

_DATA = files("unbend.refraction").joinpath("data")
_DIAGONAL = 45.0 * DEGREE
_HALF_ROOT = math.sqrt(0.5)  # sine and cosine of 45 degrees

_MILLIONTH = 1e-6  # unit of the printed n - 1
_LESS_NADIR_ANGLE_RAD = 1e-12  # so that grazing rays reach the ground; 2e-6 arcsec of R_c

_SERIES_TERMS = 8  # of the exponential of a step of log density: 1e-10 over 1 km
_INDEX_PER_DENSITY = 226e-6  # (n - 1) / rho [m3 kg-1] (Bertram, Eq. 7)


@dataclass(frozen=True, eq=False, kw_only=True)
class Figures:
    """The figures of one quantity in a table, as columns of `PaperTable`, which broadcast."""

    table: str
    quantity: str
    unit: str
    h_c_m: ArrayLike
    h_g_m: ArrayLike = math.nan
    zeta_c_deg: ArrayLike = math.nan
    printed: ArrayLike
    as_published: ArrayLike
    exact: ArrayLike = math.nan


def printed_table(name: str) -> dict[str, Array]:
    """A table as printed, by column; ``name`` is a file of ``data/`` without its ending.

    >>> printed_table("gyer1996_table7")["r_cc_arcsec"][-1].item()
    19.44
    """
    text = _DATA.joinpath(f"{name}.csv").read_text("ascii")
    rows = list(csv.DictReader(text.splitlines()))
    columns: dict[str, Array] = {}
    for key in rows[0]:
        columns[key] = np.array([float(row[key]) for row in rows])
    return columns


def gyer_air() -> Profile:
    """The air behind Gyer's Tables 3 to 7.

    The temperatures of ARDC 1959, which his Table 2 shows (its heading says 1976), with M0 and R*
    as he states them after Eq. 53, and Eq. 13. With ARDC's own constants, which differ by 5e-5,
    Table 2 fits better and Tables 3 and 4 less well (at worst 0.0151 arcsec instead of 0.0146; 347
    of 440 entries to the printed digit instead of 363).
    """
    ardc = standard_atmosphere("ardc1959", index="gyer")
    edge = ardc.layers.edge
    layers = stack_layers(
        edge,
        ardc.virtual_temperature(ardc.break_heights_m),
        np.zeros(edge.size),
        ardc.layers.source,
        anchor=(0.0, 101325.0),
    )
    return Profile(layers, ardc.gravity, IndexModel("gyer"), "gyer1996")


def gyer_figures() -> Iterator[Figures]:
    """The figures of Gyer 1996."""
    air = gyer_air()
    yield from table_2()
    yield from tables_3_4(air)
    yield from table_5(air)
    yield from table_6(air)
    yield from table_7(air)


def table_2() -> Iterator[Figures]:
    """Table 2, the model atmosphere."""
    table = printed_table("gyer1996_table2")
    h = table["h_km"] * 1e3
    ardc = standard_atmosphere("ardc1959", index="gyer")
    figures = partial(Figures, table="2", h_c_m=h)
    yield figures(
        quantity="temperature",
        unit="K",
        printed=table["temperature_k"],
        as_published=ardc.temperature(h),
    )
    yield figures(
        quantity="pressure",
        unit="hPa",
        printed=table["pressure_mbar"],
        as_published=ardc.pressure(h) / HECTOPASCAL,
    )
    yield figures(
        quantity="n - 1",
        unit="1e-6",
        printed=table["refractivity_n_minus_1_e6"],
        as_published=ardc.refractivity(h) * 1e6,
    )


@dataclass(frozen=True, eq=False)
class _TableRays:
    """The rays of one of Gyer's tables, from its columns."""

    h_c_m: Array
    h_g_m: Array
    zeta_c_deg: Array

    @classmethod
    def of(cls, table: dict[str, Array]) -> "_TableRays":
        return cls(
            h_c_m=table["h_c_km"] * 1e3,
            h_g_m=table["h_g_km"] * 1e3,
            zeta_c_deg=table["zeta_c_deg"],
        )

    def angles(self, method: Method, air: Profile, **options: float) -> Array:
        """Refraction angles [rad] of these rays by a method; ``options`` are passed on to it."""
        zeta_c = self.zeta_c_deg * DEGREE
        return np.asarray(method(air, self.h_c_m, self.h_g_m, zeta_c, GYER_RADIUS_M, **options))


def tables_3_4(air: Profile) -> Iterator[Figures]:
    """Tables 3 and 4, the refraction angle."""
    table = printed_table("gyer1996_tables3_4")
    rays = _TableRays.of(table)
    yield Figures(
        table="3-4",
        quantity="R_c",
        unit="arcsec",
        h_c_m=rays.h_c_m,
        h_g_m=rays.h_g_m,
        zeta_c_deg=rays.zeta_c_deg,
        printed=table["r_c_arcsec"],
        as_published=rays.angles(gyer1996, air) / ARCSEC,
        exact=rays.angles(refraction_angle, air) / ARCSEC,
    )


def table_5(air: Profile) -> Iterator[Figures]:
    """Table 5, R_c of the spherical form minus that of the plane form."""
    table = printed_table("gyer1996_table5")
    rays = _TableRays.of(table)
    plane_by_steps = rays.angles(plane_first_term, air, step=STEP_M)
    published = rays.angles(gyer1996, air) - plane_by_steps
    exact = rays.angles(refraction_angle, air) - rays.angles(plane_first_term, air)
    yield Figures(
        table="5",
        quantity="R_c spherical - plane",
        unit="arcsec",
        h_c_m=rays.h_c_m,
        h_g_m=rays.h_g_m,
        zeta_c_deg=rays.zeta_c_deg,
        printed=table["r_spherical_minus_plane_arcsec"],
        as_published=published / ARCSEC,
        exact=exact / ARCSEC,
    )


def table_6(air: Profile) -> Iterator[Figures]:
    """Table 6, rays that are horizontal at the ground."""
    table = printed_table("gyer1996_table6")
    h_c = table["h_c_km"] * 1e3
    h_g = table["h_g_km"] * 1e3
    # Eq. 1 with zeta_g = 90 degrees.
    k = (1.0 + air.refractivity(h_g)) * (GYER_RADIUS_M + h_g)
    zeta_c = np.arcsin(k / ((1.0 + air.refractivity(h_c)) * (GYER_RADIUS_M + h_c)))
    zeta_c_deg = zeta_c / DEGREE
    published = gyer1996(air, h_c, h_g, zeta_c, GYER_RADIUS_M)
    # A ray with an angle that is too large by a rounding error misses the ground.
    steeper = zeta_c - _LESS_NADIR_ANGLE_RAD
    exact = np.asarray(refraction_angle(air, h_c, h_g, steeper, GYER_RADIUS_M))
    # His distance is the arc at sea level. It has no exact value here: computed from the exact R_c
    # it would be uncertain, since 1 arcsec of R_c makes 2 km of distance.
    radius = np.full(h_c.shape, GYER_RADIUS_M)
    theta = subtended_angle(air, h_c, h_g, zeta_c, radius, step=STEP_M)
    figures = partial(Figures, table="6", h_c_m=h_c, h_g_m=h_g, zeta_c_deg=zeta_c_deg)
    yield figures(
        quantity="zeta_c",
        unit="deg",
        printed=table["zeta_c_deg_for_zeta_g_90"],
        as_published=zeta_c_deg,
        exact=zeta_c_deg,
    )
    yield figures(
        quantity="distance",
        unit="km",
        printed=table["distance_km"],
        as_published=GYER_RADIUS_M * theta / 1e3,
    )
    yield figures(
        quantity="R_c",
        unit="arcsec",
        printed=table["r_c_arcsec"],
        as_published=published / ARCSEC,
        exact=exact / ARCSEC,
    )


def table_7(air: Profile) -> Iterator[Figures]:
    """Table 7, the pressurised compartment."""
    table = printed_table("gyer1996_table7")
    h_c = table["h_c_km"] * 1e3
    outside = air.refractivity(h_c)
    cabin = refractivity_gyer(SCHEDULE_TEMPERATURE_K, scheduled_pressure(air.pressure(h_c)))
    r_c = gyer1996(air, h_c, 0.0, _DIAGONAL, GYER_RADIUS_M)
    exact_r_c = np.asarray(refraction_angle(air, h_c, 0.0, _DIAGONAL, GYER_RADIUS_M))
    # Eq. 38 with the sign of Eq. 39; tan(zeta_f) = 1.
    r_cc = (cabin - outside) / (1.0 + outside)
    ray = np.full((h_c.size, 3), [_HALF_ROOT, 0.0, _HALF_ROOT])
    exact_r_cc = refract_at_window(ray, cabin, outside)[1]
    figures = partial(Figures, table="7", h_c_m=h_c, h_g_m=0.0, zeta_c_deg=45.0)
    yield figures(
        quantity="n_c - 1",
        unit="1e-6",
        printed=table["n_c_minus_1_e6"],
        as_published=outside / _MILLIONTH,
        exact=outside / _MILLIONTH,
    )
    yield figures(
        quantity="n_cc - 1",
        unit="1e-6",
        printed=table["n_cc_minus_1_e6"],
        as_published=cabin / _MILLIONTH,
        exact=cabin / _MILLIONTH,
    )
    yield figures(
        quantity="R_c",
        unit="arcsec",
        printed=table["r_c_arcsec"],
        as_published=r_c / ARCSEC,
        exact=exact_r_c / ARCSEC,
    )
    yield figures(
        quantity="R_cc",
        unit="arcsec",
        printed=table["r_cc_arcsec"],
        as_published=r_cc / ARCSEC,
        exact=exact_r_cc / ARCSEC,
    )
    yield figures(
        quantity="R_c - R_cc",
        unit="arcsec",
        printed=table["r_c_minus_r_cc_arcsec"],
        as_published=(r_c - r_cc) / ARCSEC,
        exact=(exact_r_c - exact_r_cc) / ARCSEC,
    )


def saastamoinen_figures() -> Iterator[Figures]:
    """The figures of Saastamoinen 1974, which are in his text."""
    air = standard_atmosphere("us1962", index="gyer")
    yield from compartment_at_6000_m(air)
    yield largest_error(
        air,
        quantity="Eq. 3a, 3b: largest error",
        method=saastamoinen.saastamoinen1974_ican,
        highest_m=20_000.0,
        printed=0.2,
    )
    yield largest_error(
        air,
        quantity="Eq. 6: largest error",
        method=saastamoinen.saastamoinen1974_quadratic,
        highest_m=9_000.0,
        printed=0.5,
    )


def compartment_at_6000_m(air: Profile) -> Iterator[Figures]:
    """The compartment at 6000 m, p. 300 (Eq. 9 after Eq. 3a)."""
    h_c = 6000.0
    # (n - 1) 1e6 = 79 p / T of the air outside (H) and in the cabin (A); p [hPa], whole numbers.
    n_h = round(79.0 * 472.0 / 249.0)
    n_a = round(79.0 * 747.0 / 278.0)
    r_ican = saastamoinen.saastamoinen1974_ican(air, h_c, 0.0, _DIAGONAL, 0.0)
    r = round(float(r_ican) / MICRORADIAN)
    exact_h = float(air.refractivity(h_c))
    exact_a = float(refractivity_gyer(278.0, air.pressure(2500.0)))
    exact_r = float(refraction_angle(air, h_c, 0.0, _DIAGONAL))
    figures = partial(Figures, table="p. 300", unit="urad", h_c_m=h_c, h_g_m=0.0, zeta_c_deg=45.0)
    yield figures(
        quantity="n_H - 1",
        printed=150.0,
        as_published=n_h,
        exact=exact_h / MICRORADIAN,
    )
    yield figures(
        quantity="n_A - 1",
        printed=212.0,
        as_published=n_a,
        exact=exact_a / MICRORADIAN,
    )
    yield figures(
        quantity="R",
        printed=59.0,
        as_published=r,
        exact=exact_r / MICRORADIAN,
    )
    yield figures(
        quantity="Delta R",
        printed=-62.0,
        as_published=n_h - n_a,
        exact=(exact_h - exact_a) / MICRORADIAN,
    )
    yield figures(
        quantity="R + Delta R",
        printed=-3.0,
        as_published=r + n_h - n_a,
        exact=(exact_r + exact_h - exact_a) / MICRORADIAN,
    )


def largest_error(
    air: Profile, *, quantity: str, method: Method, highest_m: float, printed: float
) -> Figures:
    """Largest error of a formula from 1000 to ``highest_m``, against Eq. 2 and exact (p. 297)."""
    h_c = np.arange(1000.0, highest_m + 1.0, 500.0)
    by_method = method(air, h_c, 0.0, _DIAGONAL, 0.0)
    by_eq_2 = saastamoinen.saastamoinen1974(air, h_c, 0.0, _DIAGONAL, 0.0)
    by_ray = refraction_angle(air, h_c, 0.0, _DIAGONAL)
    return Figures(
        table="p. 297",
        quantity=quantity,
        unit="urad",
        h_c_m=math.nan,
        h_g_m=0.0,
        zeta_c_deg=45.0,
        printed=printed,
        as_published=np.max(np.abs(by_method - by_eq_2)) / MICRORADIAN,
        exact=np.max(np.abs(by_method - by_ray)) / MICRORADIAN,
    )


def hand_sum(z: Array, density: Array, carried: float | None = None) -> tuple[Array, Array]:
    """Heights [m] and refraction at 45 degrees [rad] (n - 1,) by Bertram's sum (1966, Tables 1-4).

    ``z``, ``density`` (n,) are heights [m] and printed densities [kg m-3]; results are for the
    middles h of the intervals. R = c / h times the integral of -z d(density) from 0 to h, with
    c = (n - 1) / density, by trapezoids without rounding. ``carried`` is the integral to the first
    middle from an earlier table; without it a triangle from sea level is taken.

    >>> z, r = hand_sum(np.array([0.0, 1000.0, 2000.0]), np.array([1.225, 1.112, 1.007]))
    >>> z.tolist(), (r * 1e6).round(1).tolist()
    ([500.0, 1500.0], [6.4, 18.2])
    """
    middle = 0.5 * (z[1:] + z[:-1])
    half_product = -0.5 * np.diff(density) * middle
    if carried is None:
        interval = z[1] - z[0]
        carried = half_product[0] * middle[0] / interval
    steps = np.cumsum(half_product[1:] + half_product[:-1])
    integral = carried + np.concatenate([[0.0], steps])
    return middle, _INDEX_PER_DENSITY * integral / middle


_BERTRAM_TABLES = {
    "1": "bertram1966_table1",
    "2": "bertram1966_table2",
    "3": "bertram1966_table3_arctic_january_75n",
    "4": "bertram1966_table4_tropical_15n",
}
_ARDC_TABLES = ("1", "2")


def bertram_figures() -> Iterator[Figures]:
    """The figures of Bertram 1966."""
    for table, name in _BERTRAM_TABLES.items():
        printed = printed_table(name)
        levels = printed_table(f"{name}_density")
        # Table 2 continues the sum of Table 1, and begins with its last value.
        carried = printed["running_sum"][0] if table == "2" else None
        h_c, r = hand_sum(levels["z_m"], levels["density_kg_m3"], carried)
        if table in _ARDC_TABLES:
            ardc = standard_atmosphere("ardc1959", index="gyer")
            exact = np.asarray(refraction_angle(ardc, h_c, 0.0, _DIAGONAL, BERTRAM_RADIUS_M))
        else:
            air = air_of_densities(levels["z_m"], levels["density_kg_m3"])
            exact, _ = bend(air, h_c, 0.0, _HALF_ROOT, _HALF_ROOT, radius=BERTRAM_RADIUS_M)
        yield Figures(
            table=table,
            quantity="refraction",
            unit="urad",
            h_c_m=h_c,
            h_g_m=0.0,
            zeta_c_deg=45.0,
            printed=printed["refraction_urad"],
            as_published=r / MICRORADIAN,
            exact=exact / MICRORADIAN,
        )


def air_of_densities(z: Array, density: Array) -> RayTable:
    """Air with a ``density`` (n,) [kg m-3] that is exponential between heights ``z`` (n,) [m].

    Below the first height the exponential of the first interval goes on to sea level.
    """
    logs = np.log(density)
    if z[0] > 0.0:
        slope = (logs[1] - logs[0]) / (z[1] - z[0])
        logs = np.append(logs[0] - slope * z[0], logs)
        z = np.append(0.0, z)
    # In each interval density = exp(log at its bottom) times the power series of exp(step u).
    power = np.arange(_SERIES_TERMS)
    factor = np.array([1.0 / math.factorial(i) for i in range(_SERIES_TERMS)])
    polynomial = factor * np.diff(logs)[:, None] ** power
    return RayTable(z, _INDEX_PER_DENSITY * np.exp(logs[:-1, None]) * polynomial)


@dataclass(frozen=True, eq=False)
class PaperTable:
    """The figures of a paper in long form, one in each row, and notes about them.

    ``columns`` are arrays of one length: table, quantity, unit (strings), h_c_m, h_g_m,
    zeta_c_deg, printed, as_published, exact, difference (printed - exact). Missing numbers are NaN.
    ``notes`` explain where printed and exact figures differ.
    """

    columns: dict[str, NDArray[np.generic]]
    notes: tuple[str, ...]

    def rows(self) -> list[dict[str, str | float | None]]:
        """The figures row by row, by names of columns; None in place of NaN."""
        columns = [column.tolist() for column in self.columns.values()]
        rows: list[dict[str, str | float | None]] = []
        for values in zip(*columns, strict=True):
            row = dict(zip(self.columns, values, strict=True))
            for name, value in row.items():
                if value != value:  # NaN
                    row[name] = None
            rows.append(row)
        return rows


def paper_tables(paper: str) -> PaperTable:
    """The figures of a paper as printed, as published and exact.

    ``paper`` is one of gyer1996, saastamoinen1974 and bertram1966. Those of Gyer take a second.

    >>> table = paper_tables("saastamoinen1974")
    >>> row = table.columns["quantity"].tolist().index("R + Delta R")
    >>> table.columns["printed"][row].item(), table.columns["as_published"][row].round(1).item()
    (-3.0, -3.0)
    """
    if paper not in _PAPERS:
        raise messages.paper_name(paper=paper, papers=", ".join(_PAPERS))
    columns = _columns_of(list(_PAPERS[paper]()))
    columns["difference"] = columns["printed"] - columns["exact"]
    notes = tomllib.loads(_DATA.joinpath("paper_notes.toml").read_text("utf-8"))
    return PaperTable(columns, tuple(notes[paper]))


def _columns_of(all_figures: list[Figures]) -> dict[str, NDArray[Any]]:
    """Columns by the names of the fields of `Figures`, with all figures one below the other."""
    names = [field.name for field in fields(Figures)]
    blocks = []
    for figures in all_figures:
        values = [np.atleast_1d(getattr(figures, name)) for name in names]
        blocks.append(np.broadcast_arrays(*values))
    columns = [np.concatenate(column) for column in zip(*blocks, strict=True)]
    return dict(zip(names, columns, strict=True))


_PAPERS: dict[str, Callable[[], Iterator[Figures]]] = {
    "gyer1996": gyer_figures,
    "saastamoinen1974": saastamoinen_figures,
    "bertram1966": bertram_figures,
}
