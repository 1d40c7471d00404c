"""Events to images: drawn flights of known truth, and cases that stand for themselves."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.block.assignment import Assignment, assign
from unbend.block.image_evidence import CameraEvents, ImageEvidence


def lines(seed: int = 1, count: int = 4, each: int = 15) -> np.ndarray:
    """Times of a survey [s]: lines of exposures 3 s apart, with wind, 30 s between the lines."""
    rng = np.random.default_rng(seed)
    steps = 3.0 * (1.0 + rng.normal(0.0, 0.02, count * each))
    steps[::each] += rng.uniform(20.0, 40.0, count)
    return 500.0 + np.cumsum(steps)


def of_times(event_s: np.ndarray, image_s: np.ndarray, **more: object) -> Assignment:
    """The assignment by times in milliseconds."""
    evidence = ImageEvidence(image_s.size, time_s=image_s, sigma_s=0.02, **more)
    return assign(CameraEvents(event_s), evidence)


def judge(flight, found: Assignment) -> tuple[int, int]:
    """How many images have an event more than 0.2 s from theirs, and how many miss theirs."""
    has = found.event >= 0
    own = has & (flight.truth >= 0)
    off = np.abs(flight.event_s[found.event] - flight.event_s[flight.truth]) > 0.2
    wrong = has & ((flight.truth < 0) | (own & off))
    return int(wrong.sum()), int(np.sum(~has & (flight.truth >= 0) & ~found.ambiguous))


def unused_events(found: Assignment) -> list[int]:
    """Rows of the events that no image has, without those that repeat another."""
    return [i for i in np.flatnonzero(~found.repeated).tolist() if i not in set(found.event)]


def test_drawn_flights_are_right_or_refused(
    drawn_flights, flight_count, flight_seed, record_property
):
    """Never silently shifted; right in 95 % of the flights in which the likelihood ratio is met."""
    counted: Counter[str] = Counter()
    for i in range(flight_count):
        rng = np.random.default_rng([flight_seed, i])
        flight = drawn_flights.draw(rng, drawn_flights.KINDS[i % len(drawn_flights.KINDS)])
        evidence = ImageEvidence(flight.image_s.size, time_s=flight.image_s, sigma_s=flight.sigma_s)
        found = assign(CameraEvents(flight.event_s), evidence)
        wrong, missed = judge(flight, found)
        if not found.accepted:
            counted["refused"] += 1
            continue
        assert found.log_ratio >= LOG_RATIO_NEEDED
        assert wrong <= 0.02 * evidence.count + 1, f"flight {i} of seed {flight_seed}: {wrong}"
        counted["right" if wrong == 0 and missed <= 0.02 * evidence.count + 1 else "wrong"] += 1
    said = f"seed {flight_seed}: {dict(counted)} of {flight_count} flights"
    record_property("assignments", said)
    assert counted["right"] >= 0.95 * (counted["right"] + counted["wrong"]), said
    assert counted["refused"] <= 0.1 * flight_count, said


def test_constant_intervals_are_refused(drawn_flights, flight_count, flight_seed, record_property):
    """Without a clock and tie points, in 95 % of the flights; never shifted in the others."""
    refused = 0
    for i in range(flight_count):
        rng = np.random.default_rng([flight_seed, 1, i])
        kind = drawn_flights.KINDS[i % len(drawn_flights.KINDS)]
        flight = drawn_flights.draw(rng, kind, constant=True)
        evidence = ImageEvidence(flight.image_s.size, time_s=flight.image_s, sigma_s=flight.sigma_s)
        found = assign(CameraEvents(flight.event_s), evidence)
        refused += not found.accepted
        if found.accepted:
            wrong, _ = judge(flight, found)
            assert wrong <= 0.02 * evidence.count + 1, f"flight {i} of seed {flight_seed}"
    record_property("assignments", f"seed {flight_seed}: {refused} of {flight_count} refused")
    assert refused >= 0.95 * flight_count


@pytest.mark.parametrize(
    "seed", [(1, 359), (2, 440), (2, 593), (2, 710), (3, 152), (3, 215), (3, 494), (11, 1, 691)]
)
def test_gaps_at_random_in_constant_intervals_decide_nothing(drawn_flights, seed):
    """Accepted and shifted where a pair more counts, but not the place more where both miss."""
    kind = drawn_flights.KINDS[seed[-1] % len(drawn_flights.KINDS)]
    flight = drawn_flights.draw(np.random.default_rng(seed), kind, constant=True)
    evidence = ImageEvidence(flight.image_s.size, time_s=flight.image_s, sigma_s=flight.sigma_s)
    found = assign(CameraEvents(flight.event_s), evidence)
    assert judge(flight, found)[0] > 10  # the best is a wrong one
    assert not found.accepted
    assert "times less likely" in found.reason


def test_five_exposures_without_an_image_are_found_by_the_rhythm():
    """256 events, 251 images named by {n}: the names alone shift the flight by 600 m."""
    events = lines(count=16, each=16)
    names = np.arange(1, 252)
    counted = ImageEvidence(251, number=names, numbering="counted")
    alone = assign(CameraEvents(events), counted)
    assert not alone.accepted
    assert "251 images counted up to 251 and 256 events" in alone.reason
    timed = ImageEvidence(
        251,
        time_s=np.floor(events[5:] - 3600.4),
        sigma_s=12.0**-0.5,
        number=names,
        numbering="counted",
    )
    found = assign(CameraEvents(events), timed)
    assert found.accepted
    assert found.event.tolist() == list(range(5, 256))
    assert unused_events(found) == [0, 1, 2, 3, 4]
    assert found.evidence == ("times",)
    assert abs(found.offset_s - 3600.4 - 0.5) < 0.2
    assert np.abs(found.residual_s).max() < 0.7


@pytest.mark.parametrize("seed", [5, 12, 16])
def test_pauses_of_a_flight_that_is_triggered_by_distance_are_its_turns(seed):
    """A slow climb with an exposure every 8 to 12 s, then lines up and down the wind."""
    rng = np.random.default_rng(seed)
    steps = [11.0 * rng.uniform(0.7, 1.1, 60)]
    for line in range(5):
        along = (3.4 if line % 2 else 4.0) * rng.normal(1.0, 0.01, 30)
        steps += [rng.uniform(15.0, 70.0, 1), along]
    events = np.cumsum(np.concatenate(steps))
    images = ImageEvidence(events.size - 5, time_s=np.floor(events[5:] + 7237.4), sigma_s=0.5)
    found = assign(CameraEvents(events), images)
    assert found.accepted
    assert found.event.tolist() == list(range(5, events.size))


def test_equal_counts_pass_by_counting_unless_times_contradict():
    events = lines()
    n = np.arange(1, 61)
    found = assign(CameraEvents(events), ImageEvidence(60, number=n, numbering="counted"))
    assert found.accepted
    assert found.event.tolist() == list(range(60))
    # Two test shots without images, and the last two images lost: the counts are equal again.
    shots = np.concatenate([[100.0, 107.0], events])[:60]
    images = ImageEvidence(60, time_s=events + 77.0, sigma_s=0.02, number=n, numbering="counted")
    found = assign(CameraEvents(shots), images)
    assert found.accepted
    assert found.event.tolist() == [*range(2, 60), -1, -1]


@pytest.mark.parametrize("first", [1, 60_000, 65_520])
def test_names_by_the_index_find_their_events_around_65536(first):
    index = (first + np.arange(80)) % 65_536
    names = np.delete(index, [3, 40])
    images = ImageEvidence(names.size, number=names, numbering="index")
    found = assign(CameraEvents(2.0 * np.arange(80.0), index=index), images)
    assert found.accepted
    assert found.event.tolist() == [i for i in range(80) if i not in (3, 40)]


def test_a_number_that_the_log_skips_is_an_image_without_an_event():
    index = np.delete(np.arange(100, 160), [20, 21])
    images = ImageEvidence(60, number=np.arange(100, 160), numbering="index")
    found = assign(CameraEvents(2.5 * index, index=index), images)
    assert found.accepted
    assert np.flatnonzero(found.event < 0).tolist() == [20, 21]
    assert found.event[22] == 20


def test_constant_intervals_are_decided_by_a_known_clock():
    events = 4.0 * np.arange(50.0)
    assert not of_times(events, events[5:]).accepted
    known = of_times(events, events[5:] + 0.1, clock_sigma_s=0.3)
    assert known.accepted
    assert known.event.tolist() == list(range(5, 50))
    assert not of_times(events, events[5:], clock_sigma_s=3.0).accepted


def test_constant_intervals_are_decided_by_the_first_image():
    events = 4.0 * np.arange(50.0)
    images = ImageEvidence(45, time_s=events[5:] + 9000.0, sigma_s=0.02)
    found = assign(CameraEvents(events), images, first_image=(0, 5))
    assert found.accepted
    assert found.event.tolist() == list(range(5, 50))
    assert "first_image" in found.evidence


def test_a_first_image_that_contradicts_the_rhythm_is_refused():
    events = lines()
    images = ImageEvidence(55, time_s=events[5:], sigma_s=0.02)
    found = assign(CameraEvents(events), images, first_image=(0, 4))
    assert not found.accepted
    assert "contradict" in found.reason


def test_constant_intervals_are_decided_by_tie_points():
    events = 4.0 * np.arange(50.0)
    asked = []

    def tie_points(event: np.ndarray) -> float:
        asked.append(event.copy())
        return -20.0 * float(np.abs(event - np.arange(3, 48)).max())

    images = ImageEvidence(45, time_s=events[:45], sigma_s=0.02)
    found = assign(CameraEvents(events), images, tie_points=tie_points)
    assert found.accepted
    assert found.event.tolist() == list(range(3, 48))
    assert found.evidence[-1] == "tie points"
    assert len({event.tobytes() for event in asked}) == len(asked) > 5


def test_tie_points_decide_where_names_say_the_order_only():
    events = CameraEvents(4.0 * np.arange(50.0))
    images = ImageEvidence(45, number=np.arange(1201, 1246))
    assert not assign(events, images).accepted
    found = assign(
        events,
        images,
        tie_points=lambda event: -20.0 * float(np.abs(event - np.arange(2, 47)).max()),
    )
    assert found.accepted
    assert found.event.tolist() == list(range(2, 47))


def test_images_of_another_flight_are_refused():
    accepted = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        other = lines(seed + 100, count=int(rng.integers(3, 8)), each=int(rng.integers(8, 20)))
        if rng.random() < 0.5:
            other = np.floor(other)
        evidence = ImageEvidence(
            other.size, time_s=other, sigma_s=0.02 if other[0] % 1 else 12.0**-0.5
        )
        accepted += assign(CameraEvents(lines(seed)), evidence).accepted
    assert accepted == 0


def test_repeats_go_to_the_first_pulse():
    events = np.sort(np.concatenate([lines(), lines()[[7, 30]] + 0.04]))
    found = of_times(events, lines() - 50.0)
    assert found.accepted
    assert np.flatnonzero(found.repeated).tolist() == [8, 32]
    assert found.event.tolist() == [i for i in range(62) if i not in (8, 32)]
    assert unused_events(found) == []
    same_number = CameraEvents(np.array([0.0, 3.0, 3.9, 7.0]), index=np.array([4, 5, 5, 6]))
    assert same_number.repeated.tolist() == [False, False, True, False]


def test_images_without_a_time_have_no_event():
    image_s = lines().copy()
    image_s[[4, 9]] = np.nan
    found = of_times(lines(), image_s)
    assert found.accepted
    assert np.flatnonzero(found.event < 0).tolist() == [4, 9]
    assert np.flatnonzero(np.isnan(found.residual_s)).tolist() == [4, 9]


def test_the_drift_of_a_clock_is_found():
    events = lines(count=20)
    found = of_times(events, events * (1.0 + 1e-4) + 40_000.0)
    assert found.accepted
    assert abs(found.drift + 1e-4) < 5e-6
    assert np.abs(found.residual_s).max() < 0.01


def test_an_image_between_two_events_has_none():
    events = np.sort(np.append(lines(), lines()[20] + 0.9))
    images = lines() + 0.02
    images[20] += 0.43
    found = of_times(events, images)
    assert found.accepted
    assert np.flatnonzero(found.ambiguous).tolist() == [] or found.event[20] == -1
    assert np.delete(found.event, 20).tolist() == [i for i in range(61) if i not in (20, 21)]


@pytest.mark.parametrize(
    ("events", "images"),
    [
        (np.empty(0), ImageEvidence(3, number=np.arange(3))),
        (np.arange(5.0), ImageEvidence(0, time_s=np.empty(0))),
        (np.arange(1.0), ImageEvidence(1, time_s=np.zeros(1))),
        (np.zeros(3), ImageEvidence(2, time_s=np.zeros(2))),
        (np.arange(5.0), ImageEvidence(5)),
    ],
)
def test_too_little_is_refused(events, images):
    found = assign(CameraEvents(events), images)
    assert not found.accepted
    has = found.event[found.event >= 0]
    assert np.unique(has).size == has.size
    assert found.event.shape == (images.count,)


def test_events_out_of_order_and_wrong_shapes_are_mistakes():
    with pytest.raises(ValueError, match="order of their time"):
        CameraEvents(np.array([1.0, 0.5]))
    with pytest.raises(ValueError, match="for 4 images"):
        ImageEvidence(4, number=np.arange(3))
    with pytest.raises(ValueError, match="numbering"):
        ImageEvidence(4, numbering="n")


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(-1e6, 1e6), st.integers(0, 8), st.integers(0, 8))
def test_origins_of_clocks_and_the_order_of_images_do_not_matter(seed, origin, first, last):
    rng = np.random.default_rng(seed)
    events = lines(seed)
    images = events[first : events.size - last] + rng.normal(0.0, 0.01, 60 - first - last)
    plain = of_times(events, images)
    shuffled = rng.permutation(images.size)
    other = of_times(events, images[shuffled] + origin)
    assert plain.accepted
    assert other.accepted
    assert plain.event.tolist() == list(range(first, 60 - last))
    assert other.event.tolist() == plain.event[shuffled].tolist()
    assert abs(other.offset_s + origin - plain.offset_s) < 1e-3


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.floats(0.0, 0.15), st.floats(0.0, 0.1))
def test_order_is_kept_and_no_event_serves_twice(seed, missing, lost):
    rng = np.random.default_rng(seed)
    exposed = lines(seed)
    events = exposed[rng.random(60) >= lost]
    images = exposed[rng.random(60) >= missing] + rng.normal(0.0, 0.02)
    found = of_times(events, images)
    has = found.event[found.event >= 0]
    assert np.all(np.diff(has) > 0)
    assert len(unused_events(found)) == events.size - has.size


@pytest.mark.parametrize(("events", "images"), [(0, 3), (3, 0), (0, 0)])
def test_nothing_is_assigned_where_one_side_is_missing(events: int, images: int) -> None:
    """No event is given, and no evidence is claimed."""
    found = of_times(np.arange(float(events)), np.arange(float(images)))
    assert not found.accepted
    assert found.reason
    assert found.event.tolist() == [-1] * images
    assert found.runner_up.tolist() == [-1] * images
    assert np.isnan(found.residual_s).all()
    assert not found.ambiguous.any()
    assert (found.log_ratio, found.evidence) == (0.0, ())


def test_one_event_is_enough_for_one_image() -> None:
    found = of_times(np.array([5.0]), np.array([5.0]))
    assert found.event.tolist() == [0]
