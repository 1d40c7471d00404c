"""Signals that wait: until they are asked for, or until the block is left."""

import signal
import threading
from contextlib import ExitStack

import pytest

from unbend.interrupts import SIGNALS, held_back


class HitError(Exception):
    """What a handler raises; says which signal."""


@pytest.fixture(autouse=True)
def handled():
    """Handlers that raise, for the length of a test."""

    def handler(number, _):
        raise HitError(number)

    before = {number: signal.signal(number, handler) for number in SIGNALS}
    yield handler
    for number, old in before.items():
        signal.signal(number, old)


def test_it_waits_until_it_is_asked_for():
    with held_back() as heard:
        heard()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)  # only the first counts
        with pytest.raises(HitError, match=f"^{int(signal.SIGTERM)}$"):
            heard()
        heard()


@pytest.mark.parametrize("number", SIGNALS)
def test_none_is_lost_at_the_end_of_the_block(number, handled):
    with ExitStack() as stack:
        stack.enter_context(held_back())
        signal.raise_signal(number)
        with pytest.raises(HitError):
            stack.close()
    assert [signal.getsignal(n) for n in SIGNALS] == [handled, handled]


def test_one_that_came_counts_more_than_what_went_wrong_by_it():
    def cancelled():
        with held_back():
            signal.raise_signal(signal.SIGINT)
            raise OSError("cancelled")  # as pyarrow does

    with pytest.raises(HitError) as raised:
        cancelled()
    assert isinstance(raised.value.__context__, OSError)


def test_blocks_may_lie_in_each_other():
    with held_back() as heard:
        with held_back():
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(HitError):
            heard()


def test_a_handler_may_wish_to_hear_no_more():
    def last(number, _):
        for each in SIGNALS:
            signal.signal(each, signal.SIG_IGN)
        raise HitError(number)

    signal.signal(signal.SIGTERM, last)
    with held_back() as heard:
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(HitError):
            heard()
    assert [signal.getsignal(n) for n in SIGNALS] == [signal.SIG_IGN] * 2


def test_what_has_no_handler_stays_so():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with held_back():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_a_handler_that_raises_while_they_are_put_back_swallows_no_other():
    """The second signal comes between the two handlers: that of the third stays behind."""
    heard = []

    def flagged(number, _):
        heard.append(number)

    signal.signal(signal.SIGTERM, flagged)
    real = signal.signal
    put_back = []

    def interrupted(number, handler):
        result = real(number, handler)
        if getattr(handler, "__name__", "") == "handler":
            put_back.append(number)
            signal.raise_signal(signal.SIGINT)
        return result

    stack = ExitStack()
    stack.enter_context(held_back())
    signal.raise_signal(signal.SIGTERM)
    signal.signal = interrupted
    try:
        with pytest.raises(HitError):
            stack.close()
    finally:
        signal.signal = real
    assert put_back == [signal.SIGINT]
    assert heard == [signal.SIGTERM], "the one that was kept"
    signal.raise_signal(signal.SIGTERM)
    assert heard == [signal.SIGTERM] * 2, "one that came afterwards"


def test_other_threads_hear_nothing_anyway(handled):
    seen = []

    def inside():
        with held_back() as heard:
            heard()
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert seen == [handled]
