"""Why a sample of a sensor is not used: the first rule that rejects it says why."""

import numpy as np
import pytest

from unbend.atmosphere.air_samples import AirSamples, SensorSamples, SensorUse, sensor_uses
from unbend.atmosphere.rejection import (
    Reason,
    RemovedSamples,
    count_by_reason,
    reasons_where,
    with_reason,
)

SECOND = 10**9


def sensor(value, h_m, rejected=None, **more) -> SensorSamples:
    n = len(value)
    reasons = np.zeros(n, np.uint8) if rejected is None else np.array(rejected, np.uint8)
    time_ns = np.arange(n, dtype=np.int64) * SECOND
    return SensorSamples(time_ns, np.array(h_m, float), np.array(value, float), reasons, **more)


def test_every_reason_has_its_own_words():
    texts = [reason.text for reason in Reason]
    assert len(set(texts)) == len(texts)
    assert Reason.USED == 0


def test_the_first_rule_that_rejects_a_sample_is_its_reason():
    warm = sensor([280.0] * 4, [1.0, 2.0, 3.0, 4.0])
    warm = warm.reject(np.array([True, False, False, False]), Reason.GROUND_SOAK)
    warm = warm.reject(np.array([True, True, False, False]), Reason.STUCK)
    assert warm.rejected.tolist() == [Reason.GROUND_SOAK, Reason.STUCK, 0, 0]
    assert warm.accepted.tolist() == [False, False, True, True]
    assert warm.count(Reason.STUCK) == 1


def test_a_reading_without_value_or_height_is_rejected_where_it_is_made():
    warm = sensor([280.0, np.nan, 281.0, np.nan], [1.0, 2.0, np.nan, np.nan])
    assert warm.rejected.tolist() == [0, Reason.NO_VALUE, Reason.NO_HEIGHT, Reason.NO_VALUE]


def test_removed_samples_are_in_the_order_of_their_times():
    removed = RemovedSamples().and_also(
        np.array([5, 7]), reasons_where(np.ones(2, bool), Reason.JUMP)
    )
    removed = removed.and_also(np.array([6]), np.array([Reason.NO_VALUE], np.uint8))
    assert removed.time_ns.tolist() == [5, 6, 7]
    assert removed.reason.tolist() == [Reason.JUMP, Reason.NO_VALUE, Reason.JUMP]
    assert len(removed) == 3


def test_counts_are_those_of_all_samples_that_are_not_used():
    reasons = with_reason(
        np.array([0, 3, 0, 12], np.uint8), np.array([True, True, False, True]), Reason.STUCK
    )
    assert count_by_reason([reasons, np.array([3], np.uint8)]) == {
        Reason.JUMP: 2,
        Reason.STUCK: 1,
        Reason.OUTLIER: 1,
    }
    assert count_by_reason([]) == {}


@pytest.mark.parametrize("estimated", [False, True])
def test_the_use_of_a_sensor_counts_what_was_removed_before(estimated):
    removed = RemovedSamples(np.array([3]), np.array([Reason.JUMP], np.uint8))
    warm = sensor([280.0, 281.0], [1.0, np.nan], name="HYGR[0]", removed=removed)
    of_estimate = {}
    if estimated:
        of_estimate = {"temperature": np.array([Reason.OUTLIER, Reason.NO_HEIGHT], np.uint8)}
    (use,) = sensor_uses(AirSamples(warm), of_estimate)
    expected = {Reason.JUMP: 1, Reason.NO_HEIGHT: 1}
    if estimated:
        expected[Reason.OUTLIER] = 1
    assert use == SensorUse("temperature", "HYGR[0]", 3, expected)
    assert use.used == (0 if estimated else 1)
    assert use.rejected == dict.fromkeys(expected, 1)
    assert "of 3 samples used; not used: 1 (" in use.sentence()
