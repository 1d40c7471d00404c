"""Messages of tables of observations, weather models, soundings; and those of any small table."""

from pathlib import Path

from unbend.atmosphere.soundings.messages import MODEL_LEVELS
from unbend.errors import Code, InputError
from unbend.messages import Message, loss, note

# Messages of any small table; the caller passes the code.


def csv_unreadable(*, code: Code, where: Path | str, error: str) -> InputError:
    """A file cannot be read as CSV; ``error`` is the reason: encoding, lengths of rows, columns."""
    return InputError(
        code,
        "cannot be read as CSV: {error}",
        where=where,
        remedy=(
            "a table must be text in UTF-8; the first line has the names of the columns, every row "
            "has the same number of fields, and fields are separated by commas, semicolons, tabs "
            "or blanks"
        ),
        error=error,
    )


def frame_columns_repeated(*, code: Code, where: str, columns: str) -> InputError:
    """Two columns of a table in memory have the same name; ``columns`` are these names."""
    return InputError(
        code,
        "the columns {columns} occur twice",
        where=where,
        remedy="give each column a different name",
        columns=columns,
    )


def column_missing(
    *,
    code: Code,
    where: Path | str,
    quantity: str,
    column: str,
    similar: str,
    present: str,
    key: str,
) -> InputError:
    """A table lacks the ``column`` of a quantity.

    ``similar`` is the most similar name in the table, or empty; ``present`` lists its columns;
    ``key`` of the mission file states the name.
    """
    text = "there is no column {column!r} for the {quantity}; the columns are {present}"
    if similar:
        text = (
            "there is no column {column!r} for the {quantity}; perhaps {similar!r}?; the columns "
            "are {present}"
        )
    return InputError(
        code,
        text,
        where=where,
        remedy="state the name of the column: {key}",
        quantity=quantity,
        column=column,
        similar=similar,
        present=present,
        key=key,
    )


def fields_without_number(
    *, code: Code, path: Path | str, line: int, column: str, count: int, first: str
) -> InputError:
    """``count`` fields of a column of numbers are other text, the ``first`` of them in ``line``."""
    return InputError(
        code,
        "{count} fields of column {column} are not numbers, the first {first!r}",
        one="1 field of column {column} is not a number: {first!r}",
        where=f"{path}, line {line}",
        count=count,
        remedy="write decimal numbers with a point, and leave unknown values empty",
        column=column,
        first=first,
    )


def numbers_beyond(
    *,
    code: Code,
    path: Path | str,
    line: int,
    column: str,
    count: int,
    first: float,
    largest: float,
) -> InputError:
    """``count`` numbers of a column exceed ``largest`` in magnitude, the ``first`` in ``line``."""
    return InputError(
        code,
        "{count} numbers of column {column} are beyond {largest:g}, the first {first:g}",
        one="1 number of column {column} is beyond {largest:g}: {first:g}",
        where=f"{path}, line {line}",
        count=count,
        remedy="correct the number; leave unknown values empty",
        column=column,
        first=first,
        largest=largest,
    )


def angles_beyond_turn(
    *,
    code: Code,
    path: Path | str,
    line: int,
    count: int,
    turn: float,
    unit: str,
    largest: float,
    likely: str,
    key: str,
) -> InputError:
    """``count`` rows have an angle of more than a full turn, the first in ``line``.

    ``turn`` is a full turn in the stated ``unit``, ``largest`` the largest of the angles, and
    ``likely`` a unit in which none is more than a turn, or empty. ``key`` states the unit.
    """
    text = "{count} rows have an angle of more than one turn ({turn:g} {unit}), up to {largest:g}"
    text_of_one = "1 row has an angle of more than one turn ({turn:g} {unit}): {largest:g}"
    if likely:
        text += "; is the unit {likely}?"
        text_of_one += "; is the unit {likely}?"
    return InputError(
        code,
        text,
        one=text_of_one,
        where=f"{path}, line {line}",
        count=count,
        remedy="state {key} (deg, rad or grad), or name the columns of angles",
        turn=turn,
        unit=unit,
        largest=largest,
        likely=likely,
        key=key,
    )


# Weather models

