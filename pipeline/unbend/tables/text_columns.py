"""Columns by the user's names: checks of tables, and small tables as text, numbers and times."""

import difflib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from unbend.errors import Code
from unbend.flight.channels import TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK, utc_of_gps
from unbend.flight.survey_dates import can_be_flown
from unbend.table_dialect import BLANKS, columns_in_words, with_decimal_points
from unbend.tables import messages
from unbend.tables.delimited import text_file
from unbend.tables.refraction_mark import Direction
from unbend.units import (
    LARGEST_HEIGHT_M,
    LARGEST_NUMBER,
    RADIANS,
    UNIX_NS_OF_GPS_EPOCH,
    AngleUnit,
    Array,
    Integers,
    Mask,
    measured,
    whole_numbers,
)
from unbend.written_numbers import LETTERS_OF_AXIS, angle_of, number_of

_LEAST_SIMILAR = 0.5  # similarity of a name that is suggested, by difflib: x_pix to x_px has 0.89
LINE_OF_FIRST_ROW = 2  # of a table in memory, as if its first line were its header
_PUNCTUATION = re.compile(r"[^a-z0-9]")
_ENDINGS_OF_HEMISPHERE = ("ref", "hemisphere", "hemi", "dir")
_QUANTITIES_OF_NAMES = ("image", "camera", "point")  # with columns of text
LARGEST_OF_QUANTITIES = {
    "latitude": 90.0,
    "longitude": 360.0,
    "height": LARGEST_HEIGHT_M,
}
"""Quantity -> the largest magnitude of its numbers, if that is less than `LARGEST_NUMBER`."""

_MOST_WEEKS = 10_000  # GPS weeks, until 2171: nanoseconds in 64 bits reach beyond that
_MOST_SECONDS = 1e9  # of a week; some tables have week 0 and count all seconds since 1980
_WEEK_NS = SECONDS_PER_WEEK * 10**9
# ISO 8601 with year, month and day; nanoseconds since 1970 can count these years.
_WITH_DAY = r"(?:19|20)\d\d(?:-\d{1,2}-\d{1,2}|\d{4})(?!\d)"
# GPS week at the end of 1989: no survey had GPS before. A lower number is usually one modulo 1024.
FIRST_WEEK_OF_SURVEYS = 521


def text_table(
    path: Path, wanted: Mapping[str, str], *, codes: tuple[Code, Code], key: str
) -> pd.DataFrame:
    """Read all fields of a table as text; a missing field is an empty text.

    The table has any form that `unbend.table_dialect` knows; decimal commas become points. The
    index of the result are the line numbers in the file. ``wanted`` : quantity -> name of its
    column, as stated under ``key`` of the mission file. The first of ``codes`` refuses files that
    are not tables and tables with two columns of one name, the second tables that lack a column.
    """
    name_columns = {name for quantity, name in wanted.items() if quantity in _QUANTITIES_OF_NAMES}
    table_code, column_code = codes
    table = unrepeated_table(path, table_code, name_columns)
    wanted_columns = [(quantity, name, f"{key}.{quantity}") for quantity, name in wanted.items()]
    require_names(column_code, path, table.columns.tolist(), wanted_columns)
    return table


def unrepeated_table(path: Path, code: Code, name_columns: Collection[str]) -> pd.DataFrame:
    """Read a table like `whole_table`; also refuses (``code``) two columns of one name."""
    table = whole_table(path, code, name_columns)
    repeated = _repeated(table.columns.tolist())
    if repeated:
        why = f"the columns {repeated} occur twice"
        raise messages.csv_unreadable(code=code, where=path, error=why)
    return table


