"""Run a command line; errors become exit codes."""

import errno
import os
import signal
import sys
import traceback
from io import StringIO, TextIOWrapper
from typing import TextIO

import typer

from unbend.arithmetic import use_same_arithmetic
from unbend.cli import guide, messages, missions, physics, results
from unbend.cli.app import app, print_bug, print_error
from unbend.errors import UnbendError, not_written
from unbend.exit_codes import EXIT_CONFIG, EXIT_DONE, EXIT_INTERRUPTED, EXIT_TERMINATED
from unbend.interrupts import (
    SIGNALS,
    end_process,
    ignore_further_signals,
    raise_if_ended_by_signal,
    send_again_if_ignored,
)
from unbend.report.words import visible

# The import of these modules registers their commands.
_COMMANDS = (guide, missions, physics, results)

# UsageError, the base class of all errors in a command line: of click, or of the copy of click in
# newer versions of typer.
_USAGE_ERROR: type[Exception] = typer.BadParameter.__bases__[0]

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)  # EDQUOT: the quota of a user is used up


def _install_signal_handlers() -> None:
    """Let Ctrl-C end the process with exit code 130, and SIGTERM with 143.

    Ctrl-C stays ignored if the parent process ignores it, as ``nohup`` does.
    """
    # `end_process` raises SystemExit. If KeyboardInterrupt passes through exec(), as in the import
    # of a dataclass, Python ends the process by the signal, without an exit code.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: end_process(EXIT_INTERRUPTED))
    signal.signal(signal.SIGTERM, lambda *_: end_process(EXIT_TERMINATED))


def _discard_further_output(stream: TextIO) -> None:
    """Send a stream nowhere: Python flushes the rest at exit, which must not fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def run_command(arguments: list[str]) -> int:
    """Run one command and return its exit code; SystemExit if a signal ends it."""
    try:
        return invoke_command(arguments)
    except Exception:
        raise_if_ended_by_signal()
        raise


def invoke_command(arguments: list[str]) -> int:
    """Run one command and return its exit code; its errors are raised.

    typer's main() is not used, because it turns errors into other exit codes.
    """
    command = typer.main.get_command(app)
    if instruction := os.environ.get("_UNBEND_COMPLETE"):  # the shell asks for completions
        from typer.completion import shell_complete

        return int(shell_complete(command, {}, "unbend", "_UNBEND_COMPLETE", instruction))
    try:
        with command.make_context("unbend", arguments) as context:
            command.invoke(context)
    except typer.Exit as end:
        return end.exit_code
    return EXIT_DONE


def _prepare_process() -> None:
    """Set what counts for the whole process: arithmetic, streams, hooks and signals."""
    use_same_arithmetic()
    # Without it numba resets the colours of a terminal at exit, also if it has none.
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    for stream in (sys.stdout, sys.stderr):
        # A redirected stream of Windows has code page 1252, and fails for other characters.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # After an error that is not caught below, Python prints it by this and exits with 1, EXIT_BUG.
    sys.excepthook = lambda *error: print_bug("".join(traceback.format_exception(*error)))
    sys.unraisablehook = send_again_if_ignored
    _install_signal_handlers()


def main() -> None:
    """Run the command of this process, and end the process with its exit code."""
    _prepare_process()
    try:
        code = _code_of_command()
    except BrokenPipeError:  # the reader closed the pipe
        _discard_further_output(sys.stdout)
        sys.exit(EXIT_INTERRUPTED)
    except OSError as error:
        is_of_output = error.errno in _DISK_FULL and error.filename is None
        if not is_of_output:
            raise
        _discard_further_output(sys.stdout)
        refusal = not_written(error, "standard output")
        try:
            print_error(refusal)
        except OSError:  # standard error leads to the same disk
            _discard_further_output(sys.stderr)
        sys.exit(refusal.exit_code)
    finally:
        ignore_further_signals()
        for number in SIGNALS:  # Python's shutdown replaces a handler by the default action
            signal.signal(number, signal.SIG_IGN)
    if code == EXIT_INTERRUPTED:
        print("interrupted; run again to finish", file=sys.stderr)
    sys.exit(code)


def _code_of_command() -> int:
    """Run the command of this process, print its refusal, and return its exit code.

    Raises OSError if standard output cannot be written.
    """
    try:
        code = run_command(sys.argv[1:])
        sys.stdout.flush()
    except UnbendError as error:
        print_error(error)
        sys.stdout.flush()
        code = error.exit_code
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else EXIT_DONE
    except (typer.Abort, KeyboardInterrupt):  # raised by a library
        code = EXIT_INTERRUPTED
    except OSError as error:
        # Mission files refuse such a path with its line; only the command line is not checked.
        if error.errno != errno.ENAMETOOLONG:
            raise
        refusal = messages.path_too_long(path=str(error.filename))
        print_error(refusal)
        code = refusal.exit_code
    except _USAGE_ERROR as error:
        text = StringIO()
        error.show(file=text)  # type: ignore[attr-defined]
        print(visible(text.getvalue(), keep="\n"), end="", file=sys.stderr)
        code = EXIT_CONFIG
    return code
