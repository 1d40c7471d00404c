"""The order and the times of messages, by hand."""

import numpy as np
import pytest

from unbend.ingest.mcap.stamps import in_sequence


@pytest.mark.parametrize(
    ("numbers", "times", "order"),
    [
        ([0, 1, 2, 3], [10, 11, 12, 13], None),  # in order as they stand
        ([0, 2, 1, 3], [10, 12, 11, 13], [0, 2, 1, 3]),  # a chunk lies elsewhere in the file
        ([0, 1, 2, 3], [10, 12, 11, 13], None),  # a clock was set back: numbers do not say more
        ([3, 2, 1, 0], [10, 12, 11, 13], None),  # numbers that disagree with the times
        ([0, 1, 0, 1], [10, 11, 5, 6], None),  # a recorder that counts anew
    ],
)
def test_messages_are_moved_only_where_numbers_put_times_right(numbers, times, order):
    moved = in_sequence(
        np.array(numbers, np.uint32),
        np.array(times, np.int64),
    )
    assert (None if moved is None else moved.tolist()) == order