def whole_table(path: Path, code: Code, name_columns: Collection[str]) -> pd.DataFrame:
    """Read all fields of a table as text, like `text_table`, without a check of its columns.

    Refuses (``code``) files that are not tables. ``name_columns`` contain names of images, cameras
    or points: their commas are not changed to points.
    """
    try:
        file = text_file(path)
        form = file.form
        # The head is read as a row: with a header, pandas takes the first field of longer rows for
        # an index, and renames repeated columns.
        rows = pd.read_csv(
            path,
            header=None,
            dtype=str,
            keep_default_na=False,
            skipinitialspace=True,
            skiprows=form.lines_before,
            encoding=file.encoding,
            sep=r"\s+" if form.separator == BLANKS else form.separator,
        ).fillna("")
        if len(form.names) != rows.shape[1]:
            raise ValueError(
                f"it names {len(form.names)} columns, but its rows have {rows.shape[1]}"
            )
    except (OSError, ValueError) as error:
        raise messages.csv_unreadable(code=code, where=path, error=str(error).strip()) from None
    table = rows.iloc[int(form.head_is_row) :].set_axis(list(form.names), axis="columns")
    table.index = pd.RangeIndex(len(table)) + form.line_of_first_row
    table = table[~_comments_between_rows(table)]
    for column, name in enumerate(form.names):
        fields = table.iloc[:, column].tolist()
        with_points = with_decimal_points(fields, decimal_comma=form.decimal_comma)
        is_changed = with_points is not fields
        if is_changed and name not in name_columns:
            table.isetitem(column, list(with_points))
    return table


def _comments_between_rows(table: pd.DataFrame) -> Mask:
    """(n,) whether a row is a comment: it begins with # or %, and all other fields are empty."""
    has_comment_mark = table.iloc[:, 0].str.startswith(("#", "%"))
    is_rest_empty = (table.iloc[:, 1:] == "").all(axis=1)
    return np.asarray(has_comment_mark & is_rest_empty, np.bool_)


def text_of_frame(
    frame: pd.DataFrame,
    wanted: Mapping[str, str],
    name: str,
    *,
    codes: tuple[Code, Code],
    key: str,
) -> pd.DataFrame:
    """The fields of a table in memory as text, in the form of `text_table`.

    Missing values become empty texts, and numbers keep all their digits. ``name`` of the table is
    for refusals; the index are line numbers as if the first line were a header.
    """
    names = [str(column) for column in frame.columns]
    table_code, column_code = codes
    repeated = _repeated(names)
    if repeated:
        raise messages.frame_columns_repeated(code=table_code, where=name, columns=repeated)
    wanted_columns = [
        (quantity, column, f"{key}.{quantity}") for quantity, column in wanted.items()
    ]
    require_names(column_code, Path(name), names, wanted_columns)
    text = frame.astype(object).where(frame.notna(), "").map(str)
    text.index = pd.RangeIndex(len(text)) + LINE_OF_FIRST_ROW
    return text.set_axis(names, axis="columns")


def _repeated(names: Sequence[str]) -> str:
    """The names that occur twice or more, sorted and with commas between them; "" without any."""
    repeated = {name for name in names if names.count(name) > 1}
    return ", ".join(sorted(repeated))


def split_lines(lines: Sequence[str], names: Sequence[str], separator: str) -> pd.DataFrame:
    """Split lines at a regular expression into columns of text with the ``names``.

    Missing fields are empty, and further fields are dropped.

    >>> split_lines(["1 2,3", "4"], ["a", "b"], r"[ ,]").values.tolist()
    [['1', '2'], ['4', '']]
    """
    missing = [""] * len(names)
    rows = []
    for line in lines:
        fields = re.split(separator, line.strip()) + missing
        rows.append(fields[: len(names)])
    return pd.DataFrame(rows, columns=list(names), dtype=str)


def numbers(text: "pd.Series[str]", largest: float = LARGEST_NUMBER) -> Array:
    """(n,) fields as numbers; NaN for other text and for magnitudes above ``largest``."""
    return measured(stated_numbers(text), largest)


def stated_numbers(text: "pd.Series[str]") -> Array:
    """(n,) fields as numbers of any size; NaN for other text. -0 keeps its sign."""
    fields = text.to_numpy(object)
    # numpy would read 4_7 as 47, and pandas does not.
    has_underscore = any("_" in field for field in fields)
    if not has_underscore:
        with suppress(ValueError):
            return fields.astype(np.float64)
    return pd.to_numeric(text, errors="coerce").to_numpy(np.float64)


