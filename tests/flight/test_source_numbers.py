"""Steps, silences, lags and differences of sources of position and height: numbers by hand."""

import math

import numpy as np
import pytest

from tests.flight.made_channels import EARTH_M, instants, standard_pressure_pa
from tests.helpers import NS_PER_S, channel
from unbend.flight.evidence.contradictions import receiver_silences
from unbend.flight.evidence.source_differences import (
    air_change_m,
    height_of_pressure,
    source_difference,
)
from unbend.flight.evidence.sources import (
    moves_of,
    north_east_m,
    source_path,
    velocity_at,
)
from unbend.flight.evidence.stretches import HEIGHT, POSITION

ROW = np.arange(60)
TIMES_S = 1.0 * ROW
PLACE = {
    "lat_rad": 0.8,
    "lon_rad": 0.2,
    "h_msl_m": 500.0,
}
AT_REST = np.zeros((60, 2))


def receiver(name, times_s=TIMES_S, **columns):
    return channel(name, times_s, "height", "position", **PLACE | columns)


def path_of_heights(times_s=TIMES_S, **columns):
    logged = channel("A", times_s, **columns)
    return source_path(logged, HEIGHT, ())


def path_to_the_north(north_m, times_s=TIMES_S):
    logged = receiver("GPS[1]", times_s, lat_rad=0.8 + north_m / EARTH_M)
    return source_path(logged, POSITION, ())


def difference_from_rest(other, times_s=TIMES_S):
    """A path beside a receiver that is always at one place."""
    first = receiver("GPS[0]", times_s)
    return source_difference(first, other, POSITION, AT_REST)


def test_metres_of_a_change_are_shorter_along_a_parallel():
    """1e-5 rad are 63.71 m; at 60 degrees half of it to the east."""
    change = np.array(
        [
            [1e-5, 1e-5],
            [-2e-5, 2.0 * np.pi - 1e-5],
        ]
    )

    moved_m = north_east_m(change, np.full(2, math.pi / 3.0))

    expected_m = [[63.71, 31.855], [-127.42, -31.855]]
    np.testing.assert_allclose(moved_m, expected_m, rtol=1e-6)


def test_moves_from_sample_to_sample():
    """1e-6 rad are 6.371 m; at a latitude of 60 degrees half of it to the east."""
    flown = receiver(
        "A",
        lat_rad=math.pi / 3.0 + 1e-6 * TIMES_S,
        lon_rad=0.2 - 1e-6 * TIMES_S,
        h_msl_m=3.0 * TIMES_S,
    )
    north_east_m = [6.371, -3.1855]
    np.testing.assert_allclose(moves_of(flown, HEIGHT), [[3.0]] * 59)
    np.testing.assert_allclose(moves_of(flown, POSITION), [north_east_m] * 59, rtol=2e-4)


def test_a_velocity_down_is_a_negative_climb_and_the_first_channel_that_has_it_counts():
    mute = channel("A", TIMES_S, v_north_m_s=9.0)
    first = channel(
        "B",
        TIMES_S,
        v_north_m_s=1.0,
        v_east_m_s=2.0,
        v_down_m_s=3.0,
    )
    second = channel(
        "C",
        TIMES_S,
        v_north_m_s=7.0,
        v_east_m_s=7.0,
        v_down_m_s=7.0,
    )
    channels = (mute, first, second)
    time_ns = instants(3, 4)

    assert velocity_at(channels, HEIGHT, time_ns).tolist() == [[-3.0]] * 2
    assert velocity_at(channels, POSITION, time_ns).tolist() == [[1.0, 2.0]] * 2
    assert np.isnan(velocity_at((mute,), POSITION, time_ns)).all()


