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
    """Called by a signal handler: raise SystemExit, and remember it; further signals do nothing."""
    ignore_further_signals()
    _exit_codes_of_signals.append(exit_code)
    raise SystemExit(exit_code)


def ignore_further_signals() -> None:
    """Let the shutdown finish. SIG_IGN would print a warning if a signal is already pending."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: None)


def send_again_if_ignored(unraisable: "sys.UnraisableHookArgs") -> None:
    """The hook of Python for exceptions that it ignores: that of a signal is not to be lost."""
    if not _exit_codes_of_signals or not isinstance(unraisable.exc_value, SystemExit):
        sys.__unraisablehook__(unraisable)
        return
    exit_code = _exit_codes_of_signals[0]
    signal.signal(signal.SIGTERM, lambda *_: end_process(exit_code))
    threading.Timer(AGAIN_S, _signal_main_thread).start()


def _signal_main_thread() -> None:
    """Send SIGTERM to the main thread, which may wait outside Python."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:  # Windows
        signal.raise_signal(signal.SIGTERM)


def raise_if_ended_by_signal() -> None:
    """Raise the SystemExit of a signal again, where an error may be what a library made of it."""
    if _exit_codes_of_signals:
        raise SystemExit(_exit_codes_of_signals[0]) from None


@contextmanager
def held_back() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C and SIGTERM back until the block calls the function it is given, or ends.

    Then the handler that was installed before gets the first that came, or it has its usual effect.
    In other threads than the main one nothing changes.

    >>> with held_back() as deliver:
    ...     deliver()  # nothing came
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    handlers = {n: h for n in SIGNALS if callable(h := signal.getsignal(n))}
    pending: list[tuple[int, FrameType | None]] = []
    over = False

    def keep(number: int, frame: FrameType | None) -> None:
        if over:  # a handler that raised while handlers were restored may have left this one behind
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
        over = True
        try:
            for number, handler in handlers.items():
                if signal.getsignal(number) is keep:  # else the block replaced it on purpose
                    signal.signal(number, handler)
        finally:
            deliver()
