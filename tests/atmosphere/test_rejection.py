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

NAN = np.nan


def thermometer(
    h_m,
    value=280.0,
    seconds=None,
    **more,
):
    count = len(h_m)
    time_s = np.arange(count) if seconds is None else np.array(seconds)
    readings = np.full(count, value)
    return SensorSamples(time_s * 10**9, np.array(h_m), readings, **more)


def reasons(*codes):
    return np.array(codes, np.uint8)


def test_every_reason_has_its_own_words():
    texts = [reason.text for reason in Reason]
    assert len(set(texts)) == len(texts)
    assert Reason.USED == 0


def test_the_first_rule_that_rejects_a_sample_is_its_reason():
    h = np.array([1.0, 2.0, 3.0])
    soaked = thermometer(h).reject(h < 1.5, Reason.GROUND_SOAK)

    stuck = soaked.reject(h < 2.5, Reason.STUCK)

    assert stuck.rejected.tolist() == [Reason.GROUND_SOAK, Reason.STUCK, Reason.USED]
    assert stuck.accepted.tolist() == [False, False, True]
    assert stuck.count(Reason.STUCK) == 1


def test_a_reading_without_value_or_height_is_rejected_where_it_is_made():
    readings = thermometer([1.0, 2.0, NAN, NAN], [280.0, NAN, 281.0, NAN])
    assert readings.rejected.tolist() == [
        Reason.USED,
        Reason.NO_VALUE,
        Reason.NO_HEIGHT,
        Reason.NO_VALUE,
    ]


def test_the_middle_of_heights_gives_each_bin_of_100_m_the_same_weight():
    """Bins 0 and 1: the means of 0, 1 and 2 s, and of 5 s."""
    level_first = thermometer([50.0, 60.0, 70.0, 150.0], seconds=[0, 1, 2, 5])
    assert level_first.middle_of_heights_ns == 3_000_000_000
    assert level_first.middle_ns == 2_500_000_000


def test_what_a_flight_climbed_is_up_and_down_together():
    """Heights at 0, 15 and 30 s."""
    up_and_down = thermometer([0.0, 100.0, 40.0, 40.0], seconds=[0, 15, 30, 45])
    assert up_and_down.climbed_m == pytest.approx(160.0)
    assert up_and_down.extent_m == 100.0


def test_removed_samples_are_in_the_order_of_their_times():
    jumps = reasons_where(np.ones(2, bool), Reason.JUMP)
    jumped = RemovedSamples().and_also(np.array([5, 7]), jumps)

    removed = jumped.and_also(np.array([6]), reasons(Reason.NO_VALUE))

    assert removed.time_ns.tolist() == [5, 6, 7]
    assert removed.reason.tolist() == [Reason.JUMP, Reason.NO_VALUE, Reason.JUMP]
    assert len(removed) == 3


def test_counts_are_those_of_all_samples_that_are_not_used():
    stuck = np.array([True, True, False, True])
    before = reasons(
        Reason.USED,
        Reason.JUMP,
        Reason.USED,
        Reason.OUTLIER,
    )

    after = with_reason(before, stuck, Reason.STUCK)

    assert count_by_reason([after, reasons(Reason.JUMP)]) == {
        Reason.JUMP: 2,
        Reason.STUCK: 1,
        Reason.OUTLIER: 1,
    }
    assert count_by_reason([]) == {}


@pytest.mark.parametrize(
    ("of_estimate", "outliers", "used"),
    [
        ({}, {}, 1),
        (
            {"temperature": reasons(Reason.OUTLIER, Reason.NO_HEIGHT)},
            {Reason.OUTLIER: 1},
            0,
        ),
    ],
)
def test_the_use_of_a_sensor_counts_what_was_removed_before(of_estimate, outliers, used):
    removed = RemovedSamples(np.array([3]), reasons(Reason.JUMP))
    sensor = thermometer([1.0, NAN], name="HYGR[0]", removed=removed)

    (use,) = sensor_uses(AirSamples(sensor), of_estimate)

    before = {Reason.JUMP: 1, Reason.NO_HEIGHT: 1}
    assert use == SensorUse("temperature", "HYGR[0]", 3, before | outliers)
    assert use.used == used
    assert f"{used} of 3 samples used; not used: 1 (" in use.sentence()
