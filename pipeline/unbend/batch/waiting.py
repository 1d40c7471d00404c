"""Waiting for a call that may not return: with a time limit, and so that Ctrl-C is heard."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

Answer = TypeVar("Answer")


def within(seconds: float | None, function: Callable[[], Answer]) -> Answer:
    """Call a function, and return what it returns or raise what it raises.

    TimeoutError if it takes longer than ``seconds``; None waits without limit. The function is
    called in another thread: a library that waits outside Python would keep Ctrl-C and SIGTERM back
    until it returns. After a TimeoutError that thread runs on.

    >>> within(5.0, "answer".upper)
    'ANSWER'
    """
    answer: Future[Answer] = Future()

    def call() -> None:
        try:
            answer.set_result(function())
        except BaseException as error:
            answer.set_exception(error)

    threading.Thread(target=call, daemon=True).start()
    if not wait([answer], timeout=seconds).done:
        raise TimeoutError(f"no answer within {seconds:.0f} s")
    return answer.result()
