"""The command line application, and what its commands share: console, error messages, CSV.

Exit codes: 0 done; 1 a bug; 2 command or mission file; 3 done, but data was lost, damaged or
flagged, a finding contradicts the inputs, or something the mission file names is absent; 4 output
folder in use; 5 storage failure, or verify found damage; 6 a mission was refused, the others are
done; 130, 143 interrupted.
"""

from __future__ import annotations

import csv as csv_module
import json
import shlex
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import cached_property, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeAlias

import typer
from typer import Option
from typer.core import TyperCommand, TyperGroup

import unbend
from unbend.cli.messages import command_not_first
from unbend.errors import UnbendError, storage_errors
from unbend.exit_codes import exit_code_of
from unbend.report.progress import DelayedProgressBar
from unbend.report.words import hanging, visible

if TYPE_CHECKING:
    from rich.console import Console

    from unbend.messages import Ledger, MessageRecord

WIDEST_HELP = 1000  # columns: more than any terminal has

HelpContext: TypeAlias = Any
HelpFormatter: TypeAlias = Any
"""Context and formatter of a help text: classes of click, or of the copy of click in newer versions
of typer."""

GROUPS = {
    "From a log to files for adjustment": ("init", "check", "run", "export"),
    "Show missions, logs and results": (
        "status",
        "report",
        "verify",
        "stations",
        "inspect",
        "profile",
    ),
    "Compute": ("angle", "tables", "simulate"),
    "Help and preparation": ("help", "schema", "warm"),
}
"""The commands as the help lists them: the four steps first."""

_TAKE_URLS = {"run", "export", "report", "verify"}
"""Commands that take URLs as arguments."""


class _Group(TyperGroup):
    """The group of all commands, with its own help and its own refusals of wrong words."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of `GROUPS`; typer would list them by module."""
        return [name for names in GROUPS.values() for name in names]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands group by group, each with the first sentence of its help."""
        width = max(len(name) for name in self.commands)
        limit = formatter.width - 6 - width
        for title, names in GROUPS.items():
            rows = []
            for name in names:
                rows.append((name.ljust(width), self.commands[name].get_short_help_str(limit)))
            with formatter.section(title):
                formatter.write_dl(rows)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The name of the command, the command, and the words that follow it.

        Refuses a file in the place of the command (COMMAND-ORDER), and a URL for a command that
        takes only paths (URL-INVALID).
        """
        refuse_file_as_command(args, self.commands)
        name, command, words = super().resolve_command(ctx, args)
        if name is not None and name not in _TAKE_URLS:
            refuse_urls(name, words)
        return name, command, words


def refuse_file_as_command(words: Sequence[str], commands: Collection[str]) -> None:
    """Refuse (COMMAND-ORDER) a command line that begins with a file, with the line in its order.

    ``words`` follow ``unbend``; ``commands`` are the names of all commands. The command of the
    proposed line is the one that `place_of_command` finds, otherwise ``run`` for a mission file. A
    line without either, or with another first word, is not refused here.
    """
    first = words[0]
    if first in commands:
        return
    from unbend.config.other_files import MISSION_ENDINGS

    is_mission = first.lower().endswith(MISSION_ENDINGS)
    try:
        is_file = is_mission or Path(first).exists()
    except OSError:  # the name is too long
        return
    if not is_file:
        return
    other_words = list(words)
    place = place_of_command(words, commands)
    if place is not None:
        command_name = other_words.pop(place)
    elif is_mission:
        command_name = "run"
    else:
        return
    raise command_not_first(word=first, line=shlex.join(["unbend", command_name, *other_words]))


def place_of_command(words: Sequence[str], commands: Collection[str]) -> int | None:
    """The index of the first word that is a command and does not follow an option, else None.

    A word after an option is its value.

    >>> place_of_command(["a.yaml", "run"], {"run"})
    1
    >>> place_of_command(["a.yaml", "--output", "run"], {"run"})
    """
    for place, word in enumerate(words):
        previous = words[place - 1] if place else ""
        is_value = previous.startswith("--") and "=" not in previous
        if word in commands and not is_value:
            return place
    return None


def refuse_urls(command: str, words: Iterable[str]) -> None:
    """Refuse (URL-INVALID) a URL among the words of a command that takes paths."""
    for word in words:
        value = word.partition("=")[2] if word.startswith("--") else word
        if ":/" not in value:
            continue
        from unbend.batch import messages
        from unbend.batch.remote import Place, is_url

        if is_url(value):
            raise messages.url_for_command(url=str(Place.of(value)), command=command)


app = typer.Typer(
    name="unbend",
    cls=_Group,
    help="Removes atmospheric refraction from aerial image observations, with the air the "
    "aircraft measured.",
    epilog=__doc__.split("\n\n", 1)[1],
    no_args_is_help=True,
    # Help is as wide as the terminal: typer's own limit is 80 columns.
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDEST_HELP},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