def numbers_in_text(text: "pd.Series[str]") -> Array:
    """(n,) fields as numbers, with decimal points or commas; NaN for other text.

    Numbers too large to be measured are NaN too.
    """
    values = np.array(pd.to_numeric(text, errors="coerce"), np.float64)
    has_comma = text.str.contains(",", regex=False, na=False)
    for row in np.flatnonzero(has_comma).tolist():
        with suppress(ValueError):
            values[row] = number_of(text.iloc[row])
    return measured(values)


def degrees_of(table: pd.DataFrame, name: str, path: Path, code: Code, *, quantity: str) -> Array:
    """(n,) the column ``name`` as degrees, from numbers or from degrees, minutes and seconds.

    ``quantity`` is latitude or longitude. A column of hemispheres, if there is one, gives the
    signs. NaN for empty fields; refuses (``code``) other text, and signs or letters that contradict
    the hemisphere.
    """
    fields = table[name]
    letters = LETTERS_OF_AXIS[quantity]
    hemispheres = _hemispheres_of(table, name, quantity)
    degrees = np.array(numbers(fields))
    wrong_rows = []
    has_hemisphere = (hemispheres != "").to_numpy()
    is_not_plain = np.isnan(degrees) | has_hemisphere
    for row in np.flatnonzero(is_not_plain).tolist():
        try:
            degrees[row] = angle_of(fields.iloc[row], hemispheres.iloc[row], letters)
        except ValueError:
            wrong_rows.append(row)
    if wrong_rows:
        first_row = wrong_rows[0]
        raise messages.fields_without_number(
            code=code,
            path=path,
            line=int(table.index[first_row]),
            column=name,
            count=len(wrong_rows),
            first=fields.iloc[first_row],
        )
    return degrees


def _hemispheres_of(table: pd.DataFrame, name: str, quantity: str) -> "pd.Series[str]":
    """(n,) the hemisphere of each row from a column of letters N, S or E, W; "" without one.

    ``name`` is the column of the angle. That of the letters has the same name with an ending, as
    "LatitudeRef" or "lat_hemisphere", or is named after the letters: "N/S".
    """
    letters = LETTERS_OF_AXIS[quantity]
    name_of_angle = _PUNCTUATION.sub("", name.lower())
    names_of_hemispheres = {letters.lower()}
    for ending in _ENDINGS_OF_HEMISPHERE:
        names_of_hemispheres.add(name_of_angle + ending)
    for column in table.columns:
        plain_name = _PUNCTUATION.sub("", str(column).lower())
        if plain_name not in names_of_hemispheres:
            continue
        values = table[column].str.strip()
        filled = values[values != ""]
        first_letters = filled.str[0].str.upper()
        if first_letters.isin(list(letters)).all():
            return values
    return pd.Series("", index=table.index, dtype=str)


def numbers_of(
    table: pd.DataFrame, name: str, path: Path, code: Code, largest: float = LARGEST_NUMBER
) -> Array:
    """(n,) the column ``name`` as numbers; NaN for empty fields.

    Refuses (``code``) other text and magnitudes above ``largest``, in contrast to `numbers`.
    """
    values = stated_numbers(table[name])
    is_stated = (table[name].str.strip() != "").to_numpy()
    wrong_rows = np.flatnonzero(is_stated & ~np.isfinite(values))
    if wrong_rows.size:
        first_row = wrong_rows[0]
        raise messages.fields_without_number(
            code=code,
            path=path,
            line=int(table.index[first_row]),
            column=name,
            count=wrong_rows.size,
            first=table[name].iloc[first_row],
        )
    lines = table.index.to_numpy()
    refuse_beyond(values, largest, path, code, column=name, lines=lines)
    return values


def largest_of(quantity: str) -> float:
    """The largest magnitude that a number of a quantity can have, in the unit of its column."""
    return LARGEST_OF_QUANTITIES.get(quantity, LARGEST_NUMBER)


def refuse_beyond(
    values: Array, largest: float, path: Path, code: Code, *, column: str, lines: Integers
) -> None:
    """Refuse (``code``) values (n,) with a magnitude above ``largest``; NaN passes.

    ``lines`` (n,) are the line numbers of the rows, for the message.
    """
    wrong_rows = np.flatnonzero(np.abs(values) > largest)
    if wrong_rows.size == 0:
        return
    first_row = int(wrong_rows[0])
    raise messages.numbers_beyond(
        code=code,
        path=path,
        line=int(lines[first_row]),
        column=column,
        count=wrong_rows.size,
        first=float(values[first_row]),
        largest=largest,
    )


