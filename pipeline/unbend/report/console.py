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
from typing import Any, NoReturn, TextIO

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from unbend.report.words import HANG, NARROWEST, visible

INDENT = 2  # columns by which what belongs to a mission stands to the right

_WIDE = 100_000  # columns of what is not a terminal: no line is broken
_BLANKS_AT_END = re.compile(r"[ \t]+(?=\n)")


class _Trimmed:
    """A stream whose lines lose the blanks at their ends; the rest is the stream's own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(_BLANKS_AT_END.sub("", text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class ReportConsole(Console):
    """Console that writes control characters out, and raises BrokenPipeError instead of exiting."""

    def on_broken_pipe(self) -> NoReturn:
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
    width = console.width - INDENT - HANG
    width = max(NARROWEST, width)
    indent = INDENT
    text = console.render_str(content)
    for line in text.wrap(console, width):
        console.print(Padding.indent(line, indent))
        indent = INDENT + HANG


def plain_table(heads: Sequence[str], *, gap: int) -> Table:
    """A table without lines, all columns but the first aligned to the right."""
    table = Table(*(escape(h) for h in heads), box=None, pad_edge=False, padding=(0, gap, 0, 0))
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def print_rows(
    console: Console, heads: Sequence[str], rows: Iterable[Sequence[str]], *, gap: int,
    left: Sequence[int] = (),
) -> None:  # fmt: skip
    """Print texts as a table, two columns to the right; ``left`` : columns that begin there."""
    table = plain_table(heads, gap=gap)
    for column in left:
        table.columns[column].justify = "left"
    for row in rows:
        table.add_row(*map(shown, row))
    print_indented(console, table)


Columns = Sequence[tuple[str, str, float, str]]
"""Of a table: head, key of a row, what one unit of it is, format; see ``columns.toml``."""


@cache
def columns_of(name: str) -> Columns:
    text = (files("unbend.report") / "data/columns.toml").read_text("utf-8")
    return [tuple(column) for column in tomllib.loads(text)[name]]


def cells_of(row: Mapping[str, Any], columns: Columns) -> list[str]:
    """The texts of a row; empty where it has no value.

    >>> cells_of({"p": 101325.0, "t": None}, [("p", "p", 100.0, ".1f"), ("T", "t", 1.0, ".0f")])
    ['1013.2', '']
    """
    cells = []
    for _, name, unit, digits in columns:
        value = None if row[name] is None else row[name] / unit
        if digits == "sigma":
            digits = ".1f" if value is not None and value >= 9.995 else ".2f"
        cells.append("" if value is None else f"{value:{digits}}")
    return cells


def print_labelled(console: Console, lines: Sequence[tuple[str, str]]) -> None:
    """Lines with their labels in a column before them."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in lines:
        table.add_row(shown(label), shown(text))
    print_indented(console, table)