@pytest.mark.parametrize(
    ("step_m", "is_step"),
    [
        # 5 m, and 4 m/s^2 over a second
        (6.9, False),
        (7.1, True),
        (-6.9, False),
        (-7.1, True),
    ],
)
def test_a_height_that_steps_and_returns_is_away_in_between(step_m, is_step):
    is_away = (TIMES_S >= 20.0) & (TIMES_S < 26.0)
    height_m = step_m * is_away

    path = path_of_heights(h_msl_m=height_m)

    np.testing.assert_allclose(path.stepped_m[:, 0], height_m * is_step)
    assert path.good.tolist() == (~is_away | (not is_step)).tolist()
    assert path.step_ns.tolist() == instants(20, 26).tolist() * is_step
    assert path.lasting_ns.size == 0
    assert path.fastest_m_s == pytest.approx(abs(step_m) * is_step)
    assert np.unique(path.part).size == 1


@pytest.mark.parametrize(("step_m", "is_step"), [(4.9, False), (5.1, True)])
def test_a_position_that_steps_for_good_begins_another_part(step_m, is_step):
    """3 m, and 4 m/s^2 over a second."""
    path = path_to_the_north(step_m * (TIMES_S >= 40.0))

    assert path.lasting_ns.tolist() == instants(40).tolist() * is_step
    assert np.unique(path.part).size == 1 + is_step
    assert not path.stepped_m.any()


@pytest.mark.parametrize(("gap_s", "steps"), [(9.0, 1), (11.0, 0)])
def test_over_eleven_seconds_a_vehicle_may_have_gone_anywhere(gap_s, steps):
    times_s = np.append(TIMES_S, 59.0 + gap_s + TIMES_S)
    heights_m = np.repeat([0.0, 400.0], 60)
    path = path_of_heights(times_s, h_msl_m=heights_m)
    assert path.step_ns.size == steps


@pytest.mark.parametrize(
    ("usual_m", "reported_m", "is_good"),
    [
        (1.0, 4.9, True),
        (1.0, 5.1, False),
        (2.0, 5.9, True),
        (2.0, 6.1, False),
    ],
)
def test_an_accuracy_worse_than_five_metres_and_thrice_the_usual_is_of_no_use(
    usual_m, reported_m, is_good
):
    is_worse = ROW == 30
    sigma_m = np.where(is_worse, reported_m, usual_m)
    path = path_of_heights(h_msl_m=0.0, sigma_v_m=sigma_m)
    assert path.good.tolist() == (~is_worse | is_good).tolist()


@pytest.mark.parametrize("lag_s", [0.12, -0.2])
@pytest.mark.parametrize(
    "begin_rad",
    [0.2, math.pi - 1e-4],
    ids=["east", "the 180th meridian"],
)
def test_the_lag_and_the_offset_of_two_receivers(lag_s, begin_rad):
    """Both fly east at 20 m/s; the second is ``lag_s`` behind, and 1.5 m to the north."""
    speed_rad_s = 20.0 / EARTH_M / math.cos(0.8)

    def longitude(flown_s):
        east_rad = begin_rad + speed_rad_s * flown_s
        return np.remainder(east_rad + math.pi, 2.0 * math.pi) - math.pi

    first = receiver("GPS[0]", lon_rad=longitude(TIMES_S))
    second = receiver(
        "GPS[1]",
        lat_rad=0.8 + 1.5 / EARTH_M,
        lon_rad=longitude(TIMES_S - lag_s),
    )
    velocity = np.tile([0.0, 20.0], (60, 1))

    path = source_path(second, POSITION, ())
    difference = source_difference(first, path, POSITION, velocity)

    assert path.step_ns.size == 0
    assert difference.lag_s == pytest.approx(lag_s, abs=1e-6)
    inner = slice(1, -1)
    np.testing.assert_allclose(difference.apart_m[inner], [[-1.5, 0.0]] * 58, atol=1e-4)
    np.testing.assert_allclose(difference.off_m[inner], 0.0, atol=1e-4)
    np.testing.assert_allclose(difference.limit_m, 2.0, atol=1e-4)
    assert difference.apart == []