def angles_in_radians(
    angles: Array, unit: AngleUnit, path: Path, code: Code, *, key: str, lines: "pd.Index[Any]"
) -> Array:
    """Convert angles (n, 3) from ``unit`` to radians; refuses (``code``) more than a full turn.

    ``key`` of the mission file states the unit, and ``lines`` (n,) are the line numbers of the
    rows: both are for the message, which suggests a unit in which no angle is more than a turn.
    """
    turn = {name: 2.0 * np.pi / radians for name, radians in RADIANS.items()}
    magnitude = np.abs(angles)
    is_beyond = (magnitude > turn[unit] * (1.0 + 1e-6)).any(axis=1)  # rounding is allowed
    if not bool(is_beyond.any()):
        return angles * RADIANS[unit]
    largest = float(np.nanmax(magnitude))
    likely_units = [name for name in turn if largest <= turn[name]]
    first_row = int(np.argmax(is_beyond))
    raise messages.angles_beyond_turn(
        code=code,
        path=path,
        line=int(lines[first_row]),
        count=int(is_beyond.sum()),
        turn=turn[unit],
        unit=unit,
        largest=largest,
        likely=likely_units[0] if likely_units else "",
        key=key,
    )


def utc_of_dates(text: "pd.Series[str]", system: str = "utc") -> tuple[TimeArray, Mask]:
    """Unix nanoseconds (n,) of dates with a time of day, and (n,) whether each is valid.

    ``text`` is ISO 8601, or has slashes between year, month and day; a time zone is applied.
    ``system`` is utc or gpst. Invalid are a year or month alone, other text, and times at which no
    survey can have been flown.
    """
    iso = text.str.replace("/", "-", regex=False).str.strip()
    has_day = iso.str.match(_WITH_DAY).to_numpy(np.bool_)
    stamps = pd.to_datetime(iso.where(has_day), utc=True, errors="coerce", format="ISO8601")
    good = stamps.notna().to_numpy()
    time_ns = np.where(good, stamps.to_numpy("datetime64[ns]").astype(np.int64), 0)
    good = good & can_be_flown(time_ns)
    if system == "gpst":
        since_epoch_ns = time_ns - UNIX_NS_OF_GPS_EPOCH
        week, ns_of_week = np.divmod(since_epoch_ns, _WEEK_NS)
        time_ns = utc_of_gps(week, ns_of_week / 1e9)
    return time_ns, good


def utc_of_weeks(week: Array | int, seconds: Array, system: str) -> TimeArray:
    """(n,) Unix nanoseconds of weeks since 1980-01-06 and seconds (n,) within them.

    ``system`` is gpst, from which leap seconds are subtracted, or utc. The result is 0 if week or
    seconds are unknown (NaN), negative or too large, or the week is not a whole number, or before
    1990. In week 0 the seconds may count from 1980 on.
    """
    is_whole = week == np.floor(week)
    is_of_survey = (week >= FIRST_WEEK_OF_SURVEYS) & (week <= _MOST_WEEKS)
    is_week = is_whole & (is_of_survey | (week == 0))
    is_second = (seconds >= 0.0) & (seconds <= _MOST_SECONDS)
    is_time = is_week & is_second
    whole_weeks = whole_numbers(np.where(is_time, week, 0), 0, _MOST_WEEKS)
    seconds = np.where(is_time, seconds, 0.0)
    if system == "gpst":
        time_ns = utc_of_gps(whole_weeks, seconds)
    else:
        start_ns = UNIX_NS_OF_GPS_EPOCH + whole_weeks * _WEEK_NS
        time_ns = start_ns + np.rint(seconds * 1e9).astype(np.int64)
    return np.where(is_time, time_ns, 0)


