"""Files for people who work in other programs: the formats by name.

A new format is a module with a function ``(run, options, path, ledger) -> rows written`` and a
line in `FORMATS`. It writes one file (or, with the ending "", one folder) at the path it is given,
never reads the results' folder by itself, and tells the ledger what it leaves out.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import ConfigError
from pipeline.ledger import Ledger
from pipeline.tables.exports.lattice import write_lattice, write_lattice_csv
from pipeline.tables.exports.radial import write_radial, write_radial_csv
from pipeline.tables.exports.run import ExportCamera, ExportOptions, FinishedRun


@dataclass(frozen=True)
class Format:
    """A format: what it holds, in words; the ending of its file; the function that writes it."""

    what: str
    ending: str
    write: Callable[[FinishedRun, ExportOptions, Path, Ledger], int]


FORMATS: Mapping[str, Format] = {
    "lattice": Format("correction on a grid over each image", ".parquet", write_lattice),
    "lattice-csv": Format("correction on a grid over each image", ".csv", write_lattice_csv),
    "radial": Format("refraction by nadir angle, per flying height", ".parquet", write_radial),
    "radial-csv": Format("refraction by nadir angle, per flying height", ".csv", write_radial_csv),
}
"""Formats by the name that ``unbend export --format`` takes."""


def find_format(name: str, out: Path) -> Format:
    """The format of a name, for a file whose ending it has.

    >>> find_format("lattice", Path("grid.parquet")).what
    'correction on a grid over each image'
    """
    found = FORMATS.get(name)
    if found is None:
        near = difflib.get_close_matches(name, FORMATS, 2)
        raise ConfigError(
            "EXPORT-FORMAT",
            f"no format is called {name!r}",
            where="--format",
            remedy=f"did you mean {' or '.join(near)}?" if near else f"one of {', '.join(FORMATS)}",
        )
    if out.suffix.lower() != found.ending:
        fitting = [other for other, f in FORMATS.items() if f.ending == out.suffix.lower()]
        raise ConfigError(
            "EXPORT-ENDING",
            f"{name} is written to a file that ends in {found.ending}",
            where=str(out),
            remedy=f"rename it to {out.with_suffix(found.ending).name or found.ending}"
            + (f", or choose from {', '.join(fitting)}" if fitting else ""),
        )
    return found


__all__ = ["FORMATS", "ExportCamera", "ExportOptions", "FinishedRun", "Format", "find_format"]
