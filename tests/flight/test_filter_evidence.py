"""What a filter, an autopilot's texts and second attitudes say against a flight."""

import numpy as np
import pytest

from tests.flight.made_channels import ends_s, texts, turned_channel
from tests.helpers import channel
from unbend.flight.evidence.autopilot_texts import text_evidence
from unbend.flight.evidence.filter_health import attitude_evidence, filter_evidence

T10 = np.arange(0.0, 300.0, 0.1)
TROUBLED = (T10 > 50.0) & (T10 < 60.0)


def health(name, **columns):
    """What a filter says with these columns."""
    return filter_evidence([channel(name, T10, **columns)])


REJECTED = np.where(TROUBLED, 18.0, 0.1)
SETTLES = np.where((T10 >= 60.0) & (T10 < 64.0), 0.8, REJECTED)


def test_innovations_last_until_the_filter_has_settled():
    (stretch,) = health(
        "XKF4[0]",
        innovation_position=SETTLES,
        innovation_velocity=0.2,
    )
    assert stretch.reason == "the filter rejected the receiver's position (innovation ratio 18)"
    assert stretch.quantity == "position"
    assert ends_s(stretch) == pytest.approx((50.0, 64.0), abs=0.2)


def test_of_several_lanes_of_a_filter_the_better_one_counts():
    rejecting = channel("XKF4[0]", T10, innovation_position=SETTLES)
    flown_by = channel("XKF4[1]", T10, innovation_position=0.1)
    assert filter_evidence([rejecting, flown_by]) == []


def test_a_single_large_innovation_is_passed_over():
    ratio = np.full(T10.size, 0.1)
    ratio[900] = 1.3
    assert health("XKF4[0]", innovation_position=ratio) == []


def test_a_rejected_velocity_makes_attitude_and_position_doubtful():
    stretches = health("XKF4[0]", innovation_velocity=SETTLES)
    assert [stretch.quantity for stretch in stretches] == ["attitude", "position"]


@pytest.mark.parametrize(
    ("bit", "says"),
    [
        (15, "GPS glitch"),
        (18, "dead reckoning"),
    ],
)
def test_flags_of_the_filter(bit, says):
    flags = 831 + 2.0**bit * TROUBLED
    (stretch,) = health("EKF_STATUS_REPORT", filter_flags=flags)
    assert says in stretch.reason
    assert stretch.quantity == "position"


def test_clipping_accelerometers_make_the_attitude_doubtful():
    count = np.cumsum(20.0 * TROUBLED)
    (stretch,) = health("VIBE[0]", clipping=count)
    assert stretch.quantity == "attitude"
    assert "200 times a second" in stretch.reason


def evidence(*lines):
    return text_evidence([texts("MSG", *lines)])


LATER = (90.0, "Mission: 3 WP")


def test_what_the_autopilot_says_holds_until_it_says_that_it_is_over():
    position, attitude = evidence(
        (10.0, "Mission: 2 WP"),
        (50.0, "AHRS: DCM active"),
        (80.0, "AHRS: EKF3 active"),
    )
    assert position.quantity == "position"
    assert attitude.quantity == "attitude"
    assert position.reason == 'the autopilot reports "AHRS: DCM active"'
    assert ends_s(position) == (49.5, 80.0)


def test_a_trouble_that_is_never_over_lasts_beyond_the_last_text():
    (stretch,) = evidence((50.0, "GPS Glitch"), LATER)
    assert ends_s(stretch) == (49.5, 90.0 + 3600.0)


@pytest.mark.parametrize("text", ["EKF3 lane switch 1", "PreArm: GPS Glitch"])
def test_an_event_and_a_check_before_take_off_count_for_five_seconds(text):
    stretch = evidence((50.0, text), LATER)[0]
    assert ends_s(stretch) == (49.5, 54.5)


def test_texts_without_trouble_are_none():
    assert evidence((10.0, "GPS 1: detected u-blox"), (12.0, "EKF3 IMU0 is using GPS")) == []


@pytest.mark.parametrize(
    ("begins", "ends"),
    [
        ("GPS Glitch", "GPS Glitch cleared"),
        ("GPS Glitch or Compass error", "Glitch cleared"),
        ("EKF variance", "EKF Failsafe Cleared"),
        ("EKF variance", "EKF variance has stopped"),
        ("EKF variance", "EKF variance good again"),
        ("GPS Glitch", "GPS glitch passed"),
        ("EKF Failsafe: changed to LAND Mode", "EKF Failsafe Cleared"),
        ("Dead Reckoning started", "Dead Reckoning ended"),
        ("dead reckoning active", "dead reckoning stopped"),
        ("GPS signal lost", "GPS signal regained"),
        ("GNSS fix lost", "GNSS fix recovered"),
        ("EKF3 IMU0 stopped aiding", "EKF3 IMU0 is using GPS"),
        ("Position estimate invalid", "Position estimate valid"),
        ("Navigation failure", "Navigation recovered"),
        ("ERR GPS 2", "ERR GPS 0"),
        ("ERR EKFCHECK 2", "ERR EKFCHECK 0"),
    ],
)
def test_a_text_that_ends_a_trouble_begins_none(begins, ends):
    (stretch,) = evidence((50.0, begins), (70.0, ends), LATER)
    assert ends_s(stretch) == (49.5, 70.0)
    assert evidence((70.0, ends)) == []


def test_another_trouble_that_ends_does_not_end_this_one():
    (glitch,) = evidence(
        (50.0, "GPS Glitch"),
        (60.0, "EKF Failsafe Cleared"),
        (70.0, "Glitch cleared"),
    )
    assert ends_s(glitch) == (49.5, 70.0)


def test_an_end_that_is_waited_for_is_none():
    lost, _ = evidence((50.0, "GPS signal lost"), (51.0, "Dead reckoning until GPS regained"))
    assert ends_s(lost) == (49.5, 51.0 + 3600.0)


def test_a_trouble_of_one_channel_of_texts_may_end_in_another():
    message = texts("MSG", (50.0, "EKF variance"))
    error = texts("ERR", (65.0, "ERR EKFCHECK 0"))
    (stretch,) = text_evidence([message, error])
    assert ends_s(stretch) == (49.5, 65.0)


def rolled(name, t, roll_deg):
    return turned_channel(name, t, "x", roll_deg[:, None], "attitude")


def test_two_attitudes_that_part():
    is_apart = (T10 > 50.0) & (T10 < 58.0)
    attitude = rolled("ATT", T10, 7.5 * is_apart)
    level = rolled("XKF1[0]", T10, 0.0 * T10)
    (stretch,) = attitude_evidence(attitude, [level])
    assert stretch.reason == "ATT and XKF1[0] are 7.5 deg apart"
    assert ends_s(stretch) == pytest.approx((50.0, 58.0), abs=0.5)


def test_a_slow_attitude_in_a_fast_roll_does_not_part():
    def bank(t):
        return np.interp(t, [100.0, 101.0, 110.0, 111.0], [0.0, 45.0, 45.0, 0.0])

    slow_s = np.arange(0.05, 299.0, 0.2)
    late = rolled("AHR2", slow_s, bank(slow_s - 0.15))
    attitude = rolled("ATT", T10, bank(T10))
    assert attitude_evidence(attitude, [late]) == []
