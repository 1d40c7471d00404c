"""What a log says against itself: contradictions of sources of a flight made by hand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.flight.made_channels import (
    EARTH_M,
    counted,
    ends_s,
    instants,
    located,
    usable_stations,
    without_columns,
)
from tests.helpers import NS_PER_S, channel
from unbend.atmosphere.rejection import Reason
from unbend.flight.channels import Channel
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.stretches import (
    HEIGHT,
    POSITION,
    Stretch,
    flag_suspect,
    joined_stretches,
    runs,
)

SPEED_M_S = 25.0  # to the east
CLIMB_M_S = 2.0
LAG_S = 0.12  # of the receiver behind the filter
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(11.0)
PARALLEL_M = EARTH_M * np.cos(LATITUDE)
VELOCITY = {
    "v_north_m_s": 0.0,
    "v_east_m_s": SPEED_M_S,
    "v_down_m_s": -CLIMB_M_S,
}
T10 = np.arange(0.0, 300.0, 0.1)
T5 = np.arange(0.05, 299.0, 0.2)


def no_error(t):
    return np.zeros(t.shape)


def glitch(size_m):
    """An error from 100 to 120 s."""
    return lambda t: np.where((t > 100.0) & (t < 120.0), size_m, 0.0)


def drift(seconds, metres):
    return lambda t: np.interp(t, seconds, metres)


def step(begin_s, size_m):
    return lambda t: np.where(t > begin_s, size_m, 0.0)


THERE_AND_BACK = drift([100.0, 120.0, 140.0], [0.0, 40.0, 0.0])


def placed(
    name,
    t,
    *roles,
    lag_s=0.0,
    north=no_error,
    up=no_error,
    seed=1,
    **columns,
):
    """A source of a flight to the east that climbs, with 5 cm of noise."""
    noise_m = np.random.default_rng(seed).normal(0.0, 0.05, (2, t.size))
    north_noise_m, up_noise_m = noise_m
    flown_s = t - lag_s
    north_m = north(t) + north_noise_m
    return channel(
        name,
        t,
        *roles,
        lat_rad=LATITUDE + north_m / EARTH_M,
        lon_rad=LONGITUDE + SPEED_M_S * flown_s / PARALLEL_M,
        h_msl_m=600.0 + CLIMB_M_S * flown_s + up(t) + up_noise_m,
        **VELOCITY | columns,
    )


def receiver(name="GPS[0]", **changes):
    usual = {
        "lag_s": LAG_S,
        "sigma_h_m": 0.5,
        "sigma_v_m": 0.8,
        "seed": 2,
    }
    return placed(name, T5, "height", "position", **usual | changes)


def antenna(t):
    """That of the second receiver is 0.4 m to the north."""
    return np.full(t.shape, 0.4)


def second_receiver(**changes):
    usual = {"seed": 3, "north": antenna}
    return receiver("GPS[1]", **usual | changes)


def barometer(name="BARO[0]", up=no_error):
    height_m = 600.0 + CLIMB_M_S * T10 + up(T10)
    pressure_pa = 101_325.0 * np.exp(-height_m / 8434.5)
    return channel(name, T10, "pressure", pressure_pa=pressure_pa)


@dataclass(frozen=True)
class Examined:
    """What `examine` returns."""

    roles: dict[str, Channel]
    stretches: tuple[Stretch, ...]
    notes: tuple

    @property
    def replaced(self):
        """What is suspect, and by which source it is replaced."""
        return sorted((stretch.quantity, stretch.replaced_by) for stretch in self.stretches)

    def suspects(self, quantity, t):
        """(n,) at which seconds a quantity is suspect."""
        is_suspect = np.zeros(t.size, bool)
        for stretch in self.stretches:
            if stretch.quantity == quantity:
                is_suspect |= stretch.covers(instants(*t))
        return is_suspect


def examined_flight(*channels, gps=None, north=no_error):
    """A filter, a receiver that leads it away to the north, and other channels."""
    pos = placed("POS", T10, "position", north=north)
    gps = gps or receiver(north=north)
    roles = {"position": pos, "height": gps}
    if channels and channels[0].name == "BARO[0]":
        roles["pressure"] = channels[0]
    return Examined(*examine([pos, gps, *channels], roles))


def test_a_good_flight_is_not_doubted():
    examined = examined_flight(barometer(), second_receiver())
    assert examined.stretches == ()
    assert examined.notes == ()


@pytest.mark.parametrize("north_m", [12.0, 77.0])
def test_a_glitch_that_the_filter_follows_lasts_from_step_to_step(north_m):
    """The fix is wrong in height too."""
    examined = examined_flight(north=glitch(north_m))
    assert examined.replaced == [("height", "POS"), ("position", "")]
    (of_position,) = [stretch for stretch in examined.stretches if stretch.quantity == POSITION]
    assert ends_s(of_position) == pytest.approx((100.0, 120.0), abs=0.5)
    assert of_position.off_m == pytest.approx(north_m, abs=1.0)
    assert "GPS[0] steps at" in of_position.reason


def of_the_glitch(logged):
    """The rows of a channel in it, but for those at its ends."""
    seconds = logged.time_ns / NS_PER_S
    return logged.rows((seconds > 100.5) & (seconds < 119.5))


def test_a_second_receiver_that_stays_replaces_position_and_its_sigma():
    second = second_receiver(lag_s=0.2, sigma_h_m=0.9)

    examined = examined_flight(second, north=glitch(77.0))

    assert examined.replaced == [("height", "GPS[1]"), ("position", "GPS[1]")]
    position = of_the_glitch(examined.roles["position"])
    north_m = (position["lat_rad"] - LATITUDE) * EARTH_M
    east_m = (position["lon_rad"] - LONGITUDE) * PARALLEL_M
    without_lag_m = SPEED_M_S * position.time_ns / NS_PER_S
    assert north_m == pytest.approx(0.0, abs=0.3)
    assert east_m == pytest.approx(without_lag_m, abs=0.3)
    assert position["sigma_h_m"] == pytest.approx(1.0, abs=0.1)


def test_a_receiver_that_is_the_position_is_replaced_by_the_filter():
    pos = placed("POS", T10, "position")
    gps = receiver(
        north=glitch(40.0),
        up=glitch(30.0),
    )

    roles = {"position": gps, "height": gps}
    examined = Examined(*examine([pos, gps], roles))

    assert examined.replaced == [("height", "POS"), ("position", "POS")]
    height = of_the_glitch(examined.roles["height"])
    flown_m = 600.0 + CLIMB_M_S * (height.time_ns / NS_PER_S - LAG_S)
    assert height["h_msl_m"] == pytest.approx(flown_m, abs=0.5)


@pytest.mark.parametrize(
    ("lost_s", "suspect"),
    [
        (10.0, [("height", "POS"), ("position", "")]),
        (1.5, []),
    ],
)
def test_a_filter_without_fix_is_doubtful_and_a_short_loss_is_not(lost_s, suspect):
    has_fix = (T5 < 100.0) | (100.0 + lost_s < T5)
    examined = examined_flight(gps=receiver().rows(has_fix))
    assert examined.replaced == suspect
    for stretch in examined.stretches:
        assert stretch.reason == "GPS[0] has no fix for 10 s"


def test_poor_reported_accuracy_is_suspect():
    sigma_m = 0.5 + glitch(11.5)(T5)
    gps = receiver(sigma_h_m=sigma_m)
    (stretch,) = examined_flight(gps=gps).stretches
    assert stretch.quantity == POSITION
    assert "worse than 5 m" in stretch.reason


def test_a_step_without_return_makes_half_a_minute_doubtful_on_either_side():
    (stretch,) = examined_flight(north=step(200.0, 50.0)).stretches
    assert stretch.quantity == POSITION
    assert "does not return" in stretch.reason
    assert ends_s(stretch) == pytest.approx((170.0, 230.0), abs=0.2)


def test_a_second_receiver_shows_a_slow_drift_that_nothing_else_shows():
    """Who is right is not known: nothing replaces the position."""
    assert examined_flight(north=THERE_AND_BACK).stretches == ()
    examined = examined_flight(second_receiver(), north=THERE_AND_BACK)
    assert examined.replaced == [("position", "")]
    assert examined.stretches[0].off_m == pytest.approx(40.0, abs=1.5)


@pytest.mark.parametrize(
    "error",
    [
        step(60.0, 40.0),
        drift([60.0, 90.0], [0.0, 40.0]),
    ],
    ids=["step", "drift"],
)
def test_a_fault_longer_than_half_a_flight_is_seen_by_a_second_receiver(error):
    """Nothing agrees with the first receiver afterwards."""
    gps = receiver(north=error, up=error)
    examined = examined_flight(
        second_receiver(lag_s=0.2),
        gps=gps,
        north=error,
    )
    assert set(examined.replaced) == {("position", ""), ("height", "")}
    for quantity in (POSITION, HEIGHT):
        assert examined.suspects(quantity, T5[T5 > 75.0]).all()
        assert not examined.suspects(quantity, T5[T5 < 25.0]).any()


@pytest.mark.parametrize(
    ("sigma_before_m", "wrong_before"),
    [(0.8, False), (2.5, True)],
    ids=["as good", "better"],
)
def test_a_height_that_steps_for_most_of_a_flight_is_seen_by_the_barometer(
    sigma_before_m, wrong_before
):
    """A receiver that is better after its step, as it reports, was wrong before it."""
    sigma_m = np.where(T5 < 60.0, sigma_before_m, 0.8)
    gps = receiver(
        up=step(60.0, 40.0),
        sigma_v_m=sigma_m,
    )

    examined = examined_flight(barometer(), gps=gps)

    assert examined.replaced == [("height", "")]
    before = examined.suspects(HEIGHT, T5[T5 < 25.0])
    after = examined.suspects(HEIGHT, T5[T5 > 95.0])
    assert (before == wrong_before).all()
    assert (after != wrong_before).all()


WINDS_UP = drift([80.0, 105.0, 115.0, 140.0], [0.0, 40.0, 40.0, 0.0])


@pytest.mark.parametrize(
    ("spares", "gps"),
    [
        ([barometer("BARO[1]")], without_columns(receiver(), "v_down_m_s")),
        ([], receiver()),
    ],
    ids=["spare barometer", "vertical velocity"],
)
def test_a_barometer_that_winds_up_leaves_the_stations_and_its_pressure_is_not_used(spares, gps):
    wound = barometer(up=WINDS_UP)

    examined = examined_flight(wound, *spares, gps=gps)

    assert examined.stretches == ()
    assert located(examined.notes) == [("warning", "BARO-DRIFT", "BARO[0]")]
    pressure = examined.roles["pressure"]
    removed = pressure.removed
    # Of 600 in the minute, those that are off by more than the weather and an inversion make of a
    # climb, some 17 m: that limit is a little larger than the scatter of the climb alone.
    assert removed.time_ns.size > 380
    assert removed.time_ns.min() > 80 * NS_PER_S
    assert set(removed.reason) == {Reason.BAROMETER_DRIFT}
    assert len(pressure) == T10.size - removed.time_ns.size


def test_a_second_barometer_that_winds_up_is_noted_and_no_pressure_is_removed():
    examined = examined_flight(barometer(), barometer("BARO[1]", WINDS_UP))
    assert examined.stretches == ()
    assert located(examined.notes) == [("note", "BARO-DRIFT", "BARO[1]")]
    assert len(examined.roles["pressure"]) == T10.size


def test_a_height_that_contradicts_its_own_velocity_and_the_barometer_is_doubtful():
    examined = examined_flight(barometer(), gps=receiver(up=THERE_AND_BACK))
    assert ("height", "") in examined.replaced
    assert any("BARO[0]" in stretch.reason for stretch in examined.stretches)
    assert examined.notes == ()


def test_runs_need_a_seed_and_join_across_a_second():
    row = np.arange(100)
    time_ns = row * NS_PER_S // 10
    is_bad = np.isin(row, [10, 11, 12, 18, 50])
    assert runs(time_ns, is_bad, row == 11) == [(10, 18)]


def test_reasons_of_stretches_that_touch_are_joined():
    first = Stretch(0, 10, POSITION, "a", 3.0)
    second = Stretch(5, 20, POSITION, "b", np.nan)
    later = Stretch(10 * NS_PER_S, 11 * NS_PER_S, POSITION, "c")
    joined = joined_stretches([later, second, first])
    assert joined == [replace(first, end_ns=20, reason="a; b"), later]


@pytest.mark.parametrize("use", [True, False])
def test_flagged_stations_have_reason_and_distance_and_are_used_only_where_asked(use):
    begin_s = 1_700_000_000  # 2023-11-14T22:13:20

    def stretch(first_s, last_s, *reason):
        begin_ns, end_ns = instants(begin_s + first_s, begin_s + last_s).tolist()
        return Stretch(begin_ns, end_ns, *reason)

    time_ns = instants(*(begin_s + np.arange(0, 40, 10)))
    stations = usable_stations(time_ns, "i0", "i1", "i2", "i3")
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


LONG_S = np.arange(0.0, 600.0 + 3 * 3600.0, 2.0)


def examined_long_flight(change_pa, inversion_k=0.0):
    """Ten minutes of climb by 1.5 km, then three hours level.

    The air has 280 K below and an inversion above 500 m; weather changes its pressure with time.
    """
    t = LONG_S
    height_m = 600.0 + 2.5 * np.minimum(t, 600.0)
    pressure_noise_pa, height_noise_m = np.random.default_rng(4).normal(
        0.0,
        [[3.0], [0.05]],
        (2, t.size),
    )
    layers_m = np.arange(0.0, 2200.0)
    corners_k = [280.0, 276.0, 276.0 + inversion_k, 274.0]
    kelvin = np.interp(layers_m, [0.0, 1000.0, 1100.0, 2200.0], corners_k)
    log_p = np.log(101_325.0) - np.cumsum(9.80665 / 287.05 / kelvin)
    pressure_pa = np.exp(np.interp(height_m, layers_m, log_p))
    pressure_pa += change_pa(t / 3600.0) + pressure_noise_pa
    pressure = channel("BARO[0]", t, "pressure", pressure_pa=pressure_pa)
    velocity = VELOCITY | {"v_down_m_s": -np.gradient(height_m, t)}
    gps = channel(
        "GPS[0]",
        t,
        "height",
        "position",
        lat_rad=LATITUDE,
        lon_rad=SPEED_M_S * t / EARTH_M,
        h_msl_m=height_m + height_noise_m,
        **velocity,
    )
    roles = {
        "position": gps,
        "height": gps,
        "pressure": pressure,
    }
    return Examined(*examine([gps, pressure], roles))


@pytest.mark.parametrize("inversion_k", [0.0, 9.0])
@pytest.mark.parametrize("pascals", [-200.0, 200.0])
@pytest.mark.parametrize("memory_h", [0.4, 3.0])
def test_weather_in_hours_of_level_flight_leaves_the_climb(pascals, memory_h, inversion_k):
    """2 hPa in three hours, soon or late, must not make a drift of the climb."""

    def change_pa(hours):
        return pascals * -np.expm1(-hours / memory_h)

    examined = examined_long_flight(change_pa, inversion_k)

    assert examined.stretches == ()
    assert examined.notes == ()
    assert len(examined.roles["pressure"]) == LONG_S.size


def test_a_barometer_that_drifts_faster_than_weather_is_noticed_in_a_long_flight():
    """60 m in ten minutes, two hours after the climb."""
    change_pa = drift([1.5, 1.65, 1.8, 1.95], [0.0, 600.0, 600.0, 0.0])

    examined = examined_long_flight(change_pa)

    assert examined.stretches == ()
    assert [note.code for note in examined.notes] == ["BARO-DRIFT"]
    removed_h = examined.roles["pressure"].removed.time_ns / NS_PER_S / 3600.0
    assert 1.5 < removed_h.min() < removed_h.max() < 2.0


def test_a_log_of_one_attitude_has_nothing_to_contradict():
    attitude = channel("ATT", T10, "attitude", q_w=1.0, q_x=0.0, q_y=0.0, q_z=0.0)
    roles = {"attitude": attitude}

    assert examine([attitude], roles) == (roles, (), ())
