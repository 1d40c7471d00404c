"""Steps, silences, lags and differences of sources of position and height: numbers by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.contradictions import silences
from unbend.flight.evidence.source_differences import (
    air_change_m,
    height_of_pressure,
    source_difference,
)
from unbend.flight.evidence.sources import metres, moves_of, source_path, velocity_at
from unbend.flight.evidence.stretches import HEIGHT, POSITION

SECOND = 1_000_000_000
HOUR = 3600 * SECOND
TIMES_S = np.arange(0.0, 60.0)


def channel(name: str, times_s: np.ndarray, roles: tuple[str, ...] = (), **columns) -> Channel:
    arrays = {
        key: np.broadcast_to(np.asarray(values, float), times_s.shape).copy()
        for key, values in columns.items()
    }
    return Channel(
        name, np.round(times_s * SECOND).astype(np.int64), arrays, Source(name), roles=roles
    )


def test_metres_of_a_change_are_shorter_along_a_parallel():
    """1e-5 rad are 63.71 m; at 60 degrees half of it to the east."""
    change = np.array([[1e-5, 1e-5], [-2e-5, 2.0 * np.pi - 1e-5]])
    moved = metres(change, np.full(2, math.pi / 3.0))
    np.testing.assert_allclose(moved, [[63.71, 31.855], [-127.42, -31.855]], rtol=1e-6)
    placed = channel("A", TIMES_S, lat_rad=1.0 + 1e-6 * TIMES_S, lon_rad=0.5, h_msl_m=3.0 * TIMES_S)
    np.testing.assert_allclose(moves_of(placed, HEIGHT), np.full((59, 1), 3.0))
    np.testing.assert_allclose(moves_of(placed, POSITION)[:, 0], 6.371)
    np.testing.assert_allclose(moves_of(placed, POSITION)[:, 1], 0.0)


def test_a_velocity_down_is_a_negative_climb_and_the_first_channel_that_has_it_counts():
    mute = channel("A", TIMES_S, v_north_m_s=9.0)
    first = channel("B", TIMES_S, v_north_m_s=1.0, v_east_m_s=2.0, v_down_m_s=3.0)
    second = channel("C", TIMES_S, v_north_m_s=7.0, v_east_m_s=7.0, v_down_m_s=7.0)
    when = first.time_ns[3:5]
    assert velocity_at((mute, first, second), HEIGHT, when).tolist() == [[-3.0], [-3.0]]
    assert velocity_at((mute, first, second), POSITION, when).tolist() == [[1.0, 2.0]] * 2
    assert np.isnan(velocity_at((mute,), POSITION, when)).all()


@pytest.mark.parametrize(
    ("step_m", "is_step"),
    [(6.9, False), (7.1, True), (-6.9, False), (-7.1, True)],  # 5 m, and 4 m/s^2 over a second
)
def test_a_height_that_steps_and_returns_is_away_in_between(step_m, is_step):
    is_away = (TIMES_S >= 20.0) & (TIMES_S < 26.0)
    path = source_path(channel("A", TIMES_S, h_msl_m=np.where(is_away, step_m, 0.0)), HEIGHT, ())
    np.testing.assert_allclose(path.stepped_m[:, 0], np.where(is_away, step_m, 0.0) * is_step)
    assert path.good.tolist() == (~is_away | (not is_step)).tolist()
    assert (path.step_ns / SECOND).tolist() == [20.0, 26.0] * is_step
    assert path.lasting_ns.size == 0
    assert path.fastest_m_s == pytest.approx(abs(step_m) * is_step)
    assert np.unique(path.part).size == 1


@pytest.mark.parametrize(("step_m", "is_step"), [(4.9, False), (5.1, True)])
def test_a_position_that_steps_for_good_begins_another_part(step_m, is_step):
    """3 m, and 4 m/s^2 over a second."""
    north_m = np.where(TIMES_S >= 40.0, step_m, 0.0)
    path = source_path(
        channel("A", TIMES_S, lat_rad=0.8 + north_m / 6.371e6, lon_rad=0.2), POSITION, ()
    )
    assert (path.lasting_ns / SECOND).tolist() == [40.0] * is_step
    assert np.unique(path.part).size == 1 + is_step
    assert not path.stepped_m.any()


def test_over_eleven_seconds_a_vehicle_may_have_gone_anywhere():
    for gap_s, steps in ((9.0, 1), (11.0, 0)):
        times_s = np.concatenate([TIMES_S, 59.0 + gap_s + TIMES_S])
        heights_m = np.repeat([0.0, 400.0], 60)
        path = source_path(channel("A", times_s, h_msl_m=heights_m), HEIGHT, ())
        assert path.step_ns.size == steps


@pytest.mark.parametrize(
    ("usual_m", "reported_m", "is_good"),
    [(1.0, 4.9, True), (1.0, 5.1, False), (2.0, 5.9, True), (2.0, 6.1, False)],
)
def test_an_accuracy_worse_than_five_metres_and_thrice_the_usual_is_of_no_use(
    usual_m, reported_m, is_good
):
    sigma_m = np.where(TIMES_S == 30.0, reported_m, usual_m)
    path = source_path(channel("A", TIMES_S, h_msl_m=0.0, sigma_v_m=sigma_m), HEIGHT, ())
    assert path.good.tolist() == ((TIMES_S != 30.0) | is_good).tolist()


@pytest.mark.parametrize("lag_s", [0.12, -0.2])
def test_the_lag_and_the_offset_of_two_receivers(lag_s):
    """Both fly east at 20 m/s; the second is ``lag_s`` behind, and 1.5 m to the north."""
    roles = ("height", "position")
    metre = 1.0 / 6.371e6
    cosine = math.cos(0.8)
    first, second = (
        channel(
            name,
            TIMES_S,
            roles,
            lat_rad=0.8 + north_m * metre,
            lon_rad=0.2 + 20.0 * (TIMES_S - behind_s) * metre / cosine,
            h_msl_m=500.0,
        )
        for name, behind_s, north_m in (("GPS[0]", 0.0, 0.0), ("GPS[1]", lag_s, 1.5))
    )
    velocity = np.tile([0.0, 20.0], (60, 1))
    difference = source_difference(first, source_path(second, POSITION, ()), POSITION, velocity)
    assert difference.lag_s == pytest.approx(lag_s, abs=1e-6)
    np.testing.assert_allclose(difference.apart_m[1:-1], [[-1.5, 0.0]] * 58, atol=1e-4)
    np.testing.assert_allclose(difference.off_m[1:-1], 0.0, atol=1e-4)
    np.testing.assert_allclose(difference.limit_m, 2.0, atol=1e-4)
    assert difference.apart == []


def test_two_receivers_that_are_apart_for_some_seconds():
    """By 3 m, beyond the 2 m of noise; the run reaches as far as they differ by more than 1 m."""
    roles = ("height", "position")
    apart_m = np.interp(TIMES_S, [20.0, 30.0, 40.0], [0.0, 3.0, 0.0])
    still = channel("GPS[0]", TIMES_S, roles, lat_rad=0.8, lon_rad=0.2, h_msl_m=500.0)
    moving = channel(
        "GPS[1]", TIMES_S, roles, lat_rad=0.8 + apart_m / 6.371e6, lon_rad=0.2, h_msl_m=500.0
    )
    path = source_path(moving, POSITION, ())
    difference = source_difference(still, path, POSITION, np.zeros((60, 2)))
    assert difference.off_m.max() == pytest.approx(3.0, abs=1e-3)
    assert [(run.first, run.last) for run in difference.apart] == [(24, 36)]


def test_the_air_moves_a_height_of_a_pressure_by_hours_and_metres():
    """4.2 m in an hour, and 2 m for 1000 m of height, from the middle of what is settled."""
    time_ns = np.array([0, 2, 4, 8]) * HOUR
    height_m = np.array([100.0, 100.0, 100.0, 1100.0])
    change_m = air_change_m(time_ns, height_m, np.array([True, True, True, False]))
    np.testing.assert_allclose(change_m, [8.4, 0.0, 8.4, math.hypot(25.2, 2.0)])
    assert air_change_m(time_ns, height_m, np.zeros(4, bool)).tolist() == [0.0] * 4


@pytest.mark.parametrize("top_m", [250.0, 2000.0])
def test_a_barometer_as_a_source_of_heights(top_m):
    """Standard air; under 300 m its relation is a line, whose slope is that of the ground's air.

    One pressure that is wrong by 100 m does not move the others.
    """
    height_m = np.linspace(0.0, top_m, 60)
    pressure_pa = 101_325.0 * (1.0 - 0.0065 * height_m / 288.15) ** 5.25588
    wrong = pressure_pa.copy()
    wrong[30] *= math.exp(-100.0 / 8434.5)
    barometer = channel("BARO[0]", TIMES_S, pressure_pa=wrong)
    height = channel("GPS[0]", TIMES_S, ("height",), h_msl_m=height_m)
    heights_m = height_of_pressure(barometer, height)["h_msl_m"]
    tolerance_m = 2.5 if top_m < 300.0 else 0.3
    is_right = np.arange(60) != 30
    np.testing.assert_allclose(heights_m[is_right], height_m[is_right], atol=tolerance_m)
    assert heights_m[30] - height_m[30] == pytest.approx(100.0, abs=25.0)
    few = channel("BARO[0]", TIMES_S[:29], pressure_pa=wrong[:29])
    assert height_of_pressure(few, height) is None


@pytest.mark.parametrize(("gap_s", "is_silent"), [(1.9, False), (2.1, True)])
def test_a_receiver_is_silent_for_more_than_two_seconds_while_another_channel_goes_on(
    gap_s, is_silent
):
    before_s = np.arange(0.0, 20.01, 0.2)
    after_s = np.arange(20.0 + gap_s, 40.0, 0.2)
    receiver = channel("GPS[0]", np.concatenate([before_s, after_s]))
    goes_on = channel("IMU", np.arange(0.0, 40.0, 0.1))
    found = silences(receiver, goes_on, HEIGHT)
    assert [(s.begin_ns / SECOND, s.end_ns / SECOND) for s in found] == [
        (20.5, pytest.approx(20.0 + gap_s))
    ] * is_silent
    assert [stretch.reason for stretch in found] == ["GPS[0] has no fix for 2 s"] * is_silent
    stops_too = channel("IMU", np.concatenate([before_s, after_s]))
    assert silences(receiver, stops_too, HEIGHT) == []


@pytest.mark.parametrize(("agreeing", "offset_m"), [(9, 0.0), (5, 50.0)])
def test_two_sources_do_not_agree_by_chance_in_a_tenth_of_a_flight(agreeing, offset_m):
    """They are at one place for 9 or 5 of 60 seconds, and else 50 m apart, reached slowly."""
    roles = ("height", "position")
    times_s = np.arange(0.0, 600.0, 10.0)
    apart_m = np.where(np.arange(60) < agreeing, 0.0, 50.0)
    first = channel("GPS[0]", times_s, roles, lat_rad=0.8, lon_rad=0.2, h_msl_m=500.0)
    second = channel(
        "GPS[1]", times_s, roles, lat_rad=0.8 - apart_m / 6.371e6, lon_rad=0.2, h_msl_m=500.0
    )
    path = source_path(second, POSITION, ())
    difference = source_difference(first, path, POSITION, np.zeros((60, 2)))
    np.testing.assert_allclose(difference.off_m, np.abs(apart_m - offset_m), atol=1e-3)
