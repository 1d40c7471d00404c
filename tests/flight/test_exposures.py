"""Events: names, and times with a delay of either sign."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.flight.channels import Channel, Source
from pipeline.flight.exposures import events_of_channel, events_of_table, unwrapped_numbers

SECOND = 10**9


def shots(*index: int) -> Channel:
    time_ns = np.arange(1, len(index) + 1) * 10 * SECOND
    return Channel("CAM", time_ns, {"event_index": np.array(index, float)}, Source("CAM"))


@pytest.mark.parametrize("delay_s", [0.12, -0.25, 0.0])
def test_a_positive_delay_makes_events_of_a_log_later(delay_s):
    events, notes = events_of_channel(shots(7, 8), "cam", "{n:02d}_{index}", delay_s)
    assert events.image.tolist() == ["01_7", "02_8"]
    assert (events.time_ns / 1e9).tolist() == pytest.approx([10.0 + delay_s, 20.0 + delay_s])
    assert not notes


@pytest.mark.parametrize("delay_s", [0.12, -0.25, 0.0])
def test_a_positive_delay_makes_events_of_a_table_later(delay_s):
    names = np.array(["a", "b", "c"], object)
    cameras = np.array(["left", "right", "left"], object)
    time_ns = np.array([10, 20, 30]) * SECOND
    events = events_of_table(names, cameras, time_ns, "left", delay_s)
    assert events.image.tolist() == ["a", "c"]
    assert (events.time_ns / 1e9).tolist() == pytest.approx([10.0 + delay_s, 30.0 + delay_s])


def test_a_number_that_comes_late_across_the_turn_of_the_count():
    assert unwrapped_numbers(np.array([65534, 0, 65535, 1])).tolist() == [
        65534,
        65536,
        65535,
        65537,
    ]


def test_holes_of_the_count_are_listed():
    _, (entry,) = events_of_channel(shots(3, 5, 9, 10), "cam", "{index}", 0.0)
    assert (entry.kind, entry.code, entry.count) == ("loss", "EVENTS-LOST", 4)
    assert "4 numbers between 3 and 10 have no event: 4, 6 to 8" in entry.what