MODEL_FORMAT = Code(
    "MODEL-FORMAT",
    means="The file of a weather model is neither netCDF, classic or 4, nor GRIB.",
    effect="It is not read.",
    remedy="Download it as netCDF or GRIB, or convert it: nccopy -k nc4.",
)


def model_format(*, where: Path | str, head: str) -> InputError:
    """The first bytes of a file, ``head``, belong to none of the formats that are read."""
    return InputError(
        MODEL_FORMAT,
        "begins with {head}: it is neither netCDF (classic or 4) nor GRIB",
        where=where,
        head=head,
        remedy="download it as netCDF or GRIB; nccopy -k nc4 converts other kinds of netCDF",
    )


MODEL_GRID = Code(
    "MODEL-GRID",
    means=(
        "The fields of a weather model are on a projected or reduced grid, for example those of "
        "HRRR."
    ),
    effect="The mission is refused.",
    remedy="Use ERA5 or GFS on a latitude-longitude grid, or regrid the file: cdo remapbil.",
)


def model_grid(*, where: Path | str, grid: str) -> InputError:
    """The fields are on a projected or reduced grid."""
    return InputError(
        MODEL_GRID,
        "its grid is {grid}: only latitude-longitude grids are read",
        where=where,
        grid=grid,
        remedy="use ERA5 or GFS, or regrid it: cdo remapbil,r1440x720 in.grb out.nc",
    )


def model_levels_incomplete(
    *, where: Path | str, first: float, last: float, total: int
) -> InputError:
    """Levels of ERA5 have a gap, or the lowest is missing: the file has ``first`` to ``last``."""
    return InputError(
        MODEL_LEVELS,
        (
            "its model levels are {first:g} to {last:g}, {total} in total: the lowest level of "
            "ERA5 is 137, and no level above it may be missing"
        ),
        where=where,
        remedy="request all levels down to 137, as 60/to/137",
        first=first,
        last=last,
        total=total,
    )


MODEL_MEMBER = Code(
    "MODEL-MEMBER",
    means=(
        "The file contains an ensemble, and no member is chosen. Or the chosen member does not "
        "exist."
    ),
    effect="The mission is refused.",
    remedy=(
        "Name a member of the ensemble: atmosphere.model.member. Leave it out if the file has no "
        "members."
    ),
)


def model_member_unknown(*, where: Path | str, low: int, high: int, member: int) -> InputError:
    """The mission names a member that the file does not contain; it has ``low`` to ``high``."""
    return InputError(
        MODEL_MEMBER,
        "it has members {low} to {high}, but member {member} is chosen",
        where=where,
        low=low,
        high=high,
        member=member,
        remedy="name one of its members: atmosphere.model.member",
    )


def model_no_members(*, where: Path | str, member: int) -> InputError:
    """The mission names a member, but the file is not an ensemble."""
    return InputError(
        MODEL_MEMBER,
        "it has no members, but member {member} is chosen",
        where=where,
        member=member,
        remedy="leave atmosphere.model.member out",
    )


def model_member_unnamed(*, where: Path | str, low: int, high: int) -> InputError:
    """The file is an ensemble of members ``low`` to ``high``, but the mission names none."""
    return InputError(
        MODEL_MEMBER,
        "it has members {low} to {high}, and none is chosen",
        where=where,
        low=low,
        high=high,
        remedy="name one, as atmosphere.model.member: {low}",
    )


MODEL_PACKAGE = Code(
    "MODEL-PACKAGE",
    means="The packages that read files of weather models are not installed.",
    effect="The file is not read.",
    remedy="Install them: pip install 'unbend[nwp]'.",
)


def model_package(*, where: Path | str, error: str) -> InputError:
    """A package that reads this format is not installed, or lacks its library."""
    return InputError(
        MODEL_PACKAGE,
        "weather models are read by packages that are not installed: {error}",
        where=where,
        error=error,
        remedy="pip install 'unbend[nwp]'",
    )


MODEL_TIME = Code(
    "MODEL-TIME",
    means=(
        "The fields of a weather model are of another time than the flight, have no readable time, "
        "or belong to several runs of a forecast. Or no station has a UTC and a place."
    ),
    effect="The mission is refused, or the file is not read.",
    remedy="Download the hours before, during and after the flight, from one run.",
)


