"""Rows of a paper's table: as printed, as published, exact."""

import csv
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.units import Array

Block = dict[str, NDArray[np.generic]]


def block(
    table: str,
    quantity: str,
    unit: str,
    *,
    printed: ArrayLike,
    published: ArrayLike,
    exact: ArrayLike = np.nan,
    h_c: ArrayLike = np.nan,
    h_g: ArrayLike = np.nan,
    zeta_deg: ArrayLike = np.nan,
) -> Block:
    """Rows of one quantity; h_c and h_g in metres, the rest in its unit."""
    values = (h_c, h_g, zeta_deg, printed, published, exact)
    arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, np.float64)) for v in values))
    numbers = [a.ravel() for a in arrays]
    names = ("h_c_m", "h_g_m", "zeta_c_deg", "printed", "as_published", "exact")
    rows: Block = {
        key: np.full(numbers[0].shape, word)
        for key, word in (("table", table), ("quantity", quantity), ("unit", unit))
    }
    rows.update(zip(names, numbers, strict=True))
    return rows | {"difference": numbers[3] - numbers[5]}


def printed_table(name: str) -> dict[str, Array]:
    """A table as printed, by column; ``name`` is a file of ``data/`` without its ending.

    >>> printed_table("gyer1996_table7")["r_cc_arcsec"][-1].item()
    19.44
    """
    source = resources.files("pipeline.refraction").joinpath(f"data/{name}.csv")
    rows = list(csv.DictReader(source.read_text(encoding="ascii").splitlines()))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