def test_two_receivers_that_are_apart_for_some_seconds():
    """By 3 m, beyond the 2 m of noise; the run reaches as far as they differ by more than 1 m."""
    apart_m = np.interp(TIMES_S, [20.0, 30.0, 40.0], [0.0, 3.0, 0.0])
    difference = difference_from_rest(path_to_the_north(apart_m))
    assert difference.off_m.max() == pytest.approx(3.0, abs=1e-3)
    assert difference.apart == [(24, 36)]


@pytest.mark.parametrize(("agreeing", "offset_m"), [(9, 0.0), (5, 50.0)])
def test_two_sources_do_not_agree_by_chance_in_a_tenth_of_a_flight(agreeing, offset_m):
    """They are at one place for 9 or 5 of 60 samples, and else 50 m apart, reached slowly."""
    times_s = 10.0 * TIMES_S
    apart_m = np.where(agreeing > ROW, 0.0, 50.0)
    second = path_to_the_north(-apart_m, times_s)
    difference = difference_from_rest(second, times_s)
    np.testing.assert_allclose(difference.off_m, np.abs(apart_m - offset_m), atol=1e-3)


def test_the_air_moves_a_height_of_a_pressure_by_hours_and_metres():
    """4.2 m in an hour, and 2 m for 1000 m of height, from the middle of what is settled."""
    time_ns = instants(0, 7200, 14_400, 28_800)
    height_m = np.array([100.0, 100.0, 100.0, 1100.0])
    is_settled = height_m < 200.0

    change_m = air_change_m(time_ns, height_m, is_settled)

    np.testing.assert_allclose(
        change_m,
        [
            8.4,
            0.0,
            8.4,
            math.hypot(25.2, 2.0),
        ],
    )
    never_settled = np.zeros(4, bool)
    assert not air_change_m(time_ns, height_m, never_settled).any()


@pytest.mark.parametrize(("top_m", "tolerance_m"), [(250.0, 2.5), (2000.0, 0.3)])
def test_a_barometer_as_a_source_of_heights(top_m, tolerance_m):
    """Standard air; under 300 m its relation is a line, whose slope is that of the ground's air.

    One pressure that is wrong by 100 m does not move the others.
    """
    height_m = np.linspace(0.0, top_m, 60)
    pressure_pa = standard_pressure_pa(height_m)
    pressure_pa[30] *= math.exp(-100.0 / 8434.5)
    barometer = channel("BARO", TIMES_S, pressure_pa=pressure_pa)
    height = channel("GPS", TIMES_S, "height", h_msl_m=height_m)

    off_m = height_of_pressure(barometer, height)["h_msl_m"] - height_m

    np.testing.assert_allclose(np.delete(off_m, 30), 0.0, atol=tolerance_m)
    assert off_m[30] == pytest.approx(100.0, abs=25.0)
    assert height_of_pressure(barometer.rows(TIMES_S < 29.0), height) is None


@pytest.mark.parametrize(
    ("gap_s", "silent_s"),
    [
        (1.9, []),
        (2.1, [20.5, pytest.approx(22.1)]),
    ],
)
def test_a_receiver_is_silent_for_more_than_two_seconds_while_another_channel_goes_on(
    gap_s, silent_s
):
    before_s = np.arange(0.0, 20.01, 0.2)
    after_s = np.arange(20.0 + gap_s, 40.0, 0.2)
    times_s = np.append(before_s, after_s)
    fixes = channel("GPS[0]", times_s)
    goes_on = channel("IMU", np.arange(0.0, 40.0, 0.1))
    stops_too = channel("IMU", times_s)

    stretches = receiver_silences(fixes, goes_on, HEIGHT)

    ends_s = []
    for stretch in stretches:
        assert stretch.reason == "GPS[0] has no fix for 2 s"
        ends_s += [stretch.begin_ns / NS_PER_S, stretch.end_ns / NS_PER_S]
    assert ends_s == silent_s
    assert receiver_silences(fixes, stops_too, HEIGHT) == []
