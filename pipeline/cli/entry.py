"""Run the words of a command line; errors to exit codes."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from types import FrameType, TracebackType

import typer

from pipeline.cli import missions, physics
from pipeline.cli.app import app, own_up, refuse
from pipeline.errors import EXIT_CONFIG, EXIT_DONE, EXIT_INTERRUPTED, UnbendError

# The modules whose commands these are; with their import the commands are there.
_COMMANDS = (missions, physics)

# The root of what a mistaken command line raises: click's class, or that of the copy of click
# that newer versions of typer carry.
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]


def _terminated(_: int, __: FrameType | None) -> None:
    raise SystemExit(143)


def _unexpected(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
    """What Python calls for an exception that nothing caught; it then leaves with exit code 1."""
    own_up("".join(traceback.format_exception(kind, error, at)))


def _obey(words: list[str]) -> int:
    """Run one command; its exit code.

    typer's own main would turn a bug, Ctrl-C and a broken pipe into codes and words of its own.
    """
    command = typer.main.get_command(app)
    try:
        with command.make_context("unbend", words) as context:
            command.invoke(context)
    except typer.Exit as end:
        return end.exit_code
    return EXIT_DONE


def main() -> None:
    """Run the command line and leave with its exit code."""
    sys.excepthook = _unexpected
    signal.signal(signal.SIGTERM, _terminated)
    code = EXIT_DONE
    try:
        code = _obey(sys.argv[1:])
        sys.stdout.flush()
    except UnbendError as error:
        refuse(error)
        code = error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted; run again to finish", file=sys.stderr)
        code = EXIT_INTERRUPTED
    except _USAGE_ERROR as error:
        error.show()  # type: ignore[attr-defined]
        code = EXIT_CONFIG
    except BrokenPipeError:
        # Whoever read our words has gone; what is still buffered must not complain at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = EXIT_INTERRUPTED
    sys.exit(code)
