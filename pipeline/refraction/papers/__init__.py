"""The tables of the three papers, recomputed: as printed, as published, and exact.

*As published* is the paper's own method, *exact* the spherical kernel of this package in the same
air. `paper_tables` returns columns; the printed figures stand in ``pipeline/refraction/data``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PhysicsError
from pipeline.refraction.papers.printed_tables import (
    BERTRAM_NOTES,
    GYER_NOTES,
    SAASTAMOINEN_NOTES,
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


def paper_names() -> tuple[str, ...]:
    """Names that `paper_tables` takes.

    >>> paper_names()
    ('gyer1996', 'saastamoinen1974', 'bertram1966')
    """
    return tuple(_PAPERS)


def paper_tables(paper: str) -> PaperTable:
    """The tables of a paper beside their recomputation.

    ``paper`` is one of `paper_names`. Gyer's take about a second.

    >>> table = paper_tables("saastamoinen1974")
    >>> row = table.columns["quantity"].tolist().index("R + Delta R")
    >>> table.columns["printed"][row].item(), table.columns["as_published"][row].round(1).item()
    (-3.0, -3.0)
    """
    try:
        rows, notes = _PAPERS[paper]
    except KeyError:
        raise PhysicsError(
            "PAPER-NAME", f"no paper is called {paper!r}", remedy=f"one of {', '.join(_PAPERS)}"
        ) from None
    blocks = rows()
    columns: dict[str, NDArray[np.generic]] = {
        name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]
    }
    return PaperTable(columns, notes)


_PAPERS: dict[str, tuple[Callable[[], list[Block]], tuple[str, ...]]] = {
    "gyer1996": (gyer_rows, GYER_NOTES),
    "saastamoinen1974": (saastamoinen_rows, SAASTAMOINEN_NOTES),
    "bertram1966": (bertram_rows, BERTRAM_NOTES),
}

__all__ = ["PaperTable", "paper_names", "paper_tables"]
