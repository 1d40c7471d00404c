"""Columns by the user's names: what is refused, and small tables as text, numbers and times."""

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

_LEAST_SIMILAR = 0.5  # of names, by difflib: x_pix is 0.89 to x_px
LINE_OF_FIRST_ROW = 2  # of a table in memory, as though its first line were its header
_PUNCTUATION = re.compile(r"[^a-z0-9]")
_ENDINGS_OF_HEMISPHERE = ("ref", "hemisphere", "hemi", "dir")
_QUANTITIES_OF_NAMES = ("image", "camera", "point")  # whose columns hold text
LARGEST_OF_QUANTITIES = {
    "latitude": 90.0,
    "longitude": 360.0,
    "height": LARGEST_HEIGHT_M,
}
"""What the numbers of a column are at most, where that is less than `LARGEST_NUMBER`."""

_MOST_WEEKS = 10_000  # until 2171: 64 bits of nanoseconds hold it
_MOST_SECONDS = 1e9  # within a week, or since 1980 by a table that counts on
_WEEK_NS = SECONDS_PER_WEEK * 10**9
# ISO 8601 with year, month and day; years of four digits that nanoseconds since 1970 can count.
_WITH_DAY = r"(?:19|20)\d\d(?:-\d{1,2}-\d{1,2}|\d{4})(?!\d)"
# 1990: no survey had GPS before. Receivers that count weeks modulo 1024 state such weeks today.
FIRST_WEEK_OF_SURVEYS = 521


def text_table(
    path: Path, wanted: Mapping[str, str], *, codes: tuple[Code, Code], key: str
) -> pd.DataFrame:
    """All fields as text, by the names of their columns; a field that is not there is empty.

    The table has any form that `unbend.table_dialect` knows; numbers with a decimal comma come
    with a point. The index are the numbers of the lines. ``wanted`` : quantity -> name of its
    column, as stated under ``key`` of the mission file. Refuses what is no table or has two columns
    of one name (the first of ``codes``), and one that lacks a column (the second).
    """
    of_names = {name for quantity, name in wanted.items() if quantity in _QUANTITIES_OF_NAMES}
    table_code, column_code = codes
    table = unrepeated_table(path, table_code, of_names)
    wanted_columns = [(quantity, name, f"{key}.{quantity}") for quantity, name in wanted.items()]
    require_names(column_code, path, table.columns.tolist(), wanted_columns)
    return table


def unrepeated_table(path: Path, code: Code, of_names: Collection[str]) -> pd.DataFrame:
    """As `whole_table`; refuses (``code``) a table with two columns of one name, too."""
    table = whole_table(path, code, of_names)
    repeated = _repeated(table.columns.tolist())
    if repeated:
        why = f"the columns {repeated} occur twice"
        raise messages.csv_unreadable(code=code, where=path, error=why)
    return table


def whole_table(path: Path, code: Code, of_names: Collection[str]) -> pd.DataFrame:
    """The table of `text_table`, whatever columns it has; refuses (``code``) what is no table.

    The columns ``of_names`` stay as they are, even where they look like numbers.
    """
    try:
        file = text_file(path)
        form = file.form
        # The head is read as a row: pandas takes longer rows for an index and renames repeats.
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
        if name not in of_names and with_points is not fields:
            table.isetitem(column, list(with_points))
    return table


def _comments_between_rows(table: pd.DataFrame) -> Mask:
    """(n,) the rows that begin with # or % and have no other field."""
    begins_so = table.iloc[:, 0].str.startswith(("#", "%"))
    has_no_other = (table.iloc[:, 1:] == "").all(axis=1)
    return np.asarray(begins_so & has_no_other, np.bool_)


def text_of_frame(
    frame: pd.DataFrame,
    wanted: Mapping[str, str],
    name: str,
    *,
    codes: tuple[Code, Code],
    key: str,
) -> pd.DataFrame:
    """The fields of a table in memory as `text_table` reads them; numbers keep all their digits."""
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
    """The names that occur twice or more, sorted and with commas between them."""
    repeated = {name for name in names if names.count(name) > 1}
    return ", ".join(sorted(repeated))


