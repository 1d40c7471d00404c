"""How a table of text is written: its separator, its head, its decimals. Used for all tables.

The fields of a row are separated by commas, semicolons, tabs, bars or any number of blanks. The
names of the columns are in the first line, or in the last comment before it (``#`` or ``%``); the
columns of a table without names are called 1, 2, 3 and so on. A table of OpenDroneMap
(``geo.txt``) begins with its coordinate system, and has the names of its manual.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from unbend.written_numbers import has_grouped_thousands, is_number, may_be_thousands

BLANKS = " "  # stands for any number of blanks and tabs
SEPARATORS = (",", ";", "\t", "|", BLANKS)
WORDS_OF_SEPARATORS = {
    ",": "commas",
    ";": "semicolons",
    "\t": "tabs",
    "|": "bars",
    BLANKS: "blanks",
}
MOST_ROWS = 200  # that show how a table is written

_UNDIVIDED = (0, 1)  # score, as in `_separator_of`, of a table that no separator divides

_FIELD_BETWEEN_BLANKS = re.compile(r'"(?:[^"]|"")*"|[^\s"]\S*')
_SEPARATOR_OF_SPREADSHEET = re.compile(r"\"?sep=(.)\"?\s*", re.IGNORECASE)
_COORDINATE_SYSTEM = re.compile(
    r"\s*(?:EPSG:\d+|\+proj=\w.*|WGS84 UTM \d+\s*[NS])\s*", re.IGNORECASE
)
_DEGREES = re.compile(r"EPSG:(?:4326|4979)\s*$|\+proj=(?:longlat|latlong)\b", re.IGNORECASE)
_NAMES_OF_ODM = ("yaw", "pitch", "roll", "horizontal_accuracy", "vertical_accuracy", "label")


@dataclass(frozen=True)
class TableForm:
    """How the lines of a table are written.

    separator : one of `SEPARATORS`.
    names : of the columns, as in the head; 1, 2, 3 and so on for a table without a head.
    lines_before : lines before the first row, or before the head where it is the first row.
    head_is_row : the names are in the first row; False for names in a comment, and without a head.
    decimal_comma : numbers have a decimal comma, and none has a decimal point.
    """

    separator: str
    names: tuple[str, ...]
    lines_before: int = 0
    head_is_row: bool = True
    decimal_comma: bool = False

    @property
    def line_of_first_row(self) -> int:
        """The number of the line of the first row, counted from 1."""
        lines_of_head = 1 if self.head_is_row else 0
        return self.lines_before + lines_of_head + 1


def columns_in_words(names: Sequence[str]) -> str:
    """The names of columns for a message; or, for names 1, 2, 3, that the table has no head.

    >>> columns_in_words(["image", "x"]), columns_in_words(["1", "2"])
    ('image, x', 'no header: its columns are named 1 to 2')
    """
    if list(names) == [str(number) for number in range(1, len(names) + 1)]:
        return f"no header: its columns are named 1 to {len(names)}"
    return ", ".join(names)


def split_rows(lines: Iterable[str], separator: str) -> list[list[str]]:
    """The fields of lines that are not empty, without quotes and blanks around them.

    Raises ValueError for lines that cannot be a table of text, with a zero byte for example.

    >>> split_rows(['a;"b;c"', "", " 1 ;2"], ";")
    [['a', 'b;c'], ['1', '2']]
    >>> split_rows(['IMG_1.JPG   1,5 "x y"'], BLANKS)
    [['IMG_1.JPG', '1,5', 'x y']]
    """
    filled = (line for line in lines if line.strip())
    if separator == BLANKS:
        return [
            [field.strip('"') for field in _FIELD_BETWEEN_BLANKS.findall(line)] for line in filled
        ]
    try:
        rows = list(csv.reader(filled, delimiter=separator, skipinitialspace=True))
    except csv.Error as error:  # a byte of zero, a field of 128 KiB
        raise ValueError(str(error)) from None
    return [[field.strip() for field in row] for row in rows]


def form_of(lines: Sequence[str]) -> TableForm:
    """How a table is written, decided from its first lines.

    Raises ValueError for an empty table, and for lines that leave the form open: rows that are
    longer than the first one, and numbers with a comma or point that may group thousands.

    >>> form = form_of(["# Cameras (1)", "# PhotoID, X, Y", "IMG_1.JPG\\t1,5\\t-2,5"])
    >>> form.separator, form.names, form.lines_before, form.decimal_comma
    ('\\t', ('PhotoID', 'X', 'Y'), 2, True)
    """
    line_count = _count_lines_before(lines)
    lines_before = lines[:line_count]
    body = [line for line in lines[line_count : line_count + MOST_ROWS] if line.strip()]
    if not body:
        body = [_last_comment(lines)]  # a head without rows
    separator = _separator_of(lines_before, body)
    rows = split_rows(body, separator)
    names_before = _names_before_rows(lines_before, len(rows[0]))
    first_is_head = _is_head(rows, has_names_before=bool(names_before))
    if first_is_head:
        names = tuple(rows[0])
        value_rows = rows[1:]
    else:
        names = names_before or tuple(str(number) for number in range(1, len(rows[0]) + 1))
        value_rows = rows
    _refuse_grouped_thousands(value_rows)
    return TableForm(
        separator=separator,
        names=names,
        lines_before=line_count,
        head_is_row=first_is_head,
        decimal_comma=_has_decimal_commas(value_rows, separator),
    )


def _last_comment(lines: Sequence[str]) -> str:
    """The text of the last comment; raises ValueError for a table without a comment."""
    for line in reversed(lines):
        if _is_comment(line):
            return line.strip().lstrip("#% ")
    raise ValueError("it is empty")


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _count_lines_before(lines: Sequence[str]) -> int:
    """How many lines are before the first row (head or values).

    These are comments, empty lines, ``sep=;`` of a spreadsheet, and a coordinate system.
    """
    for number, line in enumerate(lines):
        of_program = _SEPARATOR_OF_SPREADSHEET.fullmatch(line) or _COORDINATE_SYSTEM.fullmatch(line)
        if line.strip() and not _is_comment(line) and not of_program:
            return number
    return len(lines)


def _separator_of(lines_before: Sequence[str], body: Sequence[str]) -> str:
    """The separator that gives most numeric columns, then most columns; a comma without any.

    ``body`` are the lines of head and values. A separator is out if a row has more fields than the
    first one, and blanks also if one has fewer. Raises ValueError if rows are too long and no other
    separator divides the rows. A separator that a spreadsheet states is taken as it is.
    """
    stated_separator = _stated_separator(lines_before)
    if stated_separator:
        return stated_separator
    best = ","
    best_score = _UNDIVIDED
    problem = ""
    for separator in SEPARATORS:
        rows = split_rows(body, separator)
        widths = [len(row) for row in rows]
        width = widths[0]
        if width < 2 or (separator == BLANKS and min(widths) < width):
            continue
        score = (len(_numeric_columns(rows[1:] or rows)), width)
        if max(widths) > width:
            words = WORDS_OF_SEPARATORS[separator]
            problem = f"by {words} its first row has {width} fields, and a later one {max(widths)}"
        elif score > best_score:
            best = separator
            best_score = score
    if problem and best_score == _UNDIVIDED:
        raise ValueError(problem)
    return best


def _stated_separator(lines_before: Sequence[str]) -> str:
    """The separator that a spreadsheet states in a line ``sep=;``; empty without such a line."""
    for line in lines_before:
        stated = _SEPARATOR_OF_SPREADSHEET.fullmatch(line)
        if stated is not None and stated[1] in SEPARATORS:
            return stated[1]
    return ""


def _is_head(rows: Sequence[Sequence[str]], *, has_names_before: bool) -> bool:
    """Whether the first row names the columns.

    It does if a column that has numbers in the other rows has a text in the first, or if no column
    has numbers. A single row is a head, unless it has numbers and comments before it have names.
    """
    first = rows[0]
    if len(rows) == 1:
        has_numbers = any(map(is_number, first))
        return not (has_names_before and has_numbers)
    numeric_columns = _numeric_columns(rows[1:])
    if not numeric_columns:
        return True
    fields = [first[column] for column in numeric_columns if column < len(first)]
    return len(fields) < len(numeric_columns) or not all(map(is_number, fields))


def _numeric_columns(rows: Sequence[Sequence[str]]) -> list[int]:
    """The columns, from 0, that have numbers and no text; empty fields do not count."""
    numeric = []
    for column in range(max(map(len, rows), default=0)):
        filled = _filled_fields(rows, column)
        if filled and all(map(is_number, filled)):
            numeric.append(column)
    return numeric


def _names_before_rows(lines_before: Sequence[str], width: int) -> tuple[str, ...]:
    """The names of ``width`` columns in the lines before the rows; empty without names.

    They are in the last comment that has as many fields, by any separator. A coordinate system of
    OpenDroneMap stands for the names of its manual.
    """
    for line in reversed(lines_before):
        if _COORDINATE_SYSTEM.fullmatch(line):
            names = _names_of_odm(line)
            return names[:width] if width <= len(names) else ()
        if _is_comment(line):
            names = _names_in_comment(line, width)
            if names:
                return names
    return ()


def _names_of_odm(system: str) -> tuple[str, ...]:
    """The names of the columns of OpenDroneMap's table, by its coordinate system."""
    if _DEGREES.match(system.strip()):
        return ("image", "longitude", "latitude", "height", *_NAMES_OF_ODM)
    return ("image", "x", "y", "z", *_NAMES_OF_ODM)


