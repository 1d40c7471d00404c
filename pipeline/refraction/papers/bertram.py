"""Bertram 1966, Tables 1 to 4: his trapezoid over the densities he printed."""

import math

import numpy as np

from pipeline.atmosphere import standard_atmosphere
from pipeline.refraction.papers.rows import Block, block, printed_table
from pipeline.refraction.ray import bend, refraction_angle
from pipeline.refraction.ray_table import RayTable
from pipeline.units import DEGREE, MICRORADIAN, Array

RADIUS_M = 6_378_000.0

NOTES = (
    "Table 2: the density at 58 km prints .00041, ARDC 1959 has .00044; 53,400 m is 53,500 m.",
    "Sums are rounded to a unit, in Table 2 to ten, and divided to three decimals (0.2 urad).",
    "Eq. 9 for raised ground counts heights from sea level instead of from the ground point: "
    "78.1 urad in his example, where the sum started at the point gives 66.0.",
)


def hand_sum(z: Array, density: Array, carried: float | None = None) -> tuple[Array, Array]:
    """Bertram's trapezoid sum over printed densities, unrounded (1966, Tables 1 to 4).

    Parameters
    ----------
    z, density : (n,) heights [m] and densities there [kg m-3].
    carried : sum at the first entry, where an earlier table has brought it so far; without it the
        first entry closes the triangle, or trapezoid, that begins at sea level.

    Returns
    -------
    (n - 1,) heights of the entries [m] and refraction at 45 degrees [rad].

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


def bertram_rows() -> list[Block]:
    ardc = standard_atmosphere("ardc1959", index="gyer")
    blocks = []
    for number, suffix in enumerate(
        ("table1", "table2", "table3_arctic_january_75n", "table4_tropical_15n"), 1
    ):
        printed = printed_table(f"bertram1966_{suffix}")
        levels = printed_table(f"bertram1966_{suffix}_density")
        # Table 2 begins with the sum that Table 1 has reached.
        carried = printed["running_sum"][0] if number == 2 else None
        h_c, r = hand_sum(levels["z_m"], levels["density_kg_m3"], carried)
        if number <= 2:
            exact = np.asarray(refraction_angle(ardc, h_c, 0.0, 45.0 * DEGREE, RADIUS_M))
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
            exact = bend(air, h_c, 0.0, diagonal, diagonal, radius=RADIUS_M)[0]
        blocks.append(
            block(
                str(number), "refraction", "urad", h_c=h_c, h_g=0.0, zeta_deg=45.0,
                printed=printed["refraction_urad"], published=r / MICRORADIAN,
                exact=exact / MICRORADIAN,
            )
        )  # fmt: skip
    return blocks
