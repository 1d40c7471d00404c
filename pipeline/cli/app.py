"""The command line application, and what its commands share: console, error messages, CSV.

Exit codes: 0 done; 1 a bug; 2 command or mission file; 3 done, but data was lost, damaged or
flagged, or something the mission file names is absent; 4 output folder in use; 5 storage failure,
or verify found damage; 6 a mission was refused, the others are done; 130, 143 interrupted.
"""

from __future__ import annotations

import csv as csv_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperGroup

import pipeline
from pipeline.errors import EXIT_DONE, EXIT_LOSSES, UnbendError, storage_errors

if TYPE_CHECKING:
    from pipeline.ledger import Ledger

_ORDER = (
    "init", "schema", "help", "run", "check", "stations", "inspect", "angle", "radial", "tables",
    "profile", "compare", "simulate", "export", "verify",
)  # fmt: skip
"""Order of the commands in the help: the way in, missions, atmosphere and rays, results."""


class _Group(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of `_ORDER`; typer would list them by module."""
        return sorted(self.commands, key=_ORDER.index)


app = typer.Typer(
    name="unbend",
    cls=_Group,
    help="Removes atmospheric refraction from aerial image observations, with the air the "
    "aircraft measured.",
    epilog=__doc__.split("\n\n", 1)[1],
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class _Console(Console):
    """Console that raises BrokenPipeError instead of exiting, so that main() sets the exit code."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError


def new_console() -> Console:
    """Console for standard output, as wide as the terminal."""
    return _Console(soft_wrap=False, highlight=False)


def print_error(error: UnbendError, subject: str = "") -> None:
    """Write a refusal to standard error; ``subject`` is the mission file if there are several."""
    print(f"{subject}: {error}" if subject else error, file=sys.stderr)


def print_bug(text: str, subject: str = "") -> None:
    """Write a traceback to standard error, with the request to report it."""
    where = f"{subject}: " if subject else ""
    print(f"{text}\n{where}this is a bug in unbend: please report the lines above", file=sys.stderr)


def write_rows_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows of the same keys as CSV; StorageError if the file cannot be written."""
    with storage_errors(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv_module.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def end_command(console: Console, ledger: Ledger, *written: Path | None) -> NoReturn:
    """Print a ledger and the files that were written, and exit with the code of the ledger."""
    from pipeline.report.terminal import print_ledger

    print_ledger(console, ledger.rows())
    for path in filter(None, written):
        console.print(escape(str(path)), soft_wrap=True)
    raise typer.Exit(EXIT_LOSSES if ledger.has_losses else EXIT_DONE)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="print the version")] = False,
) -> None:
    if version:
        print(f"unbend {pipeline.__version__}")
        raise typer.Exit
