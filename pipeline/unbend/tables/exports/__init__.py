"""Files for other programs: the formats by name.

A new format is a module in this folder, with its formats and their options in a tuple `FORMATS`,
and an entry in `MODULES`. The options of ``unbend export`` and their help are generated from that.
"""

import difflib
from collections.abc import Mapping
from pathlib import Path

from unbend.tables.exports import (
    bingo,
    blocks_exchange_xml,
    bundler,
    calibrations,
    colmap_files,
    correction_tables,
    geopackage,
    ground_points,
    messages,
    opensfm_project,
    pix4d_parameters,
    station_files,
)
from unbend.tables.exports.export_format import ExportCamera, ExportFormat, FinishedRun, Option

MODULES = (
    correction_tables,
    calibrations,
    station_files,
    geopackage,
    ground_points,
    colmap_files,
    bundler,
    opensfm_project,
    bingo,
    blocks_exchange_xml,
    pix4d_parameters,
)

FORMATS: Mapping[str, ExportFormat] = {
    form.name: form for module in MODULES for form in module.FORMATS
}
"""Formats by the name that ``unbend export --format`` takes."""


def formats_of_program(name: str) -> list[str]:
    """Names of the formats for a program, by the words "for <name>:" in their contents.

    >>> formats_of_program("metashape"), formats_of_program("other")
    (['bundler'], [])
    """
    phrase = f"for {name}:".casefold()
    return [form.name for form in FORMATS.values() if phrase in form.contents.casefold()]


def find_format(name: str, out: Path) -> ExportFormat:
    """The format called ``name``, for results at ``out``: a file, or a folder.

    Refuses (ConfigError) an unknown name (EXPORT-FORMAT), and an ``out`` without the ending of the
    format (EXPORT-ENDING). A folder may have any ending that no format has.

    >>> find_format("lattice", Path("grid.parquet")).contents
    'dx, dy on a grid over each image'
    """
    form = FORMATS.get(name)
    if form is None:
        similar_names = difflib.get_close_matches(name, FORMATS, 2)
        raise messages.format_unknown(
            where="--format",
            name=name,
            similar=" or ".join(similar_names),
            of_program=" or ".join(formats_of_program(name)),
            known=", ".join(FORMATS),
        )
    ending = out.suffix.lower()
    if ending == form.ending:
        return form
    formats_of_ending = [other.name for other in FORMATS.values() if other.ending == ending]
    is_folder = not form.ending
    if is_folder and not formats_of_ending:
        return form
    rename = out.with_suffix(form.ending).name or form.ending
    others = ", ".join(formats_of_ending)
    if is_folder:
        raise messages.ending_of_folder(where=out, name=name, rename=rename, others=others)
    raise messages.ending_of_file(
        where=out, name=name, ending=form.ending, rename=rename, others=others
    )


__all__ = ["FORMATS", "ExportCamera", "ExportFormat", "FinishedRun", "Option", "find_format"]