def split_lines(lines: Sequence[str], names: Sequence[str], separator: str) -> pd.DataFrame:
    """Lines as rows of text, split at the regular expression; a field that is not there is empty.

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
    """(n,) numbers of fields, NaN where one is none or beyond the ``largest``."""
    return measured(stated_numbers(text), largest)


def stated_numbers(text: "pd.Series[str]") -> Array:
    """(n,) numbers of fields of any size, NaN where one is none; -0 keeps its sign.

    Python would read 4_7 as 47; in a table that is no number.
    """
    fields = text.to_numpy(object)
    has_underscore = any("_" in field for field in fields)
    if not has_underscore:
        with suppress(ValueError):
            return fields.astype(np.float64)
    return pd.to_numeric(text, errors="coerce").to_numpy(np.float64)


def numbers_in_text(text: "pd.Series[str]") -> Array:
    """(n,) numbers of fields among which others are text; with decimal points or commas."""
    values = np.array(pd.to_numeric(text, errors="coerce"), np.float64)
    has_comma = text.str.contains(",", regex=False, na=False)
    for row in np.flatnonzero(has_comma).tolist():
        with suppress(ValueError):
            values[row] = number_of(text.iloc[row])
    return measured(values)


def degrees_of(
    table: pd.DataFrame,
    name: str,
    path: Path,
    code: Code,
    *,
    quantity: str,
) -> Array:
    """(n,) a column of latitudes or longitudes [deg], as numbers or in degrees and minutes.

    A column of hemispheres beside it gives the signs. NaN where a field is empty; refuses
    (``code``) any other text, and a sign or letter of another hemisphere.
    """
    fields = table[name]
    letters = LETTERS_OF_AXIS[quantity]
    hemispheres = _hemispheres_of(table, name, quantity)
    degrees = np.array(numbers(fields))
    unread = []
    has_hemisphere = (hemispheres != "").to_numpy()
    in_parts = np.isnan(degrees) | has_hemisphere
    for row in np.flatnonzero(in_parts).tolist():
        try:
            degrees[row] = angle_of(fields.iloc[row], hemispheres.iloc[row], letters)
        except ValueError:
            unread.append(row)
    if unread:
        first_row = unread[0]
        raise messages.fields_without_number(
            code=code,
            path=path,
            line=int(table.index[first_row]),
            column=name,
            count=len(unread),
            first=fields.iloc[first_row],
        )
    return degrees


def _hemispheres_of(table: pd.DataFrame, name: str, quantity: str) -> "pd.Series[str]":
    """(n,) the hemisphere of each row, by a column that is called so; else empty.

    Its name is that of the angle with "ref", "hemisphere" or "dir" behind it, or N/S, E/W.
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
    """(n,) a column as numbers, NaN where a field is empty.

    Refuses (``code``) any other text, and numbers beyond the ``largest``.
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
    """What the numbers of a column of a quantity are at most."""
    return LARGEST_OF_QUANTITIES.get(quantity, LARGEST_NUMBER)


def refuse_beyond(
    values: Array, largest: float, path: Path, code: Code, *, column: str, lines: Integers
) -> None:
    """Refuse (``code``) numbers (n,) beyond the ``largest``; ``lines`` (n,) are those of the rows.

    NaN is unknown.
    """
    beyond = np.flatnonzero(np.abs(values) > largest)
    if beyond.size == 0:
        return
    first = int(beyond[0])
    raise messages.numbers_beyond(
        code=code,
        path=path,
        line=int(lines[first]),
        column=column,
        count=beyond.size,
        first=float(values[first]),
        largest=largest,
    )


def angles_in_radians(
    given: Array, unit: AngleUnit, path: Path, code: Code, *, key: str, lines: "pd.Index[Any]"
) -> Array:
    """(n, 3) angles in radians; refuses (``code``) more than a full turn in the unit stated.

    ``key`` is the mission file's for the unit; ``lines`` (n,) are those of the rows.
    """
    turn = {name: 2.0 * np.pi / size for name, size in RADIANS.items()}
    size = np.abs(given)
    is_beyond = (size > turn[unit] * (1.0 + 1e-6)).any(axis=1)
    if not bool(is_beyond.any()):
        return given * RADIANS[unit]
    largest = float(np.nanmax(size))
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
    """(n,) Unix nanoseconds of dates with a time of day in UTC or GPS time; which are good.

    ISO 8601, or with slashes between year, month and day; zones are honoured. A year or a month
    alone is no time, and a time at which no survey can have been flown is none either.
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
    """(n,) Unix nanoseconds of weeks since 1980-01-06 and their seconds, in GPS time or UTC.

    0 where one of both is unknown (NaN), negative or beyond all dates, or the week not whole.
    """
    is_whole = week == np.floor(week)
    is_week = is_whole & (week >= 0) & (week <= _MOST_WEEKS)
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
    """(n,) Unix nanoseconds from a column of UTC times, or GPS week and seconds; which are good.

    Times without a zone are UTC; GPS seconds are reduced by the leap seconds of their date.
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
    code: Code,
    path: Path,
    there: Sequence[str],
    wanted: Iterable[tuple[str, str, str]],
) -> None:
    """Refuse a table that lacks a column, with the name it may have been meant to be.

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
        if name not in there:
            similar = difflib.get_close_matches(name, there, 1, _LEAST_SIMILAR)
            raise messages.column_missing(
                code=code,
                where=path,
                quantity=quantity,
                column=name,
                similar=similar[0] if similar else "",
                present=columns_in_words(there),
                key=key,
            )


def require_columns(
    path: Path,
    schema: pa.Schema,
    wanted: Sequence[tuple[str, str, str]],
) -> None:
    """Refuse a table that lacks a column or has two of one name, and one column for two quantities.

    ``wanted`` : quantities, the user's names of their columns, which have to hold text or numbers,
    and the keys of the mission file for these.
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
    """Whether an Arrow type is text, a dictionary of texts included."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_number(kind: Any) -> bool:
    """Whether an Arrow type is a number or null throughout, a dictionary of these included."""
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
    """Refuse, in a table of our results, the pixels that went in where those that came out are due.

    ``columns`` : x_px, y_px -> the name of the column that is to be read.
    """
    due = "displaced"
    content = "ideal"
    if direction == "apply":
        due = "corrected"
        content = "as measured"
    for role in ("x_px", "y_px"):
        right = f"{role[0]}_{due}_px"
        if right in schema.names and columns[role] == role:
            raise messages.other_pixels(
                where=path,
                role=role,
                right=right,
                content=content,
                direction=direction,
            )