def model_several_runs(*, where: Path | str, runs: str) -> InputError:
    """The file contains several runs of a forecast; ``runs`` describes their dimensions."""
    return InputError(
        MODEL_TIME,
        "it has {runs}: several runs of a forecast",
        where=where,
        runs=runs,
        remedy="keep one run in the file",
    )


def model_without_time(*, where: Path | str) -> InputError:
    """The fields have no time that can be decoded."""
    return InputError(
        MODEL_TIME,
        "its fields have no readable time",
        where=where,
        remedy="download the file again",
    )


def model_time(*, where: Path | str, begin: str, end: str, hours: float) -> InputError:
    """The times of the fields are too far from the flight: ``hours`` from a part of it."""
    return InputError(
        MODEL_TIME,
        "its times, {begin} to {end} UTC, are {hours:.1f} h away from the flight",
        where=where,
        begin=begin,
        end=end,
        hours=hours,
        remedy="download the hours before, during and after the flight",
    )


MODEL_TRUNCATED = Code(
    "MODEL-TRUNCATED",
    means="A message of a GRIB file does not end where its header states.",
    effect="The file is not read.",
    remedy="The download was cut off. Fetch the file again.",
)


def model_truncated(
    *, where: Path | str, number: int, start: int, length: int, size: int
) -> InputError:
    """A message of a GRIB file does not end where its header states, as after a broken download.

    ``number`` counts from 1; ``start``, ``length`` and the ``size`` of the file are in bytes.
    """
    return InputError(
        MODEL_TRUNCATED,
        (
            "message {number} at byte {start} has {length} bytes by its header, but does not end "
            "there; the file has {size} bytes"
        ),
        where=where,
        number=number,
        start=start,
        length=length,
        size=size,
        remedy="the download was cut off: fetch the file again",
    )


MODEL_UNREADABLE = Code(
    "MODEL-UNREADABLE",
    means="The file of a weather model cannot be read, or is damaged.",
    effect="It is not read.",
    remedy="Check its path and permissions, or download it again.",
)


def model_unreadable(*, where: Path | str, why: str) -> InputError:
    """The operating system, xarray or ecCodes cannot read the file; ``why`` is their message."""
    return InputError(
        MODEL_UNREADABLE,
        "the file cannot be read: {why}",
        where=where,
        remedy="download it again",
        why=why,
    )


def model_endless(*, where: Path | str) -> InputError:
    """The HDF5 library hangs or crashes on the structure of the file."""
    return InputError(
        MODEL_UNREADABLE,
        "the file cannot be read: its structure is damaged, and the HDF5 library does not come to "
        "an end with it",
        where=where,
        remedy="download it again",
    )


def model_axis(*, where: Path | str, axis: str) -> InputError:
    """An axis of the grid has impossible or repeated values; ``axis`` is its name."""
    return InputError(
        MODEL_UNREADABLE,
        "the values of its axis {axis} do not form a grid",
        where=where,
        remedy="download it again",
        axis=axis,
    )


def model_grid_too_large(*, where: Path | str, number: int, points: int, most: int) -> InputError:
    """A GRIB message states more grid points than any model has; ``most`` is the limit."""
    return InputError(
        MODEL_UNREADABLE,
        (
            "the file cannot be read: message {number} states a grid of {points:,} points, and a "
            "model has at most {most:,}"
        ),
        where=where,
        remedy="download it again",
        number=number,
        points=points,
        most=most,
    )


def model_section_too_long(*, where: Path | str, number: int, offset: int) -> InputError:
    """A section of a GRIB message, at byte ``offset`` of the file, is longer than the message."""
    return InputError(
        MODEL_UNREADABLE,
        (
            "the file cannot be read: message {number} has a section at byte {offset} that "
            "does not fit into it"
        ),
        where=where,
        remedy="download it again",
        number=number,
        offset=offset,
    )


MODEL_VARIABLE = Code(
    "MODEL-VARIABLE",
    means=(
        "The file has no temperature, humidity or geopotential on levels, or they are of other "
        "areas and times, or the temperature has a dimension that is not known."
    ),
    effect="The mission is refused. The variables of the file are listed.",
    remedy="Request all variables for the same levels, area and times.",
)


