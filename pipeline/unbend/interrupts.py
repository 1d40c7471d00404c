"""Ctrl-C and SIGTERM end a command by an exception, which must neither block nor get lost.

A signal handler that raises may do so between taking a lock and entering its ``with`` block: the
lock is never released, and the threads that need it wait for ever. So signals are kept back while
threads are waited for.

The exception may also be raised inside a library that makes an error of its own of it, as pydantic
does where it builds a schema, or inside a callback or destructor, where Python ignores exceptions.
So the signal is remembered, and sent again where its exception was ignored.
"""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals by which a person or a batch system ends a command."""

AGAIN_S = 0.05
"""After so many seconds a signal is sent again; the callback that ignored it has returned then."""

_exit_codes_of_signals: list[int] = []


def end_process(exit_code: int) -> NoReturn:
    """Raise SystemExit in a signal handler, and remember that; further signals do nothing."""
    ignore_further_signals()
    _exit_codes_of_signals.append(exit_code)
    raise SystemExit(exit_code)


def ignore_further_signals() -> None:
    """Let `SIGNALS` do nothing, so that the shutdown finishes.

    The handler is a function, because SIG_IGN prints a warning if a signal is already pending.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: None)


def send_again_if_ignored(unraisable: "sys.UnraisableHookArgs") -> None:
    """Hook (``sys.unraisablehook``) for exceptions that Python ignores.

    If it is the SystemExit of a signal, a signal that raises it again is sent after `AGAIN_S`. Any
    other exception is shown as usual.
    """
    if not _exit_codes_of_signals or not isinstance(unraisable.exc_value, SystemExit):
        sys.__unraisablehook__(unraisable)
        return
    exit_code = _exit_codes_of_signals[0]
    signal.signal(signal.SIGTERM, lambda *_: end_process(exit_code))
    threading.Timer(AGAIN_S, _signal_main_thread).start()


def _signal_main_thread() -> None:
    """Send SIGTERM to the main thread: also one that waits outside Python gets it."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:  # Windows
        signal.raise_signal(signal.SIGTERM)


def raise_if_ended_by_signal() -> None:
    """Raise the SystemExit of a signal again, if `end_process` raised one; else do nothing.

    Called where an error is handled: a library may have turned the SystemExit into that error.
    """
    if _exit_codes_of_signals:
        raise SystemExit(_exit_codes_of_signals[0]) from None


def _python_handlers() -> dict[signal.Signals, Callable[[int, FrameType | None], object]]:
    """The installed handlers of `SIGNALS`, without SIG_DFL and SIG_IGN."""
    handlers = {}
    for number in SIGNALS:
        handler = signal.getsignal(number)
        if callable(handler):
            handlers[number] = handler
    return handlers


@contextmanager
def held_back() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and SIGTERM back while the block runs.

    The block gets a function that delivers what came so far; the end of the block delivers too. Of
    several signals only the first one is delivered, to the handler that was installed before. A
    signal without a handler in Python is not held back, and none in other threads than the main
    one.

    >>> with held_back() as deliver:
    ...     deliver()  # nothing came
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    handlers = _python_handlers()
    pending: list[tuple[int, FrameType | None]] = []
    has_ended = False

    def keep(number: int, frame: FrameType | None) -> None:
        if has_ended:  # a handler raised while handlers were restored: this one is still there
            handlers[signal.Signals(number)](number, frame)
        else:
            pending.append((number, frame))

    def deliver() -> None:
        if pending:
            number, frame = pending[0]
            pending.clear()
            handlers[signal.Signals(number)](number, frame)

    try:
        for number in handlers:
            signal.signal(number, keep)
        yield deliver
    finally:
        has_ended = True
        try:
            for number, handler in handlers.items():
                if signal.getsignal(number) is keep:  # else the block replaced it on purpose
                    signal.signal(number, handler)
        finally:
            deliver()
