"""Events: names, and times with a delay of either sign."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.exposures import (
    ExposureDelay,
    events_of_channel,
    events_of_table,
    unwrapped_numbers,
)
from unbend.flight.triggers import lag_from_feedback

SECOND = 10**9


def shots(*index: int) -> Channel:
    time_ns = np.arange(1, len(index) + 1) * 10 * SECOND
    return Channel("CAM", time_ns, {"event_index": np.array(index, float)}, Source("CAM"))


@pytest.mark.parametrize("delay_s", [0.12, -0.25, 0.0])
def test_a_positive_delay_makes_events_of_a_log_later(delay_s):
    events, notes = events_of_channel(shots(7, 8), "cam", "{n:02d}_{index}", ExposureDelay(delay_s))
    assert events.image.tolist() == ["01_7", "02_8"]
    assert (events.time_ns / 1e9).tolist() == pytest.approx([10.0 + delay_s, 20.0 + delay_s])
    assert not notes


@pytest.mark.parametrize("delay_s", [0.12, -0.25, 0.0])
def test_a_positive_delay_makes_events_of_a_table_later(delay_s):
    names = np.array(["a", "b", "c"], object)
    cameras = np.array(["left", "right", "left"], object)
    time_ns = np.array([10, 20, 30]) * SECOND
    events = events_of_table(names, cameras, time_ns, "left", ExposureDelay(delay_s))
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
    _, (entry,) = events_of_channel(shots(3, 5, 9, 10), "cam", "{index}", ExposureDelay(0.0))
    assert (entry.kind, entry.code, entry.count) == ("loss", "EVENTS-LOST", 4)
    assert "4 numbers between 3 and 10 have no event: 4, 6 to 8" in entry.what


def pulses(message: str, instance: str, seconds: np.ndarray, index: np.ndarray) -> Channel:
    time_ns = np.rint(seconds * SECOND).astype(np.int64)
    source = Source(message, instance)
    return Channel(f"{message}[{instance}]", time_ns, {"event_index": index * 1.0}, source)


def test_the_lag_of_the_shutter_is_that_of_triggers_whose_pulse_was_logged():
    """A third of the pulses was lost, one was late; the other camera has another lag."""
    number = np.arange(1, 61)
    trigger = pulses("TRIG", "0", number * 5.0, number)
    seen = number % 3 != 0
    late = 0.11 + 0.02 * np.sin(number)
    late[3] = 4.9
    shutter = pulses("CAM", "0", (number * 5.0 + late)[seen], number[seen])
    other = pulses("CAM", "1", number * 5.0 + 0.4, number)
    delay, (note,) = lag_from_feedback((other, shutter, trigger), trigger, "cam")
    used = seen.copy()
    used[3] = False
    assert delay.seconds == pytest.approx(np.median(late[used]), abs=1e-6)
    assert 0.01 < delay.sigma_s < 0.02
    assert (note.code, note.count) == ("EVENTS-SHUTTER-LAG", 39)
    events, _ = events_of_channel(trigger, "cam", "{index}", delay)
    np.testing.assert_allclose(events.sigma_time_s, delay.sigma_s)


def test_a_lag_takes_ten_pairs_and_triggers():
    number = np.arange(1, 10)
    trigger = pulses("TRIG", "0", number * 5.0, number)
    shutter = pulses("CAM", "0", number * 5.0 + 0.1, number)
    for channel in (trigger, shutter):
        with pytest.raises(MissionError, match="EVENTS-FEEDBACK"):
            lag_from_feedback((trigger, shutter), channel, "cam")


def test_the_sigma_of_logged_times_is_kept():
    channel = shots(1, 2)
    columns = dict(channel.columns) | {"sigma_time_s": np.array([0.06, np.nan])}
    logged = Channel("CAM", channel.time_ns, columns, channel.source)
    events, _ = events_of_channel(logged, "cam", "{index}", ExposureDelay(0.1, 0.08))
    assert np.asarray(events.sigma_time_s).tolist() == pytest.approx([0.1, 0.08])
