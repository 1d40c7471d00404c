"""Events: their channel, names, times with a delay of either sign, and lost numbers."""

from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import (
    counted,
    image_names,
    instants,
    ranked,
    with_columns,
)
from tests.helpers import NS_PER_S, channel, refused
from unbend.errors import MissionError
from unbend.flight.exposures import (
    Events,
    ExposureDelay,
    choose_event_channel,
    events_of_channel,
    events_of_table,
    refuse_repeated_images,
)

AT_ONCE = ExposureDelay(0.0)


def shots(*index, boot=None):
    """Numbered events every ten seconds, from 10 s on."""
    seconds = 10.0 * np.arange(1, len(index) + 1)
    logged = channel("CAM[0]", seconds, "events", event_index=index)
    boots = np.array(boot or [0] * len(index), np.int16)
    return replace(logged, boot=boots)


@pytest.mark.parametrize("delay_s", [0.12, -0.25])
def test_a_positive_delay_makes_events_later(delay_s):
    delay = ExposureDelay(delay_s)
    logged, notes = events_of_channel(shots(7, 8), "cam", "{index}", delay)
    assert not notes
    assert logged.time_ns / NS_PER_S == pytest.approx([10.0 + delay_s, 20.0 + delay_s])

    names = image_names("a", "b", "c")
    cameras = image_names("left", "right", "left")
    of_table = events_of_table(names, cameras, instants(10, 20, 30), "left", delay)
    assert of_table.image.tolist() == ["a", "c"]
    assert of_table.time_ns / NS_PER_S == pytest.approx([10.0 + delay_s, 30.0 + delay_s])


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("IMG_{index:03d}", ["IMG_007", "IMG_008", "IMG_010"]),
        ("{n:02d}_{index}", ["01_7", "02_8", "03_10"]),
        ("left/*", ["", "", ""]),  # which only the images know
    ],
)
def test_images_are_named_by_a_pattern(pattern, names):
    events, _ = events_of_channel(shots(7, 8, 10), "cam", pattern, AT_ONCE)
    assert events.image.tolist() == names
    refuse_repeated_images([events])


@pytest.mark.parametrize(
    ("index", "missing", "says"),
    [
        ([3, 5, 9, 10], 4, "between 3 and 10 have no event: 4, 6 to 8"),
        (range(1, 301, 3), 198, "2 to 3, 5 to 6, 8 to 9, 11 to 12 ..."),
        ([65534, 65535, 0, 1], 0, ""),
        ([65534, 65535, 2], 2, "between 65534 and 2 have no event: 0 to 1"),
        ([65534, 0, 65535, 1], 0, ""),
        ([100, 101, 40_000, 40_001], 39_898, "102 to 39999"),
        ([40_000, 40_001, 0, 1], 39_998, "2 to 39999"),
    ],
    ids=[
        "holes",
        "many",
        "the count runs over",
        "lost at the turn",
        "told late at the turn",
        "a large hole",
        "begun anew",
    ],
)
def test_numbers_that_the_log_skips_are_lost_events(index, missing, says):
    events, losses = events_of_channel(shots(*index), "cam", "{n}.jpg", AT_ONCE)
    assert events.lost == missing
    assert counted(losses) == [("loss", "EVENTS-LOST", missing)] * bool(missing)
    for loss in losses:
        assert says in loss.what


def test_numbers_begin_anew_with_each_boot():
    logged = shots(
        0,
        1,
        3,
        7,
        9,
        10,
        boot=[0, 0, 0, 1, 1, 1],
    )
    _, losses = events_of_channel(logged, "cam", "{n}", AT_ONCE)
    assert [(loss.where, loss.count) for loss in losses] == [
        ("CAM[0], boot 0", 1),
        ("CAM[0], boot 1", 1),
    ]


def test_numbers_are_kept_where_they_rise():
    rising, _ = events_of_channel(shots(1, 2, 5), "cam", "{n}", AT_ONCE)
    begun_anew, _ = events_of_channel(
        shots(3, 4, 0, 1, boot=[0, 0, 1, 1]),
        "cam",
        "{n}",
        AT_ONCE,
    )
    assert rising.index.tolist() == [1, 2, 5]
    assert begun_anew.index is None


def test_the_sigma_of_logged_times_is_kept():
    delay = ExposureDelay(0.1, 0.08)
    unknown = shots(1, 2)
    logged = with_columns(unknown, sigma_time_s=np.array([0.06, np.nan]))
    for channel_of_events, sigma_s in (
        (logged, [0.1, 0.08]),
        (unknown, [0.08, 0.08]),
    ):
        events, _ = events_of_channel(channel_of_events, "cam", "{index}", delay)
        assert events.sigma_time_s == pytest.approx(sigma_s)


def test_repeated_names_are_refused():
    first = Events("left", image_names("a", "b"), instants(0, 0))
    second = Events("right", image_names("c", "b"), instants(0, 0))
    with refused("EVENTS-REPEATED", MissionError, what="b"):
        refuse_repeated_images([first, second])


def event_channel(name, rank):
    return ranked(name, np.arange(3.0), rank, "events", event_index=1.0)


FIRST = event_channel("CAM[0]", 10)
SECOND = event_channel("CAM[1]", 10)
TRIGGER = event_channel("TRIG[0]", 40)


def test_the_event_channel_is_the_named_one_or_the_best():
    assert choose_event_channel((TRIGGER, FIRST), None) is FIRST
    assert choose_event_channel((TRIGGER, FIRST, SECOND), "CAM[1]") is SECOND


@pytest.mark.parametrize("name", [None, "CAM[3]"], ids=["two equals", "a name of none"])
def test_an_event_channel_that_is_not_plain_is_refused_with_the_choices(name):
    with refused("EVENTS-CHANNEL", MissionError) as refusal:
        choose_event_channel((FIRST, SECOND), name)
    assert "CAM[0] (3)" in refusal.value.what
    assert "CAM[1] (3)" in refusal.value.what
