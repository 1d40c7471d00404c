"""Events to images: drawn flights of known truth, and cases that stand for themselves.

UNBEND_FLIGHTS (200) flights are drawn from UNBEND_SEED.
"""

import os
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from tests.block.drawn_flights import KINDS, draw
from tests.draws import SEED
from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import assign
from unbend.block.image_evidence import CameraEvents, ImageEvidence

FLIGHTS = int(os.environ.get("UNBEND_FLIGHTS", "200"))
WHOLE_SECONDS_S = 12.0**-0.5  # sigma of times that are rounded to seconds
EVERY_4_S = 4.0 * np.arange(50.0)


def lines(seed=1, count=4, each=15):
    """Times of a survey [s]: lines of exposures 3 s apart, with wind, 30 s between the lines."""
    rng = np.random.default_rng(seed)
    steps = 3.0 * (1.0 + rng.normal(0.0, 0.02, count * each))
    steps[::each] += rng.uniform(20.0, 40.0, count)
    return 500.0 + np.cumsum(steps)


SURVEY = lines()


def timed(image_s, sigma_s=0.02, **more):
    """Images with times in milliseconds."""
    return ImageEvidence(
        image_s.size,
        time_s=image_s,
        sigma_s=sigma_s,
        **more,
    )


def numbered(number, numbering="sequence"):
    return ImageEvidence(number.size, number=number, numbering=numbering)


def assigned(event_s, images, **more):
    return assign(CameraEvents(event_s), images, **more)


def by_times(event_s, image_s, **more):
    return assigned(event_s, timed(image_s, **more))


def by_index(event_s, event_index, image_index):
    events = CameraEvents(event_s, index=event_index)
    return assign(events, numbered(image_index, "index"))


def assert_assigned(assignment, rows):
    assert assignment.accepted
    assert assignment.event.tolist() == list(rows)


def unused_events(assignment):
    """Rows of the events that no image has, without those that repeat another."""
    rows = np.flatnonzero(~assignment.repeated)
    return np.setdiff1d(rows, assignment.event).tolist()


def used_events(assignment):
    return assignment.event[assignment.event >= 0]


def drawn(kind_number, seed, *, constant=False):
    """A flight and its assignment by times."""
    kind = KINDS[kind_number % len(KINDS)]
    flight = draw(np.random.default_rng(seed), kind, constant=constant)
    assignment = by_times(
        flight.event_s,
        flight.image_s,
        sigma_s=flight.sigma_s,
    )
    return flight, assignment


def wrong_images(flight, assignment):
    """How many images have an event more than 0.2 s from theirs, or one although theirs is lost."""
    event_s = flight.event_s[assignment.event]
    true_s = flight.event_s[flight.truth]
    is_apart = np.abs(event_s - true_s) > 0.2
    is_wrong = (flight.truth < 0) | is_apart
    return np.count_nonzero(is_wrong & (assignment.event >= 0))


def few(flight):
    return 0.02 * flight.image_s.size + 1


def test_drawn_flights_are_right_or_refused(record_property):
    """Never silently shifted; right in 95 % of the flights in which the likelihood ratio is met."""
    outcomes = Counter()
    for number in range(FLIGHTS):
        flight, assignment = drawn(number, [SEED, number])
        if not assignment.accepted:
            outcomes["refused"] += 1
            continue
        assert assignment.log_ratio >= LOG_RATIO_NEEDED
        wrong = wrong_images(flight, assignment)
        assert wrong <= few(flight), f"flight {number} of seed {SEED}: {wrong}"
        outcomes["accepted"] += 1
        is_missed = (assignment.event < 0) & (flight.truth >= 0) & ~assignment.ambiguous
        outcomes["right"] += wrong == 0 and np.count_nonzero(is_missed) <= few(flight)
    summary = f"seed {SEED}: {dict(outcomes)} of {FLIGHTS} flights"
    record_property("assignments", summary)
    assert outcomes["right"] >= 0.95 * outcomes["accepted"], summary
    assert outcomes["refused"] <= 0.1 * FLIGHTS, summary