def utc_of_columns(table: pd.DataFrame, names: Mapping[str, str]) -> tuple[TimeArray, Mask]:
    """Unix nanoseconds (n,) from columns of UTC or GPS time, and (n,) whether each is valid.

    ``names`` : time_utc, or gps_week and gps_seconds -> the column. Times without a zone are UTC;
    the leap seconds of their date are subtracted from GPS seconds.
    """
    if "time_utc" in names:
        return utc_of_dates(table[names["time_utc"]])
    week = numbers(table[names["gps_week"]])
    seconds = numbers(table[names["gps_seconds"]])
    is_whole = week == np.floor(week)
    good = np.isfinite(week) & np.isfinite(seconds) & is_whole
    good &= week >= FIRST_WEEK_OF_SURVEYS
    good &= seconds >= 0.0
    good &= seconds <= SECONDS_PER_WEEK
    known_week = np.where(good, week, np.nan)
    time_ns = utc_of_weeks(known_week, seconds, "gpst")
    return time_ns, good & can_be_flown(time_ns)


def require_names(
    code: Code, path: Path, columns: Sequence[str], wanted: Iterable[tuple[str, str, str]]
) -> None:
    """Refuse (``code``) a table with ``columns`` that lacks a wanted one; suggests a similar name.

    ``wanted`` : quantity, the user's name of its column, and the key of the mission file for that.

    >>> lacks = Code("A-B", means="...", effect="...", remedy="...")
    >>> require_names(lacks, Path("o.csv"), ["image", "x_pix"], [("x", "x_px", "k")])
    Traceback (most recent call last):
    unbend.errors.InputError: A-B: there is no column 'x_px' for the x; perhaps 'x_pix'?; the \
columns are image, x_pix
      where: o.csv
      to do: state the name of the column: k
    """
    for quantity, name, key in wanted:
        if name not in columns:
            similar = difflib.get_close_matches(name, columns, 1, _LEAST_SIMILAR)
            raise messages.column_missing(
                code=code,
                where=path,
                quantity=quantity,
                column=name,
                similar=similar[0] if similar else "",
                present=columns_in_words(columns),
                key=key,
            )


def require_columns(path: Path, schema: pa.Schema, wanted: Sequence[tuple[str, str, str]]) -> None:
    """Refuse a table of observations with columns that do not fit those ``wanted``.

    These are a missing column, two columns of one name, a column wanted for two quantities, and a
    column of neither text nor numbers. ``wanted`` : quantity, the user's name of its column, and
    the key of the mission file for that.
    """
    repeated = _repeated(schema.names)
    if repeated:
        raise messages.columns_repeated(where=path, twice=repeated)
    names = [name for _, name, _ in wanted]
    shared = sorted({name for name in names if names.count(name) > 1})
    if shared:
        raise messages.column_named_twice(where=path, shared=shared[0])
    require_names(messages.OBS_COLUMN, path, schema.names, wanted)
    for quantity, name, _ in wanted:
        kind = schema.field(name).type
        if not (is_text(kind) or is_number(kind)):
            if quantity in ("image", "point"):
                raise messages.names_of_other_type(where=path, column=name, kind=str(kind))
            raise messages.column_of_other_type(where=path, column=name, kind=str(kind))


def is_text(kind: Any) -> bool:
    """Whether an Arrow type is text, or a dictionary of text."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_number(kind: Any) -> bool:
    """Whether an Arrow type is a number or null, or a dictionary of these."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(
        pa.types.is_floating(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    )


def refuse_other_pixels(
    path: Path, schema: pa.Schema, direction: Direction, columns: Mapping[str, str]
) -> None:
    """Refuse x_px, y_px of a table that also has the results of the other direction.

    A mission that removes refraction needs x_displaced_px of such a table, and one that applies it
    needs x_corrected_px. ``columns`` : x_px, y_px -> the name of the column to read.
    """
    needed_pixels = "displaced"
    content = "ideal"
    if direction == "apply":
        needed_pixels = "corrected"
        content = "as measured"
    for role in ("x_px", "y_px"):
        needed_column = f"{role[0]}_{needed_pixels}_px"
        if needed_column in schema.names and columns[role] == role:
            raise messages.other_pixels(
                where=path,
                role=role,
                right=needed_column,
                content=content,
                direction=direction,
            )