def model_variable_missing(*, where: Path | str, lacking: str, held: str) -> InputError:
    """Quantities that are needed are not in the file; ``held`` lists the fields that are."""
    return InputError(
        MODEL_VARIABLE,
        "it has no {lacking}; it contains {held}",
        where=where,
        lacking=lacking,
        held=held,
        remedy="request temperature, specific humidity and geopotential on levels",
    )


def model_dimension_unknown(*, where: Path | str, dimensions: str) -> InputError:
    """The temperature has a dimension that is neither time, level, place nor member."""
    return InputError(
        MODEL_VARIABLE,
        "its temperature has an unknown dimension: {dimensions}",
        where=where,
        dimensions=dimensions,
        remedy=(
            "select one value of this dimension, for example with cdo or xarray's isel; times, "
            "levels, latitude, longitude and members are known dimensions"
        ),
    )


def model_variable_elsewhere(*, where: Path | str, name: str, apart: str) -> InputError:
    """A field and the temperature differ along some dimensions, listed in ``apart``."""
    return InputError(
        MODEL_VARIABLE,
        "{name} and the temperature have different {apart}",
        where=where,
        name=name,
        apart=apart,
        remedy="request all variables for the same area and times",
    )


# Observations

OBS_ALREADY_CORRECTED = Code(
    "OBS-ALREADY-CORRECTED",
    means="Refraction was already removed from these observations.",
    effect="The mission is refused, because refraction would count twice.",
    remedy="Give the original measurements from the images.",
)


def _already_corrected(*, where: Path | str, why: str, name: str = "") -> InputError:
    """Refraction was removed already; ``why`` is the evidence, with ``{name}`` for ``name``."""
    return InputError(
        OBS_ALREADY_CORRECTED,
        f"refraction was removed already: {why}; correcting it again would count it twice",
        where=where,
        remedy="give the original measurements from the images",
        name=name,
    )


def corrected_by_sidecar(*, where: Path | str, sidecar: str) -> InputError:
    """A sidecar lists the hash of the file as one from which refraction was removed."""
    return _already_corrected(where=where, why="{name} names the content of the file", name=sidecar)


def corrected_by_database(*, where: Path | str, table: str) -> InputError:
    """A table of the database states that refraction was removed."""
    return _already_corrected(where=where, why="its table {name} states it", name=table)


def corrected_by_mark(*, where: Path | str, mark: str) -> InputError:
    """The metadata of the table state that refraction was removed."""
    why = 'the table has the mark "refraction {name}"'
    return _already_corrected(where=where, why=why, name=mark)


def corrected_by_column(*, where: Path | str, column: str) -> InputError:
    """The table has a column of corrected pixels."""
    why = "the table has a column {name}, which is written when refraction is removed"
    return _already_corrected(where=where, why=why, name=column)


OBS_ALREADY_DISPLACED = Code(
    "OBS-ALREADY-DISPLACED",
    means="Refraction was already applied to these observations.",
    effect="The mission is refused, because refraction would count twice.",
    remedy="Give ideal observations, free of refraction.",
)


def displaced_by_mark(*, where: Path | str, mark: str) -> InputError:
    """The metadata of the table state that refraction was applied."""
    return InputError(
        OBS_ALREADY_DISPLACED,
        'the table has the mark "refraction {mark}"; applying it again would count it twice',
        where=where,
        remedy="give ideal observations, free of refraction",
        mark=mark,
    )


def displaced_by_column(*, where: Path | str, column: str) -> InputError:
    """The table has a column of displaced pixels."""
    return InputError(
        OBS_ALREADY_DISPLACED,
        (
            "the table has a column {column}, which is written when refraction is applied; "
            "applying it again would count it twice"
        ),
        where=where,
        remedy="give ideal observations, free of refraction",
        column=column,
    )


OBS_CODES = Code(
    "OBS-CODES",
    means=(
        "A column is written as text, because some of its values with digits are not plain numbers."
    ),
    effect="No effect on the correction.",
    remedy="Nothing.",
)


def column_as_text(*, column: str) -> Message:
    """A column of a CSV is written as text, because some digits are not plain numbers (007)."""
    return note(
        OBS_CODES,
        "column {column} is written as text: some of its values with digits are not plain numbers",
        column=column,
    )


OBS_COLUMN = Code(
    "OBS-COLUMN",
    means=(
        "The table of observations lacks a column. Or the same column is named for two quantities."
    ),
    effect="The mission is refused.",
    remedy="Name its columns under observations.columns.",
)