def test_constant_intervals_are_refused(record_property):
    """Without a clock and tie points, in 95 % of the flights; never shifted in the others."""
    refused = 0
    for number in range(FLIGHTS):
        flight, assignment = drawn(number, [SEED, 1, number], constant=True)
        if not assignment.accepted:
            refused += 1
            continue
        assert wrong_images(flight, assignment) <= few(flight), f"flight {number} of seed {SEED}"
    record_property("assignments", f"seed {SEED}: {refused} of {FLIGHTS} refused")
    assert refused >= 0.95 * FLIGHTS


@pytest.mark.parametrize(
    "seed",
    [
        (1, 359),
        (2, 440),
        (2, 593),
        (2, 710),
        (3, 152),
        (3, 215),
        (3, 494),
        (11, 1, 691),
    ],
)
def test_gaps_at_random_in_constant_intervals_decide_nothing(seed):
    """Accepted and shifted where a pair more counts, but not the place more where both miss."""
    flight, assignment = drawn(seed[-1], seed, constant=True)
    assert wrong_images(flight, assignment) > 10  # the best is a wrong one
    assert not assignment.accepted
    assert "times less likely" in assignment.reason


def test_five_exposures_without_an_image_are_found_by_the_rhythm():
    """256 events, 251 images named by {n}: the names alone shift the flight by 600 m."""
    events = lines(count=16, each=16)
    names = np.arange(1, 252)
    by_names = assigned(events, numbered(names, "counted"))
    assert not by_names.accepted
    assert "251 images counted up to 251 and 256 events" in by_names.reason

    image_s = np.floor(events[5:] - 3600.4)
    images = timed(image_s, WHOLE_SECONDS_S, number=names, numbering="counted")
    assignment = assigned(events, images)

    assert_assigned(assignment, range(5, 256))
    assert unused_events(assignment) == [0, 1, 2, 3, 4]
    assert assignment.evidence == ("times",)
    assert assignment.offset_s == pytest.approx(3600.4 + 0.5, abs=0.2)
    assert np.abs(assignment.residual_s).max() < 0.7


@pytest.mark.parametrize("seed", [5, 12, 16])
def test_pauses_of_a_flight_that_is_triggered_by_distance_are_its_turns(seed):
    """A slow climb with an exposure every 8 to 12 s, then lines up and down the wind."""
    rng = np.random.default_rng(seed)
    steps = [11.0 * rng.uniform(0.7, 1.1, 60)]
    for interval_s in (4.0, 3.4, 4.0, 3.4, 4.0):
        along = interval_s * rng.normal(1.0, 0.01, 30)
        turn = rng.uniform(15.0, 70.0, 1)
        steps += [turn, along]
    events = np.cumsum(np.concatenate(steps))
    assignment = by_times(
        events,
        np.floor(events[5:] + 7237.4),
        sigma_s=0.5,
    )
    assert_assigned(assignment, range(5, events.size))


def test_counted_names_are_not_those_of_a_16_bit_counter():
    names = np.arange(1, 65_540)
    events = CameraEvents(2.0 * names)

    rows = numbered(names, "counted").events_of_names(events)

    assert rows.tolist() == list(range(names.size))


def test_equal_counts_pass_by_counting_unless_times_contradict():
    """Two test shots without images, and the last two images lost: the counts are equal again."""
    names = np.arange(1, 61)
    assert_assigned(assigned(SURVEY, numbered(names, "counted")), range(60))
    with_shots = np.concatenate([[100.0, 107.0], SURVEY[:-2]])
    images = timed(SURVEY + 77.0, number=names, numbering="counted")
    assert_assigned(assigned(with_shots, images), [*range(2, 60), -1, -1])


@pytest.mark.parametrize("first", [1, 60_000, 65_520])
def test_names_by_the_index_find_their_events_around_65536(first):
    row = np.arange(80)
    index = (first + row) % 65_536
    assignment = by_index(
        2.0 * row,
        index,
        np.delete(index, [3, 40]),
    )
    assert_assigned(assignment, np.delete(row, [3, 40]))


