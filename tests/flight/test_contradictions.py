"""What a log says against itself: each kind of evidence on channels made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.atmosphere.rejection import Reason
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.autopilot_texts import text_evidence
from unbend.flight.evidence.contradictions import examine
from unbend.flight.evidence.filter_health import attitude_evidence, filter_evidence
from unbend.flight.evidence.source_differences import source_difference
from unbend.flight.evidence.sources import source_path, velocity_at
from unbend.flight.evidence.stretches import POSITION, Stretch, flag_suspect, merged, runs
from unbend.flight.stations import empty_stations

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
RADIUS_M = 6_371_000.0
# east and up [m/s]
SPEED = 25.0
CLIMB = 2.0
LAG_S = 0.12


def seconds(channel: Channel) -> np.ndarray:
    return (channel.time_ns - START) / SECOND


def channel(name: str, t: np.ndarray, roles: tuple[str, ...] = (), **columns) -> Channel:
    message, _, instance = name.partition("[")
    columns = {key: np.broadcast_to(np.asarray(v, float), t.shape) for key, v in columns.items()}
    return Channel(
        name,
        START + np.round(t * SECOND).astype(np.int64),
        columns,
        Source(message, instance.rstrip("]") or None),
        roles=roles,
        rank=10 if name == "POS" else 20,
    )


def placed(name: str, t: np.ndarray, roles, *, lag_s=0.0, north=0.0, up=0.0, seed=1, **columns):
    """Flying east along 47 degrees north and climbing, with 5 cm of noise."""
    rng = np.random.default_rng(seed)
    flown = t - lag_s
    lat = np.radians(47.0) + (north + rng.normal(0.0, 0.05, t.size)) / RADIUS_M
    lon = np.radians(11.0) + (SPEED * flown) / RADIUS_M / np.cos(np.radians(47.0))
    h = 600.0 + CLIMB * flown + up + rng.normal(0.0, 0.05, t.size)
    return channel(name, t, roles, lat_rad=lat, lon_rad=lon, h_msl_m=h, **columns)


T10 = np.arange(0.0, 300.0, 0.1)
T5 = np.arange(0.05, 299.0, 0.2)
INSIDE = (T5 > 100.0) & (T5 < 120.0)
GNSS = ("height", "position")
VELOCITY = {"v_north_m_s": 0.0, "v_east_m_s": SPEED, "v_down_m_s": -CLIMB}


def receiver(name: str = "GPS[0]", **changes) -> Channel:
    made = {"lag_s": LAG_S, "sigma_h_m": 0.5, "sigma_v_m": 0.8, "seed": 2} | VELOCITY | changes
    return placed(name, T5, GNSS, **made)


def barometer(name: str = "BARO[0]", up: float | np.ndarray = 0.0) -> Channel:
    h = 600.0 + CLIMB * T10 + up
    return channel(name, T10, ("pressure",), pressure_pa=101_325.0 * np.exp(-h / 8434.5))


def flight(*more: Channel, north=0.0, gps: Channel | None = None) -> tuple[list[Channel], dict]:
    pos = placed("POS", T10, ("position",), north=north, **VELOCITY)
    gps = gps or receiver()
    channels = [pos, gps, *more]
    return channels, {"position": pos, "height": gps}


def found(channels, roles):
    roles, stretches, notes = examine(channels, roles)
    return roles, [(s.quantity, s.replaced_by) for s in stretches], stretches, notes


def test_a_good_flight_is_not_doubted():
    _, what, _, notes = found(*flight(barometer(), receiver("GPS[1]", seed=3, north=0.4)))
    assert what == []
    assert notes == ()


@pytest.mark.parametrize("north_m", [12.0, 77.0])
def test_a_glitch_that_the_filter_follows_lasts_from_step_to_step(north_m):
    moved = np.where((T10 > 100.0) & (T10 < 120.0), north_m, 0.0)
    gps = receiver(north=np.where(INSIDE, north_m, 0.0))
    _, what, stretches, _ = found(*flight(north=moved, gps=gps))
    assert sorted(what) == [("height", "POS"), ("position", "")]  # the fix is wrong in height too
    stretch = next(s for s in stretches if s.quantity == "position")
    assert abs((stretch.begin_ns - START) / SECOND - 100.0) < 0.5
    assert abs((stretch.end_ns - START) / SECOND - 120.0) < 0.5
    assert stretch.off_m == pytest.approx(north_m, abs=1.0)
    assert "GPS[0] steps at" in stretch.reason


def test_a_second_receiver_that_stays_replaces_position_and_its_sigma():
    moved = np.where((T10 > 100.0) & (T10 < 120.0), 77.0, 0.0)
    gps = receiver(north=np.where(INSIDE, 77.0, 0.0))
    second = receiver("GPS[1]", seed=3, north=0.4, lag_s=0.2, sigma_h_m=0.9)
    roles, what, _, _ = found(*flight(second, north=moved, gps=gps))
    assert sorted(what) == [("height", "GPS[1]"), ("position", "GPS[1]")]
    position = roles["position"]
    inside = (seconds(position) > 100.5) & (seconds(position) < 119.5)
    assert np.diff(position.time_ns).min() > 0
    north = (position["lat_rad"] - np.radians(47.0)) * RADIUS_M
    east = (position["lon_rad"] - np.radians(11.0)) * RADIUS_M * np.cos(np.radians(47.0))
    assert np.abs(north[inside]).max() < 0.3
    assert np.abs(east - SPEED * seconds(position))[inside].max() < 0.3  # its lag is taken out
    assert (position["sigma_h_m"][inside] >= 0.9).all()
    assert (position["sigma_h_m"][inside] < 1.1).all()


def test_a_receiver_that_is_the_position_is_replaced_by_the_filter():
    channels, _ = flight(
        gps=receiver(north=np.where(INSIDE, 40.0, 0.0), up=np.where(INSIDE, 30.0, 0.0))
    )
    roles, what, _, _ = found(channels, {"position": channels[1], "height": channels[1]})
    assert sorted(what) == [("height", "POS"), ("position", "POS")]
    inside = (seconds(roles["height"]) > 100.5) & (seconds(roles["height"]) < 119.5)
    true = 600.0 + CLIMB * (seconds(roles["height"]) - LAG_S)
    assert np.abs(roles["height"]["h_msl_m"] - true)[inside].max() < 0.5


def test_a_filter_without_fix_is_doubtful_and_a_short_loss_is_not():
    gps = receiver()
    keep = (T5 < 100.0) | (T5 > 110.0)
    lost = replace(
        gps,
        time_ns=gps.time_ns[keep],
        boot=gps.boot[keep],
        columns={k: v[keep] for k, v in gps.columns.items()},
    )
    _, what, stretches, _ = found(*flight(gps=lost))
    assert sorted(what) == [("height", "POS"), ("position", "")]
    assert stretches[0].reason == "GPS[0] has no fix for 10 s"
    keep = (T5 < 100.0) | (T5 > 101.5)
    short = replace(
        gps,
        time_ns=gps.time_ns[keep],
        boot=gps.boot[keep],
        columns={k: v[keep] for k, v in gps.columns.items()},
    )
    assert found(*flight(gps=short))[1] == []


def test_poor_reported_accuracy_is_told():
    sigma = np.where(INSIDE, 12.0, 0.5)
    _, what, stretches, _ = found(*flight(gps=receiver(sigma_h_m=sigma)))
    assert what == [("position", "")]
    assert "worse than 5 m" in stretches[0].reason


def test_a_step_without_return_makes_half_a_minute_doubtful_on_either_side():
    moved10 = np.where(T10 > 200.0, 50.0, 0.0)
    moved5 = np.where(T5 > 200.0, 50.0, 0.0)
    _, what, (stretch,), _ = found(*flight(north=moved10, gps=receiver(north=moved5)))
    assert what == [("position", "")]
    assert "does not return" in stretch.reason
    assert 55.0 < (stretch.end_ns - stretch.begin_ns) / SECOND < 65.0


def test_a_second_receiver_tells_a_slow_drift_that_nothing_else_shows():
    rise = np.interp(T10, [100.0, 120.0, 140.0], [0.0, 40.0, 0.0])
    gps = receiver(north=np.interp(T5, [100.0, 120.0, 140.0], [0.0, 40.0, 0.0]))
    assert found(*flight(north=rise, gps=gps))[1] == []  # alone, nothing contradicts it
    _, what, (stretch,), _ = found(*flight(receiver("GPS[1]", seed=3), north=rise, gps=gps))
    assert what == [("position", "")]  # who is right is not known: nothing stands in
    assert stretch.off_m == pytest.approx(40.0, abs=1.5)


def lasting(t: np.ndarray, *, by_a_step: bool, size_m: float = 40.0) -> np.ndarray:
    """An error from 60 s to the end of the flight, 1.5 m/s of a drift or at once."""
    return np.where(t > 60.0, size_m, 0.0) if by_a_step else np.interp(t, [60.0, 90.0], [0, size_m])


@pytest.mark.parametrize("by_a_step", [True, False])
def test_a_fault_longer_than_half_a_flight_is_seen_by_a_second_receiver(by_a_step):
    gps = receiver(north=lasting(T5, by_a_step=by_a_step), up=lasting(T5, by_a_step=by_a_step))
    second = receiver("GPS[1]", seed=3, north=0.4, lag_s=0.2)
    _, what, stretches, _ = found(*flight(second, north=lasting(T10, by_a_step=by_a_step), gps=gps))
    assert {quantity for quantity, _ in what} == {"position", "height"}
    assert {name for _, name in what} == {""}  # nothing agrees with it afterwards
    for quantity in ("position", "height"):
        wrong = np.zeros(T5.size, bool)
        for s in stretches:
            wrong |= s.covers(gps.time_ns) & (s.quantity == quantity)
        assert wrong[T5 > 75.0].all(), quantity
        assert not wrong[T5 < 25.0].any(), quantity


@pytest.mark.parametrize("better_s", [None, 60.0])
def test_a_height_that_steps_for_most_of_a_flight_is_seen_by_the_barometer(better_s):
    """Unless the receiver is the better after its step, as it reports: then it was wrong before."""
    sigma = np.full(T5.size, 0.8) if better_s is None else np.where(better_s > T5, 2.5, 0.8)
    channels, roles = flight(
        barometer(), gps=receiver(up=lasting(T5, by_a_step=True), sigma_v_m=sigma)
    )
    roles["pressure"] = channels[2]
    _, what, stretches, _ = found(channels, roles)
    assert what == [("height", "")]
    wrong = np.zeros(T5.size, bool)
    for s in stretches:
        wrong |= s.covers(channels[1].time_ns) & (s.quantity == "height")
    before, after = (wrong[side].mean() for side in (T5 < 25.0, T5 > 95.0))
    assert (before, after) == ((0.0, 1.0) if better_s is None else (1.0, 0.0))


@pytest.mark.parametrize("spare", [True, False], ids=["spare barometer", "vertical velocity"])
def test_a_barometer_that_winds_up_leaves_the_stations_and_its_pressure_is_not_used(spare):
    up = np.interp(T10, [80.0, 105.0, 115.0, 140.0], [0.0, 40.0, 40.0, 0.0])
    wound = barometer(up=up)
    rest = [barometer("BARO[1]")] * spare
    channels, roles = flight(wound, *rest)
    roles["pressure"] = wound
    if spare:
        roles["height"] = replace(
            roles["height"],
            columns={k: v for k, v in roles["height"].columns.items() if k != "v_down_m_s"},
        )
        channels[1] = roles["height"]
    examined, what, _, notes = found(channels, roles)
    assert what == []
    assert [(e.code, e.where, e.kind) for e in notes] == [("BARO-DRIFT", "BARO[0]", "warning")]
    gone = np.setdiff1d(wound.time_ns, examined["pressure"].time_ns)
    assert ((gone - START) / SECOND > 80.0).all()
    # Of 600 in the minute, those that are off by more than the weather and an inversion make of a
    # climb, some 17 m: that limit is a little larger than the scatter of the climb alone.
    assert gone.size > 380
    removed = examined["pressure"].removed
    assert removed.time_ns.tolist() == gone.tolist()
    assert set(removed.reason.tolist()) == {Reason.BAROMETER_DRIFT}


def test_a_second_barometer_that_winds_up_is_noted_and_no_pressure_is_removed():
    up = np.interp(T10, [80.0, 105.0, 115.0, 140.0], [0.0, 40.0, 40.0, 0.0])
    channels, roles = flight(barometer(), barometer("BARO[1]", up=up))
    roles["pressure"] = channels[2]
    examined, what, _, notes = found(channels, roles)
    assert what == []
    assert [(e.code, e.where, e.kind) for e in notes] == [("BARO-DRIFT", "BARO[1]", "note")]
    assert len(examined["pressure"]) == T10.size


def test_a_height_that_contradicts_its_own_velocity_and_the_barometer_is_doubtful():
    up = np.interp(T5, [100.0, 120.0, 140.0], [0.0, 40.0, 0.0])
    channels, roles = flight(barometer(), gps=receiver(up=up))
    roles["pressure"] = channels[2]
    _, what, stretches, notes = found(channels, roles)
    assert ("height", "") in what
    assert any("BARO[0]" in s.reason for s in stretches)
    assert notes == ()


def test_innovations_last_until_the_filter_has_settled():
    ratio = np.where((T10 > 50.0) & (T10 < 60.0), 18.0, 0.1)
    ratio = np.where((T10 >= 60.0) & (T10 < 64.0), 0.8, ratio)
    health = channel("XKF4[0]", T10, innovation_position=ratio, innovation_velocity=0.2)
    (stretch,) = filter_evidence([health])
    assert stretch.reason == "the filter rejected the receiver's position (innovation ratio 18)"
    assert (stretch.quantity, round((stretch.end_ns - START) / SECOND)) == ("position", 64)
    lane = channel("XKF4[1]", T10, innovation_position=0.1, innovation_velocity=0.2)
    assert filter_evidence([health, lane]) == []  # the autopilot flies by the better lane
    blip = channel(
        "XKF4[0]", T10, innovation_position=np.where(np.arange(T10.size) == 900, 1.3, 0.1)
    )
    assert filter_evidence([blip]) == []
    velocity = channel("XKF4[0]", T10, innovation_velocity=ratio)
    assert [s.quantity for s in filter_evidence([velocity])] == ["attitude", "position"]


@pytest.mark.parametrize(("bit", "says"), [(15, "GPS glitch"), (18, "dead reckoning")])
def test_flags_of_the_filter(bit, says):
    flags = np.where((T10 > 50.0) & (T10 < 60.0), 831 + 2.0**bit, 831.0)
    (stretch,) = filter_evidence([channel("EKF_STATUS_REPORT", T10, filter_flags=flags)])
    assert says in stretch.reason
    assert stretch.quantity == "position"


def test_clipping_accelerometers_make_the_attitude_doubtful():
    count = np.cumsum(np.where((T10 > 50.0) & (T10 < 56.0), 20.0, 0.0))
    (stretch,) = filter_evidence([channel("VIBE[0]", T10, clipping=count)])
    assert stretch.quantity == "attitude"
    assert "200 times a second" in stretch.reason


def told(*lines: tuple[float, str]) -> list[Stretch]:
    t = np.array([at for at, _ in lines])
    texts = channel("MSG", t)
    return text_evidence([replace(texts, labels={"text": tuple(text for _, text in lines)})])


def test_what_the_autopilot_says_holds_until_it_says_that_it_is_over():
    position, attitude = told(
        (10.0, "Mission: 2 WP"), (50.0, "AHRS: DCM active"), (80.0, "AHRS: EKF3 active")
    )
    assert (position.quantity, attitude.quantity) == ("position", "attitude")
    assert position.reason == 'the autopilot reports "AHRS: DCM active"'
    assert [(s - START) / SECOND for s in (position.begin_ns, position.end_ns)] == [49.5, 80.0]
    (never_over,) = told((50.0, "GPS Glitch"), (90.0, "Mission: 3 WP"))
    assert (never_over.end_ns - START) / SECOND > 90.0
    switch, _ = told((50.0, "EKF3 lane switch 1"), (90.0, "Mission: 3 WP"))
    assert (switch.end_ns - switch.begin_ns) / SECOND == 5.0
    assert told((10.0, "GPS 1: detected u-blox"), (12.0, "EKF3 IMU0 is using GPS")) == []


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
    (stretch,) = told((50.0, begins), (70.0, ends), (90.0, "Mission: 3 WP"))
    assert [(s - START) / SECOND for s in (stretch.begin_ns, stretch.end_ns)] == [49.5, 70.0]
    assert told((70.0, ends)) == []


def test_another_trouble_that_ends_does_not_end_this_one():
    (glitch,) = told((50.0, "GPS Glitch"), (60.0, "EKF Failsafe Cleared"), (70.0, "Glitch cleared"))
    assert (glitch.end_ns - START) / SECOND == 70.0
    waits, _ = told((50.0, "GPS signal lost"), (51.0, "Dead reckoning until GPS regained"))
    assert (waits.end_ns - START) / SECOND > 60.0


def test_a_trouble_of_one_channel_of_texts_may_end_in_another():
    message = replace(channel("MSG", np.array([50.0])), labels={"text": ("EKF variance",)})
    error = replace(channel("ERR", np.array([65.0])), labels={"text": ("ERR EKFCHECK 0",)})
    (stretch,) = text_evidence([message, error])
    assert (stretch.end_ns - START) / SECOND == 65.0


def test_a_check_before_take_off_is_no_state_of_the_flight():
    (moment,) = told((50.0, "PreArm: GPS Glitch"), (90.0, "Mission: 3 WP"))
    assert (moment.end_ns - moment.begin_ns) / SECOND == 5.0


def attitude(name: str, t: np.ndarray, roll_deg, rank_role=("attitude",)) -> Channel:
    half = np.radians(np.broadcast_to(roll_deg, t.shape)) / 2.0
    return channel(name, t, rank_role, q_w=np.cos(half), q_x=np.sin(half), q_y=0.0, q_z=0.0)


def test_two_attitudes_that_part_and_a_slow_one_in_a_fast_roll():
    away = np.where((T10 > 50.0) & (T10 < 58.0), 7.5, 0.0)
    (stretch,) = attitude_evidence(attitude("ATT", T10, away), [attitude("XKF1[0]", T10, 0.0)])
    assert stretch.reason == "ATT and XKF1[0] are 7.5 deg apart"
    assert 7.0 < (stretch.end_ns - stretch.begin_ns) / SECOND < 9.0
    rolling = np.interp(T10, [100.0, 101.0, 110.0, 111.0], [0.0, 45.0, 45.0, 0.0])
    late = np.interp(T5 - 0.15, [100.0, 101.0, 110.0, 111.0], [0.0, 45.0, 45.0, 0.0])
    assert attitude_evidence(attitude("ATT", T10, rolling), [attitude("AHR2", T5, late)]) == []


def test_differences_know_lag_offset_and_the_date_line():
    gps = receiver(north=3.0)
    for shift in (0.0, np.radians(169.0) - SPEED * 150.0 / RADIUS_M / np.cos(np.radians(47.0))):
        moved = [
            replace(
                c,
                columns=dict(c.columns)
                | {"lon_rad": (c["lon_rad"] + shift + np.pi) % (2.0 * np.pi) - np.pi},
            )
            for c in (placed("POS", T10, ("position",), **VELOCITY), gps)
        ]
        track = source_path(moved[1], POSITION, moved)
        velocity = velocity_at(moved, POSITION, moved[1].time_ns)
        apart = source_difference(moved[0], track, POSITION, velocity)
        assert not track.step_ns.size
        assert apart.lag_s == pytest.approx(LAG_S, abs=0.005)
        assert np.nanmax(apart.off_m) < 0.5
        assert np.nanmedian(apart.apart_m, axis=0) == pytest.approx([-3.0, 0.0], abs=0.05)


def test_runs_need_a_seed_and_join_across_a_second():
    t = np.arange(100) * SECOND // 10
    bad = np.zeros(100, bool)
    bad[[10, 11, 12, 18, 50]] = True
    seed = np.zeros(100, bool)
    seed[11] = True
    assert runs(t, bad, seed) == [(10, 18)]
    assert runs(t, bad, np.zeros(100, bool)) == []


def test_reasons_of_stretches_that_touch_are_joined():
    first = Stretch(0, 10, "position", "a", 3.0)
    second = Stretch(5, 20, "position", "b", np.nan)
    later = Stretch(10 * SECOND, 11 * SECOND, "position", "c")
    joined = merged([later, second, first])
    assert [(s.end_ns, s.reason) for s in joined] == [(20, "a; b"), (11 * SECOND, "c")]
    assert joined[0].off_m == 3.0


@pytest.mark.parametrize("use", [True, False])
def test_flagged_stations_have_reason_and_distance_and_are_used_only_where_asked(use):
    image = np.array([f"i{k}" for k in range(4)], object)
    made = empty_stations(image, np.full(4, "cam", object), "ok")
    made = replace(made, time_ns=START + np.arange(4) * 10 * SECOND)
    stretches = (
        Stretch(START + 9 * SECOND, START + 11 * SECOND, "attitude", "tilt", np.nan),
        Stretch(START + 9 * SECOND, START + 21 * SECOND, "position", "a step", 77.0),
        Stretch(START + 29 * SECOND, START + 31 * SECOND, "position", "lost", 40.0, "GPS[1]"),
    )
    flagged, notes = flag_suspect(made, stretches, use_suspect=use)
    assert flagged.status.tolist() == ["ok", "suspect", "suspect", "ok"]
    assert flagged.ok.tolist() == [True, use, use, True]
    assert flagged.suspect_reason.tolist() == ["", "tilt; a step", "a step", ""]
    assert np.array_equal(flagged.suspect_m, [np.nan, 77.0, 77.0, np.nan], equal_nan=True)
    assert [(e.kind, e.code, e.count, e.where) for e in notes] == [
        ("loss", "STATIONS-SUSPECT", 1, "attitude"),
        ("loss", "STATIONS-SUSPECT", 2, "position"),
        ("fallback", "STATIONS-STAND-IN", 1, "position"),
    ]
    assert "the first i1: position is suspect, up to 77 m off: a step" in notes[1].what
    assert "2023-11-14T22:13:29 to 2023-11-14T22:13:41 UTC" in notes[1].what


def long_flight(change_pa: np.ndarray, kink_k: float = 0.0):
    """Ten minutes of climb by 1.5 km, then three hours level; pressures of air of 280 K below, and
    with an inversion of ``kink_k`` above 500 m, in weather of (n,) ``change_pa``."""
    t = np.arange(0.0, 600.0 + 3 * 3600.0, 2.0)
    h = 600.0 + 2.5 * np.minimum(t, 600.0)
    rng = np.random.default_rng(4)
    layers = np.arange(0.0, 2200.0)
    kelvin = np.interp(layers, [0.0, 1000.0, 1100.0, 2200.0], [280.0, 276.0, 276.0 + kink_k, 274.0])
    log_p = np.log(101_325.0) - np.cumsum(9.80665 / 287.05 / kelvin)
    p = np.exp(np.interp(h, layers, log_p)) + change_pa(t / 3600.0)
    pressure = channel("BARO[0]", t, ("pressure",), pressure_pa=p + rng.normal(0.0, 3.0, t.size))
    v_down = -np.gradient(h, t)
    gps = channel(
        "GPS[0]",
        t,
        GNSS,
        lat_rad=np.full(t.size, np.radians(47.0)),
        lon_rad=SPEED * t / RADIUS_M,
        h_msl_m=h + rng.normal(0.0, 0.05, t.size),
        v_north_m_s=0.0,
        v_east_m_s=SPEED,
        v_down_m_s=v_down,
    )
    return [gps, pressure], {"position": gps, "height": gps, "pressure": pressure}


@pytest.mark.parametrize("kink_k", [0.0, 9.0], ids=["smooth", "inversion"])
@pytest.mark.parametrize("pascals", [-200.0, 200.0])
@pytest.mark.parametrize("memory_h", [0.4, 3.0])
def test_weather_in_hours_of_level_flight_leaves_the_climb(pascals, memory_h, kink_k):
    """2 hPa in three hours, soon or late: the climb had been taken for a drift, and discarded."""
    channels, roles = long_flight(
        lambda hours: pascals * -np.expm1(-hours / memory_h), kink_k=kink_k
    )
    examined, what, _, notes = found(channels, roles)
    assert what == []
    assert notes == ()
    assert len(examined["pressure"]) == len(channels[1])


def test_a_barometer_that_drifts_faster_than_weather_is_noticed_in_a_long_flight():
    """60 m in ten minutes, two hours after the climb."""
    channels, roles = long_flight(
        lambda hours: np.interp(hours, [1.5, 1.65, 1.8, 1.95], [0.0, 600.0, 600.0, 0.0])
    )
    examined, what, _, notes = found(channels, roles)
    assert what == []
    assert [entry.code for entry in notes] == ["BARO-DRIFT"]
    gone = np.setdiff1d(channels[1].time_ns, examined["pressure"].time_ns)
    assert (
        1.5 < (gone.min() - START) / SECOND / 3600.0 < (gone.max() - START) / SECOND / 3600.0 < 2.0
    )
