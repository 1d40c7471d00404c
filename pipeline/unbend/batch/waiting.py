"""Waiting for others within a time, and so that Ctrl-C is heard meanwhile."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

Answer = TypeVar("Answer")


def within(seconds: float | None, question: Callable[[], Answer]) -> Answer:
    """What a question returns or raises; TimeoutError where it takes longer.

    None stands for a question that ends by itself. It is asked in a thread of its own: libraries
    that wait outside Python would keep Ctrl-C and SIGTERM back until they return.

    >>> within(5.0, "answer".upper)
    'ANSWER'
    """
    asked: Future[Answer] = Future()

    def ask() -> None:
        try:
            asked.set_result(question())
        except BaseException as error:
            asked.set_exception(error)

    threading.Thread(target=ask, daemon=True).start()
    if not wait([asked], timeout=seconds).done:
        raise TimeoutError(f"no answer within {seconds:.0f} s")
    return asked.result()
