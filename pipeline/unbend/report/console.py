"""Consoles for texts, and tables and paragraphs on them.

Text is wrapped to the width of a terminal. A file or another program gets no colours, no wrapped
lines and no blanks at the ends of lines.
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

INDENT = 2  # columns before texts that belong to a mission

_WIDE = 100_000  # columns of an output that is not a terminal: no line is wrapped
_LARGE_SIGMA = 9.995  # from here on a sigma has one decimal: it would be written as 10.00
_BLANKS_AT_END = re.compile(r"[ \t]+(?=\n)")


class _TrimmedStream:
    """A stream without blanks at the ends of lines; all else is passed to the wrapped stream."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text of whole lines, as rich passes them."""
        return self._stream.write(_BLANKS_AT_END.sub("", text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class ReportConsole(Console):
    """Console that escapes control characters, and raises BrokenPipeError instead of exiting."""

    def on_broken_pipe(self) -> NoReturn:
        """Called by rich when the reader of the output has gone."""
        raise BrokenPipeError

    def render_str(self, text: str, **options: Any) -> Text:
        """Render markup as rich does, with control characters escaped except line breaks."""
        return super().render_str(visible(text, keep="\n"), **options)


def report_console(*, error: bool = False, quiet: bool = False) -> Console:
    """A console for standard output, or for standard error if ``error``.

    The environment variable ``COLUMNS`` sets its width. A ``quiet`` console prints nothing.
    """
    stream = sys.stderr if error else sys.stdout
    if stream.isatty():
        return ReportConsole(stderr=error, highlight=False, quiet=quiet)
    file: Any = _TrimmedStream(stream)
    width = None if os.environ.get("COLUMNS", "").isdigit() else _WIDE
    return ReportConsole(file=file, width=width, highlight=False, quiet=quiet)


def shown(text: str) -> str:
    r"""Escape a text from a file, or a name, for a console: no markup, no control characters.

    >>> print(shown("[red]a\x1b[1m\nb"))
    \[red]a\x1b[1m\nb
    """
    return escape(visible(text))


def print_indented(console: Console, content: str | Table) -> None:
    """Print markup or a table, indented by two columns."""
    console.print(Padding(content, (0, 0, 0, INDENT), expand=False))


def print_hanging(console: Console, content: str) -> None:
    """Print markup indented by `INDENT` columns, and its further lines by `HANG` more."""
    width = max(NARROWEST, console.width - INDENT - HANG)
    indent = INDENT
    text = console.render_str(content)
    for line in text.wrap(console, width):
        console.print(Padding.indent(line, indent))
        indent = INDENT + HANG


def plain_table(heads: Sequence[str], *, gap: int) -> Table:
    """An empty table without lines, with all columns but the first aligned to the right.

    ``gap`` is the distance between columns, in characters.
    """
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
    """Print rows of plain texts as a table, indented by two columns.

    The first column and those with an index in ``left`` are aligned to the left.
    """
    table = plain_table(heads, gap=gap)
    for column in left:
        table.columns[column].justify = "left"
    for row in rows:
        table.add_row(*map(shown, row))
    print_indented(console, table)


class TableColumn(NamedTuple):
    """A column of a printed table, from ``printed_columns.toml``.

    ``name`` is the key of the value in a row; the value divided by ``unit`` is printed, as 100 for
    hectopascals of pascals. ``digits`` is a format, or ``sigma``: two decimals, and one from 10 on.
    """

    head: str
    name: str
    unit: float
    digits: str


Columns = Sequence[TableColumn]


@cache
def columns_of(name: str) -> Columns:
    """The columns of the table ``name`` in ``printed_columns.toml``."""
    text = (files("unbend.report") / "data/printed_columns.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    return [TableColumn(*column) for column in tables[name]]


def cells_of(row: Mapping[str, Any], columns: Columns) -> list[str]:
    """The text of each column for a row; "" for None.

    >>> cells_of({"p": 101325.0}, [TableColumn("p", "p", 100.0, ".1f")])
    ['1013.2']
    """
    return [cell_of(row[column.name], column) for column in columns]


def cell_of(value: float | None, column: TableColumn) -> str:
    """The text of a value in the unit of its column; "" for None."""
    if value is None:
        return ""
    in_unit = value / column.unit
    digits = column.digits
    if digits == "sigma":
        digits = ".1f" if in_unit >= _LARGE_SIGMA else ".2f"
    return f"{in_unit:{digits}}"


def print_labelled(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """Print lines of label and text as two columns, indented by two more."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in lines:
        table.add_row(shown(label), shown(text))
    print_indented(console, table)
