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
from pipeline.errors import (
    EXIT_CONFIG,
    EXIT_DONE,
    EXIT_INTERRUPTED,
    EXIT_TERMINATED,
    UnbendError,
)
from pipeline.interrupts import SIGNALS

# The modules whose commands these are; with their import the commands are there.
_COMMANDS = (missions, physics)

# The root of what a mistaken command line raises: click's class, or that of the copy of click
# that newer versions of typer carry.
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]


def _leave_in_peace() -> None:
    """Heed no more signals: whoever leaves clears up, and a second one would end that half done.

    They are heard, not ignored: Python complains of one that is ignored when it is on its way.
    """
    for number in SIGNALS:
        signal.signal(number, _unheeded)


def _unheeded(_: int, __: FrameType | None) -> None:
    """Somebody is impatient."""


def _interrupted(_: int, __: FrameType | None) -> None:
    # Not KeyboardInterrupt: where that passes through an exec() (of dataclasses, in an import),
    # Python ends the process by the signal, whatever its exit code.
    _leave_in_peace()
    raise SystemExit(EXIT_INTERRUPTED)


def _terminated(_: int, __: FrameType | None) -> None:
    _leave_in_peace()
    raise SystemExit(EXIT_TERMINATED)


def _listen() -> None:
    """The first Ctrl-C or SIGTERM ends the command; Ctrl-C unless we were started deaf to it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    signal.signal(signal.SIGTERM, _terminated)


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
    # Matrices of some hundreds of rows are slower on many threads, and sums then depend on how
    # many: set before anything imports numpy, and only where the user has not.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.excepthook = _unexpected
    _listen()
    code = EXIT_DONE
    try:
        code = _obey(sys.argv[1:])
        sys.stdout.flush()
    except UnbendError as error:
        refuse(error)
        code = error.exit_code
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else EXIT_DONE
    except (typer.Abort, KeyboardInterrupt):  # a library's own
        code = EXIT_INTERRUPTED
    except _USAGE_ERROR as error:
        error.show()  # type: ignore[attr-defined]
        code = EXIT_CONFIG
    except BrokenPipeError:
        # Whoever read our words has gone; what is still buffered must not complain at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_INTERRUPTED)
    finally:
        _leave_in_peace()
        for number in SIGNALS:  # Python's own end puts the default back in the place of a handler
            signal.signal(number, signal.SIG_IGN)
    if code == EXIT_INTERRUPTED:
        print("interrupted; run again to finish", file=sys.stderr)
    sys.exit(code)
