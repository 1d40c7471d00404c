"""What a log says against itself: contradictions of sources of a flight made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import EARTH_M, counted, located
from tests.helpers import NS_PER_S, channel
from unbend.atmosphere.rejection import Reason
from unbend.flight.channels import Channel
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.stretches import POSITION, Stretch, flag_suspect, merged, runs
from unbend.flight.stations import empty_stations

Error = Callable[[np.ndarray], np.ndarray]

SPEED_M_S = 25.0  # to the east
CLIMB_M_S = 2.0
LAG_S = 0.12  # of the receiver behind the filter
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(11.0)
PARALLEL_M = EARTH_M * np.cos(LATITUDE)
VELOCITY = {"v_north_m_s": 0.0, "v_east_m_s": SPEED_M_S, "v_down_m_s": -CLIMB_M_S}
T10 = np.arange(0.0, 300.0, 0.1)
T5 = np.arange(0.05, 299.0, 0.2)


def none(t: np.ndarray) -> np.ndarray:
    return np.zeros(t.shape)


def glitch(size_m: float) -> Error:
    """An error from 100 to 120 s."""
    return lambda t: np.where((t > 100.0) & (t < 120.0), size_m, 0.0)


def drift(seconds: Sequence[float], metres: Sequence[float]) -> Error:
    return lambda t: np.interp(t, seconds, metres)


def step(at_s: float, size_m: float) -> Error:
    return lambda t: np.where(t > at_s, size_m, 0.0)


THERE_AND_BACK = drift([100.0, 120.0, 140.0], [0.0, 40.0, 0.0])


def placed(
    name: str,
    t: np.ndarray,
    *roles: str,
    lag_s: float = 0.0,
    north: Error = none,
    up: Error = none,
    seed: int = 1,
    **columns: object,
) -> Channel:
    """A source of a flight to the east that climbs, with 5 cm of noise."""
    noise_m = np.random.default_rng(seed).normal(0.0, 0.05, (2, t.size))
    flown_s = t - lag_s
    return channel(
        name,
        t,
        *roles,
        lat_rad=LATITUDE + (north(t) + noise_m[0]) / EARTH_M,
        lon_rad=LONGITUDE + SPEED_M_S * flown_s / PARALLEL_M,
        h_msl_m=600.0 + CLIMB_M_S * flown_s + up(t) + noise_m[1],
        **VELOCITY | columns,
    )


def receiver(name: str = "GPS[0]", **changes: object) -> Channel:
    usual = {"lag_s": LAG_S, "sigma_h_m": 0.5, "sigma_v_m": 0.8, "seed": 2}
    return placed(name, T5, "height", "position", **usual | changes)


def second_receiver(**changes: object) -> Channel:
    return receiver("GPS[1]", **{"seed": 3, "north": lambda t: none(t) + 0.4} | changes)


def barometer(name: str = "BARO[0]", up: Error = none) -> Channel:
    height_m = 600.0 + CLIMB_M_S * T10 + up(T10)
    return channel(name, T10, "pressure", pressure_pa=101_325.0 * np.exp(-height_m / 8434.5))


def flight(
    *others: Channel, gps: Channel | None = None, north: Error = none
) -> tuple[list[Channel], dict[str, Channel]]:
    """Channels and roles of a filter, and of a receiver that leads it away to the north."""
    pos = placed("POS", T10, "position", north=north)
    gps = gps or receiver(north=north)
    roles = {"position": pos, "height": gps}
    if others and others[0].name == "BARO[0]":
        roles["pressure"] = others[0]
    return [pos, gps, *others], roles


def replaced(stretches: Sequence[Stretch]) -> list[tuple[str, str]]:
    """What is suspect, and by which source it is replaced."""
    return sorted((stretch.quantity, stretch.replaced_by) for stretch in stretches)


def lasts_s(stretch: Stretch) -> list[float]:
    """Begin and end."""
    return [stretch.begin_ns / NS_PER_S, stretch.end_ns / NS_PER_S]


def suspected(stretches: Sequence[Stretch], quantity: str, t: np.ndarray) -> np.ndarray:
    """(n,) at which seconds a quantity is suspect."""
    time_ns = np.round(t * NS_PER_S).astype(np.int64)
    is_suspect = np.zeros(t.size, bool)
    for stretch in stretches:
        if stretch.quantity == quantity:
            is_suspect |= stretch.covers(time_ns)
    return is_suspect


def test_a_good_flight_is_not_doubted():
    _, stretches, notes = examine(*flight(barometer(), second_receiver()))
    assert stretches == ()
    assert notes == ()


@pytest.mark.parametrize("north_m", [12.0, 77.0])
def test_a_glitch_that_the_filter_follows_lasts_from_step_to_step(north_m):
    """The fix is wrong in height too."""
    _, stretches, _ = examine(*flight(north=glitch(north_m)))
    assert replaced(stretches) == [("height", "POS"), ("position", "")]
    (of_position,) = [stretch for stretch in stretches if stretch.quantity == POSITION]
    assert lasts_s(of_position) == pytest.approx([100.0, 120.0], abs=0.5)
    assert of_position.off_m == pytest.approx(north_m, abs=1.0)
    assert "GPS[0] steps at" in of_position.reason


def test_a_second_receiver_that_stays_replaces_position_and_its_sigma():
    second = second_receiver(lag_s=0.2, sigma_h_m=0.9)
    roles, stretches, _ = examine(*flight(second, north=glitch(77.0)))
    assert replaced(stretches) == [("height", "GPS[1]"), ("position", "GPS[1]")]
    position = roles["position"]
    seconds = position.time_ns / NS_PER_S
    inside = (seconds > 100.5) & (seconds < 119.5)
    north_m = (position["lat_rad"] - LATITUDE) * EARTH_M
    east_m = (position["lon_rad"] - LONGITUDE) * PARALLEL_M
    assert north_m[inside] == pytest.approx(0.0, abs=0.3)
    assert east_m[inside] == pytest.approx(SPEED_M_S * seconds[inside], abs=0.3)  # without lag
    assert position["sigma_h_m"][inside] == pytest.approx(1.0, abs=0.1)


def test_a_receiver_that_is_the_position_is_replaced_by_the_filter():
    channels, _ = flight(gps=receiver(north=glitch(40.0), up=glitch(30.0)))
    gps = channels[1]
    roles, stretches, _ = examine(channels, {"position": gps, "height": gps})
    assert replaced(stretches) == [("height", "POS"), ("position", "POS")]
    height = roles["height"]
    seconds = height.time_ns / NS_PER_S
    inside = (seconds > 100.5) & (seconds < 119.5)
    flown_m = 600.0 + CLIMB_M_S * (seconds - LAG_S)
    assert height["h_msl_m"][inside] == pytest.approx(flown_m[inside], abs=0.5)


@pytest.mark.parametrize(
    ("lost_s", "suspect"), [(10.0, [("height", "POS"), ("position", "")]), (1.5, [])]
)
def test_a_filter_without_fix_is_doubtful_and_a_short_loss_is_not(lost_s, suspect):
    has_fix = (T5 < 100.0) | (100.0 + lost_s < T5)
    _, stretches, _ = examine(*flight(gps=receiver().rows(has_fix)))
    assert replaced(stretches) == suspect
    assert {s.reason for s in stretches} <= {"GPS[0] has no fix for 10 s"}


def test_poor_reported_accuracy_is_suspect():
    _, (stretch,), _ = examine(*flight(gps=receiver(sigma_h_m=0.5 + glitch(11.5)(T5))))
    assert stretch.quantity == POSITION
    assert "worse than 5 m" in stretch.reason


def test_a_step_without_return_makes_half_a_minute_doubtful_on_either_side():
    _, (stretch,), _ = examine(*flight(north=step(200.0, 50.0)))
    assert stretch.quantity == POSITION
    assert "does not return" in stretch.reason
    assert lasts_s(stretch) == pytest.approx([170.0, 230.0], abs=0.2)


def test_a_second_receiver_shows_a_slow_drift_that_nothing_else_shows():
    """Who is right is not known: nothing replaces the position."""
    _, stretches, _ = examine(*flight(north=THERE_AND_BACK))
    assert stretches == ()
    _, stretches, _ = examine(*flight(second_receiver(), north=THERE_AND_BACK))
    assert replaced(stretches) == [("position", "")]
    assert stretches[0].off_m == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize(
    "error", [step(60.0, 40.0), drift([60.0, 90.0], [0.0, 40.0])], ids=["step", "drift"]
)
def test_a_fault_longer_than_half_a_flight_is_seen_by_a_second_receiver(error):
    """Nothing agrees with the first receiver afterwards."""
    gps = receiver(north=error, up=error)
    _, stretches, _ = examine(*flight(second_receiver(lag_s=0.2), north=error, gps=gps))
    assert set(replaced(stretches)) == {("position", ""), ("height", "")}
    for quantity in ("position", "height"):
        assert suspected(stretches, quantity, T5[T5 > 75.0]).all()
        assert not suspected(stretches, quantity, T5[T5 < 25.0]).any()


@pytest.mark.parametrize(
    ("sigma_before_m", "wrong_before"), [(0.8, False), (2.5, True)], ids=["as good", "better"]
)
def test_a_height_that_steps_for_most_of_a_flight_is_seen_by_the_barometer(
    sigma_before_m, wrong_before
):
    """A receiver that is better after its step, as it reports, was wrong before it."""
    sigma_m = np.where(T5 < 60.0, sigma_before_m, 0.8)
    gps = receiver(up=step(60.0, 40.0), sigma_v_m=sigma_m)
    _, stretches, _ = examine(*flight(barometer(), gps=gps))
    assert replaced(stretches) == [("height", "")]
    before = suspected(stretches, "height", T5[T5 < 25.0])
    after = suspected(stretches, "height", T5[T5 > 95.0])
    assert (before == wrong_before).all()
    assert (after != wrong_before).all()


WINDS_UP = drift([80.0, 105.0, 115.0, 140.0], [0.0, 40.0, 40.0, 0.0])


@pytest.mark.parametrize("spare", [True, False], ids=["spare barometer", "vertical velocity"])
def test_a_barometer_that_winds_up_leaves_the_stations_and_its_pressure_is_not_used(spare):
    wound = barometer(up=WINDS_UP)
    gps = receiver()
    spares = []
    if spare:
        spares = [barometer("BARO[1]")]
        without = {name: values for name, values in gps.columns.items() if name != "v_down_m_s"}
        gps = replace(gps, columns=without)
    examined, stretches, notes = examine(*flight(wound, *spares, gps=gps))
    assert stretches == ()
    assert located(notes) == [("warning", "BARO-DRIFT", "BARO[0]")]
    removed = examined["pressure"].removed
    # Of 600 in the minute, those that are off by more than the weather and an inversion make of a
    # climb, some 17 m: that limit is a little larger than the scatter of the climb alone.
    assert removed.time_ns.size > 380
    assert removed.time_ns.min() > 80 * NS_PER_S
    assert set(removed.reason) == {Reason.BAROMETER_DRIFT}
    assert len(examined["pressure"]) == T10.size - removed.time_ns.size


def test_a_second_barometer_that_winds_up_is_noted_and_no_pressure_is_removed():
    examined, stretches, notes = examine(*flight(barometer(), barometer("BARO[1]", WINDS_UP)))
    assert stretches == ()
    assert located(notes) == [("note", "BARO-DRIFT", "BARO[1]")]
    assert len(examined["pressure"]) == T10.size


def test_a_height_that_contradicts_its_own_velocity_and_the_barometer_is_doubtful():
    _, stretches, notes = examine(*flight(barometer(), gps=receiver(up=THERE_AND_BACK)))
    assert ("height", "") in replaced(stretches)
    assert any("BARO[0]" in stretch.reason for stretch in stretches)
    assert notes == ()


def test_runs_need_a_seed_and_join_across_a_second():
    time_ns = np.arange(100) * NS_PER_S // 10
    bad = np.zeros(100, bool)
    bad[[10, 11, 12, 18, 50]] = True
    seed = np.zeros(100, bool)
    seed[11] = True
    assert runs(time_ns, bad, seed) == [(10, 18)]


def test_reasons_of_stretches_that_touch_are_joined():
    first = Stretch(0, 10, "position", "a", 3.0)
    second = Stretch(5, 20, "position", "b", np.nan)
    later = Stretch(10 * NS_PER_S, 11 * NS_PER_S, "position", "c")
    joined = merged([later, second, first])
    assert joined == [replace(first, end_ns=20, reason="a; b"), later]


@pytest.mark.parametrize("use", [True, False])
def test_flagged_stations_have_reason_and_distance_and_are_used_only_where_asked(use):
    begin_s = 1_700_000_000  # 2023-11-14T22:13:20

    def stretch(first_s: int, last_s: int, *reason: object) -> Stretch:
        return Stretch((begin_s + first_s) * NS_PER_S, (begin_s + last_s) * NS_PER_S, *reason)

    image = np.array(["i0", "i1", "i2", "i3"], object)
    time_ns = (begin_s + np.arange(0, 40, 10)) * NS_PER_S
    stations = replace(empty_stations(image, image, "ok"), time_ns=time_ns)
    stretches = (
        stretch(9, 11, "attitude", "tilt", np.nan),
        stretch(9, 21, "position", "a step", 77.0),
        stretch(29, 31, "position", "lost", 40.0, "GPS[1]"),
    )
    flagged, notes = flag_suspect(stations, stretches, use_suspect=use)
    assert flagged.status.tolist() == ["ok", "suspect", "suspect", "ok"]
    assert flagged.ok.tolist() == [True, use, use, True]
    assert flagged.suspect_reason.tolist() == ["", "tilt; a step", "a step", ""]
    np.testing.assert_array_equal(flagged.suspect_m, [np.nan, 77.0, 77.0, np.nan])
    assert counted(notes) == [
        ("loss", "STATIONS-SUSPECT", 1),
        ("loss", "STATIONS-SUSPECT", 2),
        ("fallback", "STATIONS-STAND-IN", 1),
    ]
    assert [note.where for note in notes] == ["attitude", "position", "position"]
    assert "the first i1: position is suspect, up to 77 m off: a step" in notes[1].what
    assert "2023-11-14T22:13:29 to 2023-11-14T22:13:41 UTC" in notes[1].what


def long_flight(change_pa: Error, inversion_k: float = 0.0):
    """Ten minutes of climb by 1.5 km, then three hours level.

    The air has 280 K below and an inversion above 500 m; weather changes its pressure with time.
    """
    t = np.arange(0.0, 600.0 + 3 * 3600.0, 2.0)
    height_m = 600.0 + 2.5 * np.minimum(t, 600.0)
    noise = np.random.default_rng(4).normal(0.0, [[3.0], [0.05]], (2, t.size))
    layers_m = np.arange(0.0, 2200.0)
    corners_k = [280.0, 276.0, 276.0 + inversion_k, 274.0]
    kelvin = np.interp(layers_m, [0.0, 1000.0, 1100.0, 2200.0], corners_k)
    log_p = np.log(101_325.0) - np.cumsum(9.80665 / 287.05 / kelvin)
    pressure_pa = np.exp(np.interp(height_m, layers_m, log_p)) + change_pa(t / 3600.0)
    pressure = channel("BARO[0]", t, "pressure", pressure_pa=pressure_pa + noise[0])
    gps = channel(
        "GPS[0]",
        t,
        "height",
        "position",
        lat_rad=LATITUDE,
        lon_rad=SPEED_M_S * t / EARTH_M,
        h_msl_m=height_m + noise[1],
        **VELOCITY | {"v_down_m_s": -np.gradient(height_m, t)},
    )
    return [gps, pressure], {"position": gps, "height": gps, "pressure": pressure}


@pytest.mark.parametrize("inversion_k", [0.0, 9.0])
@pytest.mark.parametrize("pascals", [-200.0, 200.0])
@pytest.mark.parametrize("memory_h", [0.4, 3.0])
def test_weather_in_hours_of_level_flight_leaves_the_climb(pascals, memory_h, inversion_k):
    """2 hPa in three hours, soon or late, must not make a drift of the climb."""
    channels, roles = long_flight(lambda hours: pascals * -np.expm1(-hours / memory_h), inversion_k)
    examined, stretches, notes = examine(channels, roles)
    assert stretches == ()
    assert notes == ()
    assert len(examined["pressure"]) == len(channels[1])


def test_a_barometer_that_drifts_faster_than_weather_is_noticed_in_a_long_flight():
    """60 m in ten minutes, two hours after the climb."""
    channels, roles = long_flight(drift([1.5, 1.65, 1.8, 1.95], [0.0, 600.0, 600.0, 0.0]))
    examined, stretches, notes = examine(channels, roles)
    assert stretches == ()
    assert [note.code for note in notes] == ["BARO-DRIFT"]
    removed_h = examined["pressure"].removed.time_ns / NS_PER_S / 3600.0
    assert 1.5 < removed_h.min() < removed_h.max() < 2.0