def column_named_twice(*, where: Path | str, shared: str) -> InputError:
    """The mission file names one column, ``shared``, for two quantities."""
    return InputError(
        OBS_COLUMN,
        "the column {shared!r} is named for two quantities",
        where=where,
        shared=shared,
        remedy="correct observations.columns",
    )


OBS_CSV = Code(
    "OBS-CSV",
    means="The table of observations cannot be read as CSV.",
    effect="The mission is refused.",
    remedy=(
        "Write it as text in UTF-8, with the names of the columns in the first line and the same "
        "number of fields in every row."
    ),
)


def observations_csv_unreadable(*, where: Path | str, error: str) -> InputError:
    """The table of observations cannot be read as CSV."""
    return InputError(
        OBS_CSV,
        "cannot be read as CSV: {error}",
        where=where,
        remedy=(
            "a table must be text in UTF-8; the first line has the names of the columns, every row "
            "has the same number of fields, and fields are separated by commas, semicolons, tabs "
            "or blanks"
        ),
        error=error,
    )


OBS_DAMAGED = Code(
    "OBS-DAMAGED",
    means="Reading the table of observations failed.",
    effect="The mission is refused.",
    remedy="Write the table again.",
)


def observations_damaged(*, where: Path | str, error: str) -> InputError:
    """Arrow cannot read a part of the rows of a table."""
    return InputError(
        OBS_DAMAGED,
        "reading failed: {error}",
        where=where,
        error=error,
        remedy="write it again",
    )


OBS_EMPTY = Code(
    "OBS-EMPTY",
    means="The table of observations, or the database, has no rows.",
    effect="The mission is refused.",
    remedy="Write observations to it.",
)


def observations_empty(*, where: Path | str) -> InputError:
    """The table of observations has a header and nothing else."""
    return InputError(
        OBS_EMPTY, "the table has no rows", where=where, remedy="write observations to it"
    )


WORKBOOKS = (".xlsx", ".xls", ".ods")
"""Endings of spreadsheets: renaming such a file to .csv does not make it a table."""

OBS_FORMAT = Code(
    "OBS-FORMAT",
    means="The ending of the table of observations is neither .csv nor .parquet.",
    effect="The mission is refused.",
    remedy="Save it as CSV, rename a file that is one, or give observations.format.",
)


def observations_format(*, where: Path | str, ending: str, blocks: str) -> InputError:
    """The format of the table is unknown by its ``ending``, and the mission file does not state it.

    ``blocks`` lists the formats of blocks.
    """
    return InputError(
        OBS_FORMAT,
        "a table of observations must be .csv or .parquet, not {ending}",
        where=where,
        ending=ending,
        blocks=blocks,
        remedy=(
            "save it as CSV (in Excel: CSV UTF-8)"
            if ending in WORKBOOKS
            else "convert or rename it, or give observations.format: {blocks}"
        ),
    )


OBS_MARK_CHANGED = Code(
    "OBS-MARK-CHANGED",
    means=(
        "A sidecar file states that refraction was removed from this file. Its content has changed "
        "since then."
    ),
    effect="The mission is refused.",
    remedy=(
        "If another program adjusted this model from an export, refraction is already removed from "
        "it: do not use it as input here. If the file contains the original measurements from the "
        "images, move the sidecar to another folder."
    ),
)


def marked_file_changed(*, where: Path | str, name: str) -> InputError:
    """A sidecar, ``name``, lists the file with another content than it has now."""
    return InputError(
        OBS_MARK_CHANGED,
        "{name} states that refraction was removed from it, but its content has changed since then",
        where=where,
        name=name,
        remedy=(
            "if another program adjusted this model from an export, refraction is already removed "
            "from it: do not use it as input here; if the file contains the original measurements "
            "from the images, move the sidecar to another folder"
        ),
    )


OBS_MARK_UNREADABLE = Code(
    "OBS-MARK-UNREADABLE",
    means="The sidecar file next to the observations cannot be read.",
    effect="The mission is refused, because refraction may have been removed.",
    remedy="Restore it. If the files contain measurements, move it to another folder.",
)