Quiet = Annotated[bool, Option("--quiet", "-q", help="print only refusals")]
AsJson = Annotated[bool, Option("--json", help="print the answer as JSON")]


class Answer:
    """Prints the answer of a command: as text, with ``as_json`` as JSON only, or not at all.

    ``quiet`` prints no text; together with ``as_json`` it prints the JSON.
    """

    def __init__(self, *, quiet: bool, as_json: bool) -> None:
        self.quiet = quiet
        self.as_json = as_json

    @property
    def is_silent(self) -> bool:
        """Whether no text is printed."""
        return self.quiet or self.as_json

    @cached_property
    def console(self) -> Console:
        """The console for the text of the answer, which discards it if `is_silent`."""
        from unbend.report.console import report_console

        return report_console(quiet=self.is_silent)

    def progress(self, title: str) -> DelayedProgressBar:
        """A progress bar that is shown after half a second, if there is a terminal.

        It is on standard error if standard output is JSON or no terminal.
        """
        if self.quiet or not (sys.stdout.isatty() or sys.stderr.isatty()):
            return DelayedProgressBar(None, title)
        from unbend.report.console import report_console

        if self.as_json or not sys.stdout.isatty():
            return DelayedProgressBar(report_console(error=True), title)
        return DelayedProgressBar(self.console, title)

    def print_json(self, content: Any) -> None:
        """Print ``content`` if JSON is wanted; ValueError for NaN or infinity, which JSON lacks."""
        if self.as_json:
            print(json.dumps(content, indent=2, allow_nan=False, default=str))

    def end(
        self,
        content: dict[str, Any],
        ledger: Ledger,
        *written: Path | None,
        shown: Sequence[MessageRecord] | None = None,
    ) -> NoReturn:
        """Print the answer with its ledger and ``written`` files, and exit with the ledger's code.

        ``content`` is printed only as JSON. ``shown`` are the messages to print as text; None means
        all of the ledger. A file that is None was not written.
        """
        code = exit_code_of(has_losses=ledger.has_losses)
        files = [str(path) for path in written if path is not None]
        self.print_json(content | {"written": files, "ledger": ledger.rows(), "exit_code": code})
        if not self.is_silent:
            from unbend.report.terminal import print_ledger

            print_ledger(self.console, ledger.records() if shown is None else shown)
            self.print_paths(files)
        raise typer.Exit(code)

    def print_paths(self, paths: Iterable[str]) -> None:
        """Print each path on one line, also if it is longer than the terminal is wide."""
        for path in paths:
            self.console.print(visible(path), markup=False, soft_wrap=True)


def command(
    name: str | None = None, *, epilog: str, cls: type[TyperCommand] = TyperCommand
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator that registers a function as a command with the options --quiet and --json.

    The function takes an `Answer` as its first argument. ``name`` is that of the command, None for
    the name of the function; ``epilog`` is the end of its help.
    """

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def run(*arguments: Any, quiet: bool, as_json: bool, **options: Any) -> None:
            function(Answer(quiet=quiet, as_json=as_json), *arguments, **options)

        _, *parameters = signature(function, eval_str=True).parameters.values()
        for option, annotation in (("quiet", Quiet), ("as_json", AsJson)):
            parameters.append(
                Parameter(option, Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
            )
        run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        app.command(name, epilog=epilog, cls=cls)(run)
        return function

    return register


def print_error(error: UnbendError, subject: str = "") -> None:
    """Write a refusal to standard error, after its ``subject``, the mission file, if given.

    In a terminal its lines are wrapped, with a hanging indent.
    """
    text = f"{subject}: {error}" if subject else str(error)
    shown = visible(text, keep="\n")
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        lines = [hanging(line, width) for line in shown.splitlines()]
        shown = "\n".join(lines)
    print(shown, file=sys.stderr)


def print_bug(text: str, subject: str = "") -> None:
    """Write a traceback to standard error, with the request to report it.

    ``text`` is the traceback, ``subject`` the mission file, if given.
    """
    prefix = f"{subject}: " if subject else ""
    text = visible(text, keep="\n")
    request = f"please report the lines above {receiver_of_reports()}"
    print(f"{text}\n{visible(prefix)}this is a bug in unbend: {request}", file=sys.stderr)


def receiver_of_reports() -> str:
    """Where to report bugs, in words: the address `Issues` of pyproject.toml, if there is one."""
    from importlib.metadata import PackageNotFoundError, metadata

    try:
        addresses = metadata("unbend").get_all("Project-URL") or []
    except PackageNotFoundError:  # it is on the path, but not installed
        addresses = []
    for entry in addresses:
        label, _, address = entry.partition(", ")
        if label == "Issues":
            return f"at {address}"
    return "to the maintainer of this copy (the package names no address)"


def write_rows_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as CSV, with the keys of the first row as header; there must be a row.

    StorageError if the file cannot be written.
    """
    with storage_errors(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv_module.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, Option("--version", help="print the version")] = False,
) -> None:
    if version:
        print(f"unbend {unbend.__version__}")
        raise typer.Exit
