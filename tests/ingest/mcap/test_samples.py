"""The order and the times of messages, by hand."""

import numpy as np
import pytest

from unbend.ingest.mcap.stamps import in_sequence


def order_of(numbers: str, times: str):
    return in_sequence(
        np.array(numbers.split(), np.uint32),
        np.array(times.split(), np.int64),
    )


def test_a_chunk_that_is_elsewhere_in_the_file_is_moved():
    order = order_of("0 2 1 3", "10 12 11 13")
    assert order.tolist() == [0, 2, 1, 3]


@pytest.mark.parametrize(
    ("numbers", "times"),
    [
        ("0 1 2 3", "10 11 12 13"),  # in order
        ("0 1 2 3", "10 12 11 13"),  # a clock was set back: numbers do not say more
        ("3 2 1 0", "10 12 11 13"),  # numbers that disagree with the times
        ("0 1 0 1", "10 11 5 6"),  # a recorder that counts anew
    ],
)
def test_messages_stay_where_numbers_do_not_put_times_right(numbers, times):
    assert order_of(numbers, times) is None
