"""Consoles for texts: as wide as a terminal, or lines as they are for a file or the next program.

What is not a terminal gets no colours, no broken lines and no blanks at the ends of lines.
"""

import os
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple, NoReturn, TextIO

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from unbend.report.words import HANG, NARROWEST, visible

INDENT = 2  # columns by which what belongs to a mission stands to the right

_WIDE = 100_000  # columns of what is not a terminal: no line is broken
_LARGE_SIGMA = 9.995  # from here on a sigma has one decimal
_BLANKS_AT_END = re.compile(r"[ \t]+(?=\n)")


class _Trimmed:
    """A stream that removes the blanks at the ends of lines, and else is the stream it wraps."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write whole lines; rich gives them."""
        return self._stream.write(_BLANKS_AT_END.sub("", text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class ReportConsole(Console):
    """Console that writes control characters out, and raises BrokenPipeError instead of exiting."""

    def on_broken_pipe(self) -> NoReturn:
        """Called by rich when the reader of the output has gone."""
        raise BrokenPipeError

    def render_str(self, text: str, **options: Any) -> Text:
        """As rich does, with all control characters but line breaks written out."""
        return super().render_str(visible(text, keep="\n"), **options)


def report_console(*, error: bool = False, quiet: bool = False) -> Console:
    """Console for standard output, or for standard error; ``COLUMNS`` sets the width of both."""
    stream = sys.stderr if error else sys.stdout
    if stream.isatty():
        return ReportConsole(stderr=error, highlight=False, quiet=quiet)
    file: Any = _Trimmed(stream)
    width = None if os.environ.get("COLUMNS", "").isdigit() else _WIDE
    return ReportConsole(file=file, width=width, highlight=False, quiet=quiet)


def shown(text: str) -> str:
    r"""A text of a file or a name for a console: no markup, no control characters.

    >>> print(shown("[red]a\x1b[1m\nb"))
    \[red]a\x1b[1m\nb
    """
    return escape(visible(text))


def print_indented(console: Console, content: str | Table) -> None:
    """Print markup or a table two columns to the right."""
    console.print(Padding(content, (0, 0, 0, 2), expand=False))


def print_hanging(console: Console, content: str) -> None:
    """Print markup two columns to the right, its further lines `HANG` columns behind the first."""
    width = max(NARROWEST, console.width - INDENT - HANG)
    indent = INDENT
    text = console.render_str(content)
    for line in text.wrap(console, width):
        console.print(Padding.indent(line, indent))
        indent = INDENT + HANG


def plain_table(heads: Sequence[str], *, gap: int) -> Table:
    """A table without lines, all columns but the first aligned to the right."""
    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0))
    for head in heads:
        table.add_column(escape(head))
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def print_rows(
    console: Console,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    gap: int,
    left: Sequence[int] = (),
) -> None:
    """Print texts as a table, two columns to the right; ``left`` : columns that begin there."""
    table = plain_table(heads, gap=gap)
    for column in left:
        table.columns[column].justify = "left"
    for row in rows:
        table.add_row(*map(shown, row))
    print_indented(console, table)


class TableColumn(NamedTuple):
    """A column of a printed table; see ``printed_columns.toml``.

    ``name`` is the key of a row, ``unit`` what one unit of the column is in the unit of the row,
    ``digits`` a format, or ``sigma``: two decimals, one for large values.
    """

    head: str
    name: str
    unit: float
    digits: str


Columns = Sequence[TableColumn]


@cache
def columns_of(name: str) -> Columns:
    """The columns of a table in ``printed_columns.toml``."""
    text = (files("unbend.report") / "data/printed_columns.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    return [TableColumn(*column) for column in tables[name]]


def cells_of(row: Mapping[str, Any], columns: Columns) -> list[str]:
    """The texts of a row; empty where it has no value.

    >>> cells_of({"p": 101325.0}, [TableColumn("p", "p", 100.0, ".1f")])
    ['1013.2']
    """
    return [cell_of(row[column.name], column) for column in columns]


def cell_of(value: float | None, column: TableColumn) -> str:
    """The text of a value in the unit of its column; empty without a value."""
    if value is None:
        return ""
    in_unit = value / column.unit
    digits = column.digits
    if digits == "sigma":
        digits = ".1f" if in_unit >= _LARGE_SIGMA else ".2f"
    return f"{in_unit:{digits}}"


def print_labelled(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """Lines with their labels in a column before them."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in lines:
        table.add_row(shown(label), shown(text))
    print_indented(console, table)
