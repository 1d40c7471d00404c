"""Ctrl-C and SIGTERM while threads are waited for.

A handler that raises does so anywhere: also where a lock has just been taken and nothing is there
yet to give it back. The threads that need this lock then wait for ever, and so does whoever waits
for them.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What a person or a batch system ends a command with."""


@contextmanager
def held_back() -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C and SIGTERM until the block calls what it is given, or is left.

    Then the handler that was there gets the first that came, as if it came now. Signals without a
    handler do what they always do, and in other threads than the main one, which hear no signals,
    nothing changes.

    >>> with held_back() as heard:
    ...     heard()  # nothing came
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    handlers = {n: h for n in SIGNALS if callable(h := signal.getsignal(n))}
    kept: list[tuple[int, FrameType | None]] = []
    over = False

    def keep(number: int, frame: FrameType | None) -> None:
        if over:  # a handler that raised while they were put back may have left this one behind
            handlers[signal.Signals(number)](number, frame)
        else:
            kept.append((number, frame))

    def heard() -> None:
        if kept:
            number, frame = kept[0]
            kept.clear()
            handlers[signal.Signals(number)](number, frame)

    try:
        for number in handlers:
            signal.signal(number, keep)
        yield heard
    finally:
        over = True
        try:
            for number, handler in handlers.items():
                if signal.getsignal(number) is keep:  # it may have been changed on purpose
                    signal.signal(number, handler)
        finally:
            heard()
