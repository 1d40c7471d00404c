"""Waiting for others within a time, and so that Ctrl-C is heard meanwhile."""

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import TypeVar

Answer = TypeVar("Answer")


def within(seconds: float | None, question: Callable[[], Answer]) -> Answer:
    """What a question returns or raises; TimeoutError where it takes longer.

    None stands for a question that ends by itself. It is asked in a thread of its own: libraries
    that wait outside Python would keep Ctrl-C and SIGTERM back until they return.

    >>> within(5.0, "answer".upper)
    'ANSWER'
    """
    answers: SimpleQueue[Answer] = SimpleQueue()
    errors: SimpleQueue[BaseException] = SimpleQueue()
    has_ended = threading.Event()

    def ask() -> None:
        try:
            answers.put(question())
        except BaseException as error:
            errors.put(error)
        has_ended.set()

    threading.Thread(target=ask, daemon=True).start()
    if not has_ended.wait(seconds):
        raise TimeoutError(f"no answer within {seconds:.0f} s")
    if not errors.empty():
        raise errors.get()
    return answers.get()
