"""The tables of the three papers, recomputed: as printed, as published, and exact.

*As published* is the paper's own method, *exact* the spherical kernel of this package in the same
air. `paper_tables` returns columns; the printed figures stand in ``pipeline/refraction/data``.
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PhysicsError
from pipeline.refraction.papers.printed_tables import (
    Block,
    bertram_rows,
    gyer_rows,
    saastamoinen_rows,
)


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
    try:
        rows_of_paper = _PAPERS[paper]
    except KeyError:
        raise PhysicsError.of("PAPER-NAME", paper=paper, papers=", ".join(_PAPERS)) from None
    blocks = rows_of_paper()
    columns: dict[str, NDArray[np.generic]] = {
        name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]
    }
    notes = files("pipeline.refraction").joinpath("data/paper_notes.toml").read_text("utf-8")
    return PaperTable(columns, tuple(tomllib.loads(notes)[paper]))


_PAPERS: dict[str, Callable[[], list[Block]]] = {
    "gyer1996": gyer_rows,
    "saastamoinen1974": saastamoinen_rows,
    "bertram1966": bertram_rows,
}

__all__ = ["PaperTable", "paper_tables"]