def sidecar_unreadable(*, where: Path | str, name: str) -> InputError:
    """A sidecar next to the observations cannot be read; ``name`` is the kind of error."""
    return InputError(
        OBS_MARK_UNREADABLE,
        ("the sidecar cannot be read ({name}): it may state that refraction was removed"),
        where=where,
        name=name,
        remedy=(
            "restore it; if the files next to it contain the original measurements from the "
            "images, move it to another folder"
        ),
    )


OBS_MISSING = Code(
    "OBS-MISSING",
    means="The table of observations does not exist.",
    effect="The mission is refused.",
    remedy="Check observations.path.",
)


def observations_missing(*, where: Path | str) -> InputError:
    """The table of observations does not exist."""
    return InputError(
        OBS_MISSING,
        "there is no such file",
        where=where,
        remedy="check observations.path",
    )


OBS_OTHER_PIXELS = Code(
    "OBS-OTHER-PIXELS",
    means="The table has measured and corrected pixels. The wrong columns are named.",
    effect="The mission is refused.",
    remedy="Name the correct columns under observations.columns.",
)


def other_pixels(
    *, where: Path | str, role: str, right: str, content: str, direction: str
) -> InputError:
    """The table is a result of unbend, and the mission names the wrong pixels of it.

    ``role`` is x_px or y_px, with ``content``; ``right`` is the column to name.
    """
    return InputError(
        OBS_OTHER_PIXELS,
        (
            "the column {role} has pixels {content}; refraction.direction: {direction} needs the "
            "pixels of the column {right}"
        ),
        where=where,
        role=role,
        right=right,
        content=content,
        direction=direction,
        remedy="state observations.columns.{role}: {right}",
    )


OBS_PARQUET = Code(
    "OBS-PARQUET",
    means="The table of observations cannot be read as Parquet.",
    effect="The mission is refused.",
    remedy="Write it again.",
)


def parquet_unreadable(*, where: Path | str, error: str) -> InputError:
    """The table of observations cannot be read as Parquet."""
    return InputError(
        OBS_PARQUET,
        "cannot be read as Parquet: {error}",
        where=where,
        error=error,
        remedy="write it again",
    )


OBS_RENAMED = Code(
    "OBS-RENAMED",
    means=(
        "A column of the input has the name of a result column. It is written with the ending "
        "_input."
    ),
    effect="None.",
    remedy="Nothing.",
)


def column_renamed(*, column: str, written: str) -> Message:
    """A column of the user's is written under another name, ``written``."""
    return note(
        OBS_RENAMED,
        "column {column} is written as {written}: a column of the results has the same name",
        column=column,
        written=written,
    )


OBS_REPEATED_COLUMN = Code(
    "OBS-REPEATED-COLUMN",
    means="Two columns of the table have the same name.",
    effect="The mission is refused.",
    remedy="Rename one column of each pair.",
)


def columns_repeated(*, where: Path | str, twice: str) -> InputError:
    """Columns of the table have the same name; ``twice`` lists these names."""
    return InputError(
        OBS_REPEATED_COLUMN,
        "the columns {twice} occur twice",
        where=where,
        twice=twice,
        remedy="rename one column of each pair",
    )


OBS_REPEATED_POINT = Code(
    "OBS-REPEATED-POINT",
    means=(
        "Points occur twice in an image. In tables of 400,000 rows and more, only some points "
        "are checked."
    ),
    effect="Both rows are corrected; at most one is the measurement.",
    remedy="Correct the table or block. It may have been joined with itself.",
)


def points_repeated(*, where: str, count: int, first: str) -> Message:
    """``count`` points occur twice in an image; ``first`` names one of them and its image."""
    return loss(
        OBS_REPEATED_POINT,
        (
            "{count} points occur twice in an image, the first is {first}: at most one of the two "
            "rows is the measurement"
        ),
        one=(
            "1 point occurs twice in an image, {first}: at most one of the two rows is the "
            "measurement"
        ),
        where=where,
        count=count,
        first=first,
    )


OBS_TYPE = Code(
    "OBS-TYPE",
    means="The type of a column is neither text nor a number, or is not the needed type.",
    effect="The mission is refused.",
    remedy="Write names as text and numbers as float64.",
)


