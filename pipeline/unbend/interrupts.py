"""Ctrl-C and SIGTERM are kept back while threads are waited for.

A signal handler that raises may do so between taking a lock and entering its ``with`` block: the
lock is never released, and the threads that need it wait for ever.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Signals by which a person or a batch system ends a command."""


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