def _names_in_comment(line: str, width: int) -> tuple[str, ...]:
    """The ``width`` fields of a comment, by the first separator that gives so many; else empty."""
    text = line.strip().lstrip("#% ")
    if not text:
        return ()
    for separator in SEPARATORS:
        (fields,) = split_rows([text], separator)
        if len(fields) == width:
            return tuple(fields)
    return ()


def _filled_fields(rows: Sequence[Sequence[str]], column: int) -> list[str]:
    """The fields of a column that are not empty."""
    fields = [row[column] for row in rows if column < len(row)]
    return [field for field in fields if field]


def _refuse_grouped_thousands(rows: Sequence[Sequence[str]]) -> None:
    """Raise ValueError for a column of numbers if some of them have grouped thousands (8'927)."""
    width = max(map(len, rows), default=0)
    for column in range(width):
        filled = _filled_fields(rows, column)
        grouped = [field for field in filled if has_grouped_thousands(field)]
        plain_fields = [field for field in filled if not has_grouped_thousands(field)]
        if grouped and all(map(is_number, plain_fields)):
            raise ValueError(
                f"{grouped[0]!r} groups its thousands; write numbers without such separators"
            )


def _has_decimal_commas(rows: Sequence[Sequence[str]], separator: str) -> bool:
    """Whether numbers have a decimal comma, and none has a decimal point.

    Raises ValueError where the commas of all of them may group thousands; but not for a table with
    semicolons, which spreadsheets write in countries with a decimal comma.
    """
    fields = [row[column] for column in _numeric_columns(rows) for row in rows if column < len(row)]
    with_comma = [field for field in fields if "," in field]
    if not with_comma or any("." in field for field in fields):
        return False
    if separator != ";" and all(map(may_be_thousands, with_comma)):
        raise ValueError(
            f"{with_comma[0]!r} may be thousands or a decimal comma; write decimal points"
        )
    return True


def with_decimal_points(fields: Sequence[str], *, decimal_comma: bool) -> Sequence[str]:
    """The fields of a column with points instead of decimal commas.

    The fields stay as they are if one of them is a text or has a point, or if all commas may group
    thousands. The last rule is left out if the table is known to have a ``decimal_comma``.

    >>> with_decimal_points(["3000,3", "", "12"], decimal_comma=False)
    ['3000.3', '', '12']
    >>> with_decimal_points(["1,234"], decimal_comma=False)
    ['1,234']
    """
    with_comma = [field for field in fields if "," in field]
    if not with_comma:
        return fields
    filled = [field for field in fields if field.strip()]
    if any("." in field for field in filled) or not all(map(is_number, filled)):
        return fields
    if not decimal_comma and all(map(may_be_thousands, with_comma)):
        return fields
    return [field.replace(",", ".") for field in fields]
