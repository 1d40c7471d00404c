"""Saastamoinen 1974: the worked example and the errors he states for his formulas."""

import numpy as np

from pipeline.atmosphere import standard_atmosphere
from pipeline.atmosphere.refractive_index import refractivity_gyer
from pipeline.refraction.papers.rows import Block, block
from pipeline.refraction.published import saastamoinen
from pipeline.refraction.ray import refraction_angle
from pipeline.units import DEGREE, MICRORADIAN

NOTES = (
    "The example is worked in whole microradians, as published here too; unrounded R + Delta R is "
    "-3.6 urad.",
    "Eq. 3a and 3b differ from Eq. 2 in US 1962 by up to 0.24 urad at 12 km; he compares with sums "
    "of Schut.",
    "Eq. 7 and 10 hold 34.11 for g M/R* = 34.163 and read 27 % high at 120 m, 1 % at 3 km.",
)


def saastamoinen_rows() -> list[Block]:
    return [*worked_example(), *stated_errors()]


def worked_example() -> list[Block]:
    """The compartment at 6000 m, p. 300: Eq. 9 after Eq. 3a."""
    air = standard_atmosphere("us1962", index="gyer")
    h_c, diagonal = 6000.0, 45.0 * DEGREE
    # He works in whole microradians.
    n_h, n_a = round(79.0 * 472.0 / 249.0), round(79.0 * 747.0 / 278.0)
    r = round(float(saastamoinen.saastamoinen1974_ican(air, h_c, 0.0, diagonal, 0.0)) / MICRORADIAN)
    exact_h = float(air.refractivity(h_c))
    exact_a = float(refractivity_gyer(278.0, air.pressure(2500.0)))
    exact_r = float(refraction_angle(air, h_c, 0.0, diagonal))
    figures = (
        ("n_H - 1", 150.0, n_h, exact_h),
        ("n_A - 1", 212.0, n_a, exact_a),
        ("R", 59.0, r, exact_r),
        ("Delta R", -62.0, n_h - n_a, exact_h - exact_a),
        ("R + Delta R", -3.0, r + n_h - n_a, exact_r + exact_h - exact_a),
    )
    return [
        block(
            "p. 300", name, "urad", h_c=h_c, h_g=0.0, zeta_deg=45.0, printed=printed,
            published=published, exact=exact / MICRORADIAN,
        )
        for name, printed, published, exact in figures
    ]  # fmt: skip


def stated_errors() -> list[Block]:
    """Largest differences he states for Eq. 3 and 6 against US 1962, and those found."""
    air = standard_atmosphere("us1962", index="gyer")
    diagonal = 45.0 * DEGREE
    blocks = []
    for quantity, method, top, bound in (
        ("Eq. 3a, 3b: largest error", saastamoinen.saastamoinen1974_ican, 20_000.0, 0.2),
        ("Eq. 6: largest error", saastamoinen.saastamoinen1974_quadratic, 9_000.0, 0.5),
    ):
        h_c = np.arange(1000.0, top + 1.0, 500.0)
        r = method(air, h_c, 0.0, diagonal, 0.0)
        summed = saastamoinen.saastamoinen1974(air, h_c, 0.0, diagonal, 0.0)
        exact = np.asarray(refraction_angle(air, h_c, 0.0, diagonal))
        blocks.append(
            block(
                "p. 297", quantity, "urad", h_g=0.0, zeta_deg=45.0, printed=bound,
                published=np.max(np.abs(r - summed)) / MICRORADIAN,
                exact=np.max(np.abs(r - exact)) / MICRORADIAN,
            )
        )  # fmt: skip
    return blocks