def column_of_other_type(*, where: Path | str, column: str, kind: str) -> InputError:
    """A column of numbers has neither numbers nor text; ``kind`` is its type in Arrow."""
    return InputError(
        OBS_TYPE,
        "the column {column} contains {kind}, not numbers",
        where=where,
        remedy="write it as float64",
        column=column,
        kind=kind,
    )


def names_of_other_type(*, where: Path | str, column: str, kind: str) -> InputError:
    """A column of names has neither text nor numbers; ``kind`` is its type in Arrow."""
    return InputError(
        OBS_TYPE,
        "the column {column} contains {kind}, not names",
        where=where,
        remedy="write it as text",
        column=column,
        kind=kind,
    )


# Soundings

SOUNDING_NETCDF = Code(
    "SOUNDING-NETCDF",
    means="The file is not a sounding in ARM's classic netCDF.",
    effect="The mission is refused.",
    remedy="Export the levels as CSV.",
)


def _not_of_arm(*, where: Path | str, why: str, name: str = "") -> InputError:
    """A netCDF file is not a sounding of ARM; ``why``, with ``{name}`` for ``name``."""
    return InputError(
        SOUNDING_NETCDF,
        f"it is not a sounding in ARM's classic netCDF: {why}",
        where=where,
        remedy="export the levels as CSV: h_m, pressure_hpa, temperature_c, dew_point_c",
        name=name,
    )


def sounding_is_netcdf4(*, where: Path | str) -> InputError:
    """The sounding is netCDF-4 (HDF5), which is not read."""
    why = "it is netCDF-4 (HDF5); only the classic format is read"
    return _not_of_arm(where=where, why=why)


def sounding_variable_missing(*, where: Path | str, variable: str) -> InputError:
    """A netCDF file lacks a variable that all of ARM's radiosondes have."""
    return _not_of_arm(where=where, why="it has no variable {name}", name=variable)


def sounding_damaged(*, where: Path | str, error: str) -> InputError:
    """scipy cannot decode the netCDF file."""
    return _not_of_arm(where=where, why="it cannot be decoded: {name}", name=error)


SOUNDING_ZIP = Code(
    "SOUNDING-ZIP",
    means="The sounding is a ZIP archive that does not contain exactly one readable file.",
    effect="The mission is refused.",
    remedy="Unpack it, and give the unpacked file of the sounding.",
)


def sounding_archive(*, where: Path | str, why: str) -> InputError:
    """A ZIP archive does not contain exactly one readable file."""
    return InputError(
        SOUNDING_ZIP,
        "the archive cannot be used: {why}",
        where=where,
        why=why,
        remedy="unpack it, and give the unpacked file of the sounding",
    )


SOUNDING_SIZE = Code(
    "SOUNDING-SIZE",
    means="The file has more than 200 million bytes: more than the longest record of soundings.",
    effect="The mission is refused.",
    remedy="Keep only the days around the flight.",
)


def sounding_size(*, where: Path | str, size: int, largest_bytes: int) -> InputError:
    """The file is too large for a sounding."""
    return InputError(
        SOUNDING_SIZE,
        "the file has {size} bytes, more than the {largest_bytes} of the longest record",
        where=where,
        size=size,
        largest_bytes=largest_bytes,
        remedy="keep only the days around the flight",
    )


SOUNDING_UNREADABLE = Code(
    "SOUNDING-UNREADABLE",
    means="The sounding cannot be read, or is not UTF-8 text.",
    effect="The mission is refused.",
    remedy="Check path and permissions, or save it as UTF-8.",
)


def sounding_unreadable(*, where: Path | str, strerror: str) -> InputError:
    """The operating system cannot read the sounding; ``strerror`` is its message."""
    return InputError(
        SOUNDING_UNREADABLE,
        "the file cannot be read: {strerror}",
        where=where,
        strerror=strerror,
        remedy="check the path and its permissions",
    )


def sounding_not_utf8(*, where: Path | str, byte: int, offset: int) -> InputError:
    """The sounding is text in another encoding: the ``byte`` at ``offset`` is not UTF-8."""
    return InputError(
        SOUNDING_UNREADABLE,
        "the byte {byte:#04x} at offset {offset} is not valid in UTF-8",
        where=where,
        byte=byte,
        offset=offset,
        remedy="save the file as UTF-8 text",
    )
