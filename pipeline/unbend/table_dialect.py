"""How a table is written: what parts its fields, its head, its decimals. One door for all tables.

The fields of a row are parted by commas, semicolons, tabs, bars or any number of blanks. The names
of the columns stand in the first line, or in the last of the comments before it, which begin with
``#`` or ``%``; the columns of a table without names are called 1, 2, 3 and so on. A table of
OpenDroneMap's (``geo.txt``) begins with its coordinate system, and has the names of its manual.
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

_UNDIVIDED = (0, 1)  # numeric columns and columns of a table that no separator divides

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
    names : of the columns, as they stand there, or as they are called where none stands there.
    lines_before : lines before the first row, or before the head where it is the first row.
    head_is_row : the names are the first row, and not a comment or absent.
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
        return self.lines_before + self.head_is_row + 1


def columns_in_words(names: Sequence[str]) -> str:
    """The names of columns, or that a table has no head.

    >>> columns_in_words(["image", "x"]), columns_in_words(["1", "2"])
    ('image, x', 'no header: its columns are named 1 to 2')
    """
    if list(names) == [str(number) for number in range(1, len(names) + 1)]:
        return f"no header: its columns are named 1 to {len(names)}"
    return ", ".join(names)


def split_rows(lines: Iterable[str], separator: str) -> list[list[str]]:
    """The fields of lines that are not empty, without quotes and blanks around them.

    Raises ValueError for what no table of text has.

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
    """How a table is written, by its first lines; raises ValueError where they do not show it.

    >>> form = form_of(["# Cameras (1)", "# PhotoID, X, Y", "IMG_1.JPG\\t1,5\\t-2,5"])
    >>> form.separator, form.names, form.lines_before, form.decimal_comma
    ('\\t', ('PhotoID', 'X', 'Y'), 2, True)
    """
    before = _lines_before_rows(lines)
    body = [line for line in lines[before : before + MOST_ROWS] if line.strip()]
    if not body:
        body = [_last_comment(lines)]  # a head without rows
    separator = _separator_of(lines[:before], body)
    rows = split_rows(body, separator)
    names_before = _names_before_rows(lines[:before], len(rows[0]))
    names = tuple(rows[0])
    first_is_head = _is_head(rows, has_names_before=bool(names_before))
    if not first_is_head:
        names = names_before or tuple(str(number) for number in range(1, len(names) + 1))
    _refuse_grouped_thousands(rows[first_is_head:])
    return TableForm(
        separator=separator,
        names=names,
        lines_before=before,
        head_is_row=first_is_head,
        decimal_comma=_has_decimal_commas(rows[first_is_head:], separator),
    )


def _last_comment(lines: Sequence[str]) -> str:
    """The text of the last comment; raises ValueError for an empty table."""
    for line in reversed(lines):
        if _is_comment(line):
            return line.strip().lstrip("#% ")
    raise ValueError("it is empty")


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%"))


def _lines_before_rows(lines: Sequence[str]) -> int:
    """How many lines stand before head and rows: comments, empty ones, those of a program."""
    for number, line in enumerate(lines):
        of_program = _SEPARATOR_OF_SPREADSHEET.fullmatch(line) or _COORDINATE_SYSTEM.fullmatch(line)
        if line.strip() and not _is_comment(line) and not of_program:
            return number
    return len(lines)


def _separator_of(before: Sequence[str], body: Sequence[str]) -> str:
    """The separator that gives most numeric columns, then most columns; a comma without any.

    No row may be longer than the first; with blanks none shorter. A separator that a spreadsheet
    states is taken as it is. ValueError if only separators with a longer row were found.
    """
    stated_separator = _stated_separator(before)
    if stated_separator:
        return stated_separator
    best = ","
    best_score = _UNDIVIDED
    longer = ""
    for separator in SEPARATORS:
        rows = split_rows(body, separator)
        widths = [len(row) for row in rows]
        width = widths[0]
        if width < 2 or (separator == BLANKS and min(widths) < width):
            continue
        score = (len(_numeric_columns(rows[1:] or rows)), width)
        if max(widths) > width:
            words = WORDS_OF_SEPARATORS[separator]
            longer = f"by {words} its first row has {width} fields, and a later one {max(widths)}"
        elif score > best_score:
            best = separator
            best_score = score
    if longer and best_score == _UNDIVIDED:
        raise ValueError(longer)
    return best


def _stated_separator(before: Sequence[str]) -> str:
    """What a line ``sep=;`` of a spreadsheet says; empty without one."""
    for line in before:
        stated = _SEPARATOR_OF_SPREADSHEET.fullmatch(line)
        if stated is not None and stated[1] in SEPARATORS:
            return stated[1]
    return ""


def _is_head(rows: Sequence[Sequence[str]], *, has_names_before: bool) -> bool:
    """Whether the first row names columns: it has text where the others have numbers."""
    first = rows[0]
    if len(rows) == 1:
        return not (has_names_before and any(map(is_number, first)))
    numeric = _numeric_columns(rows[1:])
    return not numeric or any(k >= len(first) or not is_number(first[k]) for k in numeric)


def _numeric_columns(rows: Sequence[Sequence[str]]) -> list[int]:
    """The columns that hold numbers and nothing else, at least one."""
    numeric = []
    for column in range(max(map(len, rows), default=0)):
        filled = _filled_fields(rows, column)
        if filled and all(map(is_number, filled)):
            numeric.append(column)
    return numeric


def _names_before_rows(before: Sequence[str], width: int) -> tuple[str, ...]:
    """The names of the columns in the lines before the rows; empty where there are none.

    They are in the last comment that has as many fields as the rows, by whatever parts them.
    """
    for line in reversed(before):
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
    """The fields of a comment, by the separator by which there are so many; empty for none."""
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
    """Raise ValueError for a column of numbers of which some group their thousands."""
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

    Raises ValueError where the commas of all of them may group thousands. Semicolons are those of
    countries with a decimal comma.
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
    """The fields of a column with decimal points, if all of them are numbers, some with commas.

    Commas that may group thousands are left, unless the table has a ``decimal_comma`` elsewhere.

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
