"""Properties of clocks, interpolation and quality that hold for whatever a log contains."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unbend.flight.channels import Channel, Source
from unbend.flight.clock import (
    SECONDS_PER_WEEK,
    clock_map,
    fit_offset,
    later_by_rollovers,
    rows_in_time_order,
    stray_times,
    utc_of_gps,
)
from unbend.flight.evidence.quality import RANGES, mask_impossible_values, plausible_samples
from unbend.flight.interpolation import INSIDE, bracket, interpolate
from unbend.flight.trajectory import track_at

SECOND = 10**9
STEPS = st.lists(st.integers(1, 5 * SECOND), min_size=2, max_size=30)


def channel(steps_ns: list[int], **columns: np.ndarray) -> Channel:
    return Channel("X", np.cumsum(np.array(steps_ns, np.int64)), columns, Source("X"))


@given(STEPS, st.integers(-(10**18), 10**18), st.data())
def test_interpolation_does_not_depend_on_where_time_begins(steps, shift, data):
    values = np.array(
        data.draw(st.lists(st.floats(-1e6, 1e6), min_size=len(steps), max_size=len(steps)))
    )
    x = channel(steps, value=values)
    at = np.array(data.draw(st.lists(st.integers(0, int(x.time_ns[-1]) + 9), min_size=1)))
    later = Channel("X", x.time_ns + shift, x.columns, x.source)
    here = interpolate(x, "value", at, 2.0)
    there = interpolate(later, "value", at + shift, 2.0)
    np.testing.assert_array_equal(here, there)
    known = np.isfinite(here)
    place = bracket(x, at, 2.0)
    assert np.array_equal(known, place.coverage == INSIDE)
    low = np.minimum(values[place.before], values[place.after])
    high = np.maximum(values[place.before], values[place.after])
    slack = 1e-9 * (np.abs(low) + np.abs(high))
    assert np.all((here >= low - slack)[known])
    assert np.all((here <= high + slack)[known])


@given(st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-1e-3, 1e-3), st.floats(0.0, 1.0))
def test_positions_turn_with_the_earth(lat, lon, step, when):
    """The longitude of the origin is arbitrary: turned by 2 rad, the same latitudes."""
    assume(abs(step) > 1e-9)
    lats = np.array([lat, lat + step / 2])
    at = np.array([round(when * SECOND) + SECOND])
    first = channel([SECOND, SECOND], lat_rad=lats, lon_rad=np.array([lon, lon + step]))
    turned = channel([SECOND, SECOND], lat_rad=lats, lon_rad=np.array([lon, lon + step]) + 2.0)
    here = track_at(first, at, 2.0)
    there = track_at(turned, at, 2.0)
    ((a,), (b,)), ((c,), (d,)) = ((t.lat_rad, t.lon_rad) for t in (here, there))
    assert abs(a - c) < 1e-14
    assert abs((d - b - 2.0 + np.pi) % (2.0 * np.pi) - np.pi) < 1e-11


@given(st.integers(0, 2500), st.floats(0.0, SECONDS_PER_WEEK - 1.0), st.floats(0.0, 1e5))
def test_utc_of_gps_never_runs_faster_than_gps(week, seconds, later):
    """UTC is slower by the leap seconds between, of which there were 18 until 2017."""
    elapsed = int(utc_of_gps(week, seconds + later)) - int(utc_of_gps(week, seconds))
    slower = later - elapsed / 1e9
    assert -1e-6 < slower < 1.0 + 1e-6
    assert abs(slower - round(slower)) < 1e-6


@given(st.integers(1560, 2400), st.integers(-1, 2), st.floats(0.0, SECONDS_PER_WEEK - 1.0))
def test_rollovers_of_a_week_give_the_full_week(week, rollovers, seconds):
    early = utc_of_gps([week - 1024 * rollovers], [seconds])
    full = later_by_rollovers(early, rollovers, from_gps_week=True)
    np.testing.assert_array_equal(full, utc_of_gps([week], [seconds]))


@given(st.integers(-(10**18), 10**18), STEPS)
def test_the_offset_of_a_steady_clock_is_exact(offset, steps):
    boot_ns = np.cumsum(np.array(steps, np.int64))
    fit = fit_offset(boot_ns + offset, boot_ns)
    assert (fit.offset_ns, fit.spread_ns, fit.largest_ns) == (offset, 0, 0)


def test_the_spread_is_from_the_5th_to_the_95th_percentile():
    """Of 101 rows late by 0 to 100 ms: the median 50 ms, the spread 90 ms, the farthest 50 ms."""
    boot_ns = np.arange(101) * SECOND
    fit = fit_offset(boot_ns + np.arange(101) * 1_000_000, boot_ns)
    assert (fit.offset_ns, fit.spread_ns, fit.largest_ns) == (50_000_000, 90_000_000, 50_000_000)


@given(STEPS, STEPS)
def test_a_clock_map_goes_through_its_readings_and_never_back(first, second):
    n = min(len(first), len(second))
    a = np.cumsum(first[:n])
    b = np.cumsum(second[:n])
    mapped = clock_map(a, b)
    np.testing.assert_array_equal(mapped(a), b)
    between = np.sort(np.concatenate([a, (a[1:] + a[:-1]) // 2]))
    assert np.all(np.diff(mapped(between)) >= 0)


@given(st.lists(st.integers(0, 100), max_size=40))
def test_rows_in_time_order_increase_strictly(times):
    rows, stretch = rows_in_time_order(np.array(times, np.int64))
    assert np.all(np.diff(np.array(times, np.int64)[rows]) > 0)
    assert rows.shape == stretch.shape
    assert bool(times) == bool(rows.size)


@given(STEPS, st.data())
def test_one_far_stamp_inside_is_the_only_stray(steps, data):
    times = np.cumsum(np.minimum(np.array(steps * 4), SECOND // 2))
    row = data.draw(st.integers(5, times.size - 1)) if times.size > 6 else 0
    assume(5 < row < times.size - 6)
    times[row] += 10_000 * SECOND
    assert np.flatnonzero(stray_times(times)).tolist() == [row]


@settings(max_examples=60)
@given(arrays(np.float64, 40, elements=st.floats(-1e7, 1e7) | st.just(np.nan)))
def test_masking_is_done_once_and_touches_no_plausible_value(values):
    """A second pass finds nothing, and what is kept is what was there."""
    x = channel([SECOND] * 40, pressure_pa=values, other=np.arange(40.0))
    masked, notes = mask_impossible_values(x)
    kept = masked["other"].astype(int)
    known = np.isfinite(masked["pressure_pa"])
    np.testing.assert_array_equal(masked["pressure_pa"][known], values[kept][known])
    if any(entry.code == "SENSOR-ODD" for entry in notes):
        return
    low, high = RANGES["pressure_pa"]
    assert np.all((masked["pressure_pa"][known] >= low) & (masked["pressure_pa"][known] <= high))
    lost = int(np.isfinite(values).sum()) - int(known.sum())
    assert sum(entry.count for entry in notes if entry.kind == "loss") == lost


@given(arrays(np.bool_, 30))
def test_missing_values_are_counted_and_the_rest_is_kept(missing):
    value = np.where(missing, np.nan, 280.0)
    kept, notes = plausible_samples(channel([SECOND] * 30, temperature_k=value), "temperature")
    assert len(kept) == len(kept.boot) == int((~missing).sum())
    assert sum(entry.count for entry in notes) == int(missing.sum())