def test_a_number_that_the_log_skips_is_an_image_without_an_event():
    index = np.delete(np.arange(100, 160), [20, 21])
    assignment = by_index(2.5 * index, index, np.arange(100, 160))
    assert_assigned(
        assignment,
        [
            *range(20),
            -1,
            -1,
            *range(20, 58),
        ],
    )


@pytest.mark.parametrize(
    ("clock_sigma_s", "is_decided"),
    [
        (0.3, True),
        (3.0, False),
        (np.inf, False),
    ],
)
def test_constant_intervals_are_decided_by_a_known_clock(clock_sigma_s, is_decided):
    assignment = by_times(EVERY_4_S, EVERY_4_S[5:] + 0.1, clock_sigma_s=clock_sigma_s)
    assert assignment.accepted == is_decided
    if is_decided:
        assert_assigned(assignment, range(5, 50))


def test_constant_intervals_are_decided_by_the_first_image():
    assignment = assigned(
        EVERY_4_S,
        timed(EVERY_4_S[5:] + 9000.0),
        first_image=(0, 5),
    )
    assert_assigned(assignment, range(5, 50))
    assert "first_image" in assignment.evidence


def test_a_first_image_that_contradicts_the_rhythm_is_refused():
    assignment = assigned(
        SURVEY,
        timed(SURVEY[5:]),
        first_image=(0, 4),
    )
    assert not assignment.accepted
    assert "contradict" in assignment.reason


@pytest.mark.parametrize(
    "images",
    [
        timed(EVERY_4_S[:45]),
        numbered(np.arange(1201, 1246)),
    ],
    ids=["constant intervals", "names that say the order only"],
)
def test_tie_points_decide_where_nothing_else_does(images):
    asked = []

    def tie_points(event):
        asked.append(event.tobytes())
        return -20.0 * float(np.abs(event - np.arange(3, 48)).max())

    assert not assigned(EVERY_4_S, images).accepted
    assignment = assigned(EVERY_4_S, images, tie_points=tie_points)
    assert_assigned(assignment, range(3, 48))
    assert assignment.evidence[-1] == "tie points"
    assert len(set(asked)) == len(asked) > 5


@pytest.mark.parametrize("sigma_s", [0.02, WHOLE_SECONDS_S])
@pytest.mark.parametrize("seed", range(20))
def test_images_of_another_flight_are_refused(seed, sigma_s):
    rng = np.random.default_rng(seed)
    image_s = lines(
        seed + 100,
        count=rng.integers(3, 8),
        each=rng.integers(8, 20),
    )
    if sigma_s == WHOLE_SECONDS_S:
        image_s = np.floor(image_s)
    assert not by_times(lines(seed), image_s, sigma_s=sigma_s).accepted


def test_repeats_go_to_the_first_pulse():
    events = np.sort(np.append(SURVEY, SURVEY[[7, 30]] + 0.04))
    assignment = by_times(events, SURVEY - 50.0)
    assert_assigned(assignment, np.delete(np.arange(62), [8, 32]))
    assert np.flatnonzero(assignment.repeated).tolist() == [8, 32]
    assert unused_events(assignment) == []


def test_an_event_of_the_number_before_it_repeats_that():
    events = CameraEvents(
        np.array([0.0, 3.0, 3.9, 7.0]),
        index=np.array([4, 5, 5, 6]),
    )
    assert events.repeated.tolist() == [False, False, True, False]


def test_images_without_a_time_have_no_event():
    image_s = SURVEY.copy()
    image_s[[4, 9]] = np.nan
    assignment = by_times(SURVEY, image_s)
    assert assignment.accepted
    assert np.flatnonzero(assignment.event < 0).tolist() == [4, 9]
    assert np.flatnonzero(np.isnan(assignment.residual_s)).tolist() == [4, 9]


def test_the_drift_of_a_clock_is_found():
    events = lines(count=20)
    assignment = by_times(events, events * (1.0 + 1e-4) + 40_000.0)
    assert assignment.accepted
    assert assignment.drift == pytest.approx(-1e-4, abs=5e-6)
    assert np.abs(assignment.residual_s).max() < 0.01


