"""Files for other programs: the formats by name.

A new format is a module beside this one, with its formats and their options in a tuple `FORMATS`,
and its name in `MODULES`. The options of ``unbend export`` and their help are generated from that.
"""

import difflib
from collections.abc import Mapping
from pathlib import Path

from unbend.errors import ConfigError
from unbend.tables.exports import (
    bingo,
    bundler,
    calibrations,
    colmap_files,
    correction_tables,
    opensfm_project,
    station_files,
)
from unbend.tables.exports.format import ExportCamera, ExportFormat, FinishedRun, Option

MODULES = (
    correction_tables, calibrations, station_files, colmap_files, bundler, opensfm_project, bingo,
)  # fmt: skip

FORMATS: Mapping[str, ExportFormat] = {
    form.name: form for module in MODULES for form in module.FORMATS
}
"""Formats by the name that ``unbend export --format`` takes."""


def find_format(name: str, out: Path) -> ExportFormat:
    """The format of a name, for a file whose ending it has, or a folder.

    >>> find_format("lattice", Path("grid.parquet")).contents
    'dx, dy on a grid over each image'
    """
    form = FORMATS.get(name)
    if form is None:
        near = difflib.get_close_matches(name, FORMATS, 2)
        what = f"no format is called {name!r}"
        remedy = f"perhaps {' or '.join(near)}?" if near else f"one of {', '.join(FORMATS)}"
        raise ConfigError("EXPORT-FORMAT", what, where="--format", remedy=remedy)
    fitting = [other for other, f in FORMATS.items() if f.ending == out.suffix.lower()]
    if out.suffix.lower() != form.ending and (form.ending or fitting):
        kind = f"a file that ends in {form.ending}" if form.ending else "a folder"
        what = f"{name} is written to {kind}"
        others = f", or choose from {', '.join(fitting)}" if fitting else ""
        remedy = f"rename it to {out.with_suffix(form.ending).name or form.ending}{others}"
        raise ConfigError("EXPORT-ENDING", what, where=str(out), remedy=remedy)
    return form


__all__ = ["FORMATS", "ExportCamera", "ExportFormat", "FinishedRun", "Option", "find_format"]