def test_an_image_between_two_events_has_none():
    events = np.sort(np.append(SURVEY, SURVEY[20] + 0.9))
    image_s = SURVEY + 0.02
    image_s[20] += 0.43
    assignment = by_times(events, image_s)
    assert assignment.accepted
    assert not assignment.ambiguous.any() or assignment.event[20] == -1
    neighbours = np.delete(assignment.event, 20)
    assert neighbours.tolist() == [*range(20), *range(22, 61)]


@pytest.mark.parametrize(
    ("events", "images"),
    [
        (np.empty(0), ImageEvidence(3, number=np.arange(3))),
        (np.arange(1.0), ImageEvidence(1, time_s=np.zeros(1))),
        (np.zeros(3), ImageEvidence(2, time_s=np.zeros(2))),
        (np.arange(5.0), ImageEvidence(5)),
    ],
)
def test_too_little_is_refused(events, images):
    assignment = assigned(events, images)
    assert not assignment.accepted
    assert assignment.event.shape == (images.count,)
    used = used_events(assignment)
    assert np.unique(used).size == used.size


@pytest.mark.parametrize(
    ("events", "images"),
    [
        (0, 3),
        (3, 0),
        (0, 0),
    ],
)
def test_nothing_is_assigned_where_one_side_is_missing(events, images):
    """No event is given, and no evidence is claimed."""
    assignment = by_times(
        np.arange(float(events)),
        np.arange(float(images)),
    )
    assert not assignment.accepted
    assert assignment.reason
    assert assignment.event.tolist() == [-1] * images
    assert assignment.runner_up.tolist() == [-1] * images
    assert np.isnan(assignment.residual_s).all()
    assert not assignment.ambiguous.any()
    assert assignment.log_ratio == 0.0
    assert assignment.evidence == ()


def test_one_event_is_enough_for_one_image():
    second = np.array([5.0])
    assert by_times(second, second).event.tolist() == [0]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: CameraEvents(np.array([1.0, 0.5])), "order of their time"),
        (lambda: ImageEvidence(4, number=np.arange(3)), "for 4 images"),
        (lambda: ImageEvidence(4, numbering="n"), "numbering"),
    ],
)
def test_events_out_of_order_and_wrong_shapes_are_mistakes(make, says):
    with pytest.raises(ValueError, match=says):
        make()


SEEDS = strategies.integers(0, 10**6)
ORIGINS_S = strategies.floats(-1e6, 1e6)
UP_TO_8 = strategies.integers(0, 8)


@settings(max_examples=25)
@given(SEEDS, ORIGINS_S, UP_TO_8, UP_TO_8)
def test_origins_of_clocks_and_the_order_of_images_do_not_matter(seed, origin_s, first, last):
    rng = np.random.default_rng(seed)
    events = lines(seed)
    rows = range(first, 60 - last)
    image_s = events[rows] + rng.normal(0.0, 0.01, len(rows))
    order = rng.permutation(len(rows))

    in_order = by_times(events, image_s)
    shuffled = by_times(events, image_s[order] + origin_s)

    assert_assigned(in_order, rows)
    assert_assigned(shuffled, in_order.event[order])
    assert shuffled.offset_s + origin_s == pytest.approx(in_order.offset_s, abs=1e-3)


@settings(max_examples=25)
@given(
    SEEDS,
    strategies.floats(0.0, 0.15),
    strategies.floats(0.0, 0.1),
)
def test_order_is_kept_and_no_event_serves_twice(seed, missing, lost):
    rng = np.random.default_rng(seed)
    exposed = lines(seed)
    events = exposed[rng.random(60) >= lost]
    image_s = exposed[rng.random(60) >= missing] + rng.normal(0.0, 0.02)
    assignment = by_times(events, image_s)
    used = used_events(assignment)
    assert (np.diff(used) > 0).all()
    assert len(unused_events(assignment)) == events.size - used.size
