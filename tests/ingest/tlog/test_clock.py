"""Clocks of a telemetry log, of which samples are kept: what they place, and how many there are."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import with_code
from tests.ingest.written_logs import MavlinkWriter, entry_in
from unbend.ingest.tlog.clock_samples import Sampler
from unbend.ingest.tlog.sender_clocks import MAX_MISFIT_NS, WRAP_OF_US_NS, unrolled

SECOND = 10**9
SECOND_US = 10**6
DAY_US = 86_400 * SECOND_US
START_US = 1_700_000_000_000_000
PLACE = {"lat": 475_000_000, "lon": 80_000_000, "alt": 600_000}


class Bus(MavlinkWriter):
    """Messages of some components, an attitude of the autopilot each second, as received."""

    def vehicle(self, boot_ms, utc_us):
        """Received 0.2 s late, by the ground station's clock."""
        at_us = utc_us + 200_000
        self.send("system_time", at_us, time_unix_usec=utc_us, time_boot_ms=boot_ms)
        self.send(
            "attitude",
            at_us,
            time_boot_ms=boot_ms,
            yaw=1e-5 * boot_ms,
        )


def seconds(log, name="ATTITUDE"):
    """When the messages of a channel were sent, after the true beginning."""
    return (log.channel(name).time_ns // 1000 - START_US) / 1e6


def log_of(opened, boot_ms, received_us):
    """An attitude at each time since boot, right behind it an airspeed without a time."""
    writer = MavlinkWriter()
    first_ms = int(boot_ms[0])
    first_us = int(received_us[0])
    writer.send("system_time", first_us, time_unix_usec=START_US, time_boot_ms=first_ms)
    for k, (ms, us) in enumerate(zip(boot_ms.tolist(), received_us.tolist(), strict=True)):
        writer.send("attitude", us, time_boot_ms=ms)
        writer.send("vfr_hud", us, airspeed=40.0 + k)
    return opened(writer.data)


@pytest.mark.parametrize("seed", range(3))
def test_a_link_that_stalls_shifts_nothing_by_more_than_a_sample(opened, seed):
    """For 1.7 s nothing arrives, then lumps: by the host's clock it would be 1.6 s wrong."""
    draw = np.random.default_rng(seed)
    boot_ms = 60_000 + 20 * np.arange(1500)
    sent_us = START_US + (boot_ms - 60_000) * 1000
    received_us = sent_us + draw.integers(30_000, 38_000, boot_ms.shape)
    lumps_us = 90_000 * (np.arange(100) // 30)  # thirty at a time, a pause between
    for begin in (400, 1000):
        held_us = received_us[begin + 85] + 300 * np.arange(100) + lumps_us
        received_us[begin : begin + 100] = held_us
    received_us = np.maximum.accumulate(received_us)
    log = log_of(opened, boot_ms, received_us)
    airspeeds = log.channel("VFR_HUD")
    rows = (airspeeds["airspeed_m_s"] - 40.0).round().astype(int)
    assert np.abs(received_us - sent_us).max() > 1_600_000
    assert np.abs(airspeeds.time_ns - sent_us[rows] * 1000).max() < 60_000_000
    assert len(airspeeds) > 1490


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("rows", [12, 400])
def test_a_short_boot_is_one(opened, rows, place):
    lengths = [400, 400, 400]
    lengths[place] = rows
    begins_ms = [9_000_000, 5_000, 4_000]
    boots_ms = [ms + 50 * np.arange(n) for ms, n in zip(begins_ms, lengths, strict=True)]
    boot_ms = np.concatenate(boots_ms)
    log = log_of(
        opened,
        boot_ms,
        START_US + 50_000 * np.arange(boot_ms.size),
    )
    assert log.boots == 3
    assert np.bincount(log.message("ATTITUDE")["boot"]).tolist() == lengths


@pytest.mark.parametrize("rows", [[0], [5], [300], [300, 301, 302]])
def test_a_glitch_of_the_clock_is_no_boot_and_costs_its_own_rows(opened, rows):
    """Messages without a time of their own keep the vehicle's, before and after."""
    bus = Bus()
    for k in range(800):
        at_us = START_US + 50_000 * k
        boot_ms = 60_000 + 50 * k
        if k % 20 == 0:
            bus.send(
                "system_time",
                at_us,
                time_unix_usec=at_us,
                time_boot_ms=boot_ms,
            )
            bus.send("vfr_hud", at_us, airspeed=40.0)
        ahead_ms = 11 * 86_400_000 if k in rows else 0
        bus.send("attitude", at_us, time_boot_ms=boot_ms + ahead_ms)
    log = opened(bus.data)
    assert log.boots == 1
    assert len(log.channel("ATTITUDE")) == 800 - len(rows)
    loss = entry_in(log, "TIME-BACKWARD")
    assert loss.kind == "loss"
    assert loss.count == len(rows)
    assert f"first at row {rows[0]}," in loss.where
    assert_allclose(seconds(log, "VFR_HUD"), np.arange(40), atol=1e-3)


def test_few_samples_of_a_steady_clock_are_kept():
    kind = [
        ("place", "i8"),
        ("host_us", "i8"),
        ("source", "u2"),
        ("records", [("time_boot_ms", "u4")]),
    ]
    sampler = Sampler()
    draw = np.random.default_rng(1)
    for block in range(10):  # an hour at 50 Hz
        rows = np.zeros(18_000, kind)
        rows["place"] = np.arange(block * 18_000, (block + 1) * 18_000)
        rows["records"]["time_boot_ms"] = rows["place"] * 20
        delay_us = 5_000 + draw.integers(0, 1000, 18_000)
        rows["host_us"] = START_US + rows["place"] * 20_000 + delay_us
        rows["source"] = 257
        sampler.take([rows[::2], rows[1::2]])
    kept = sampler.readings({1})
    assert bool(np.all(np.diff(kept["place"]) > 0))
    assert 3600 <= kept.size < 10_000
    assert not sampler.readings({1}).size


BOOTS_S = ((10, 0, 30), (60, 3600, 600))
"""Of two boots: the first time since boot, when that was, and how many seconds it lasts."""


@pytest.mark.parametrize("has_utc", [True, False])
def test_a_boot_whose_first_time_is_later_than_the_last(opened, has_utc):
    """Without UTC the stamps of the ground station tell it."""
    bus = Bus()
    for boot_s, utc_s, rows in BOOTS_S:
        for k in range(rows):
            boot_ms = 1000 * (boot_s + k)
            utc_us = START_US + SECOND_US * (utc_s + k)
            if has_utc:
                bus.vehicle(boot_ms, utc_us)
            else:
                bus.send("attitude", utc_us, time_boot_ms=boot_ms)
    log = opened(bus.data)
    assert_array_equal(seconds(log), [*range(30), *range(3600, 4200)])
    assert log.boots == 2
    assert not log.ledger.has_losses
    assert entry_in(log, "TIME-REBOOT").kind == "warning"
    assert with_code(log.ledger, "LOG-GAP") == []  # the vehicle was off
    if not has_utc:
        fallbacks = {entry.kind for entry in with_code(log.ledger, "TIME-HOST-CLOCK")}
        assert fallbacks == {"fallback"}


@pytest.mark.parametrize(
    ("behind_ms", "own_utc_s", "expected_s", "codes"),
    [
        (0, None, 0.0, {"TIME-BORROWED": "note"}),
        (30_000, 0.0, 0.0, {}),
        (30_000, None, 0.3, {"TIME-BORROWED": "loss"}),
        (0, -86_400.0, 0.0, {"TIME-BORROWED": "note", "TIME-OWN-UTC": "loss"}),
        (30_000, -5.0, -5.0, {}),
        (0, 5.0, 0.0, {"TIME-BORROWED": "note", "TIME-OWN-UTC": "loss"}),
    ],
    ids=[
        "set to the autopilot's clock",
        "its own clock, and UTC",
        "its own clock: when it was received",
        "UTC of yesterday",
        "received up to 10 s after the exposure",
        "no message arrives before its exposure",
    ],
)
def test_the_clock_of_a_camera(opened, behind_ms, own_utc_s, expected_s, codes):
    bus = Bus()
    for k in range(60):
        boot_ms = 60_000 + 1000 * k
        utc_us = START_US + k * SECOND_US
        bus.vehicle(boot_ms, utc_us)
        bus.send(
            "camera_image_captured",
            utc_us + 300_000,
            source=(1, 100),
            time_boot_ms=boot_ms - behind_ms,
            time_utc=0 if own_utc_s is None else utc_us + round(own_utc_s * 1e6),
            image_index=k,
            capture_result=1,
            **PLACE,
        )
    log = opened(bus.data)
    # the ground station's clock is 0.2 s behind, which the clock of the vehicle takes out
    assert_allclose(
        seconds(log, "CAMERA_IMAGE_CAPTURED[0]"),
        np.arange(60) + expected_s,
        atol=0.2 if expected_s else 1e-6,
    )
    kinds = {entry.code: entry.kind for entry in log.ledger}
    for usual in ("TIME-FIT", "TIME-HOST-CLOCK"):
        kinds.pop(usual, None)
    assert kinds == codes


def test_no_clock_is_borrowed_from_another_system(opened):
    """A camera of system 2 in a log whose only clock is that of system 1, hours away."""
    bus = Bus()
    for k in range(60):
        at_us = START_US + k * SECOND_US
        boot_ms = 60_000 + 1000 * k
        utc_us = at_us + 7200 * SECOND_US
        bus.send(
            "system_time",
            at_us,
            time_unix_usec=utc_us,
            time_boot_ms=boot_ms,
        )
        bus.send("attitude", at_us, time_boot_ms=boot_ms)
        bus.send(
            "camera_trigger",
            at_us,
            source=(2, 1),
            time_usec=boot_ms * 1000,
            seq=k,
        )
    log = opened(bus.data)
    (trigger,) = [c for c in log.channels if c.source.message == "CAMERA_TRIGGER"]
    assert seconds(log, trigger.name).tolist() == [*range(60)]
    host_clock = entry_in(log, "TIME-HOST-CLOCK")
    assert host_clock.where == "system 2, component 1"


def test_the_first_message_of_a_boot_may_come_before_its_clock(opened):
    bus = Bus()
    for boot in (0, 1):
        for k in range(60):
            utc_us = START_US + (1000 * boot + k) * SECOND_US
            boot_ms = 50_000 + 1000 * k
            fix = {"time_usec": boot_ms * 1000, "fix_type": 3} | PLACE
            bus.send("gps_raw_int", utc_us + 200_000, **fix)
            bus.vehicle(boot_ms, utc_us)
    log = opened(bus.data)
    assert_array_equal(
        seconds(log, "GPS_RAW_INT"),
        [*range(60), *range(1000, 1060)],
    )
    assert_array_equal(
        log.channel("GPS_RAW_INT").boot,
        [0] * 60 + [1] * 60,
    )


def test_repeated_feedback_is_a_note_and_costs_nothing(opened):
    """Also in Unix time, which is what an autopilot without a feedback pin sends."""
    bus = Bus()
    for k in range(10):
        utc_us = START_US + k * SECOND_US
        bus.vehicle(60_000 + 1000 * k, utc_us)
        for _ in range(3):
            feedback = {"time_usec": utc_us, "img_idx": k, "lat": 475_000_000}
            bus.send("camera_feedback", utc_us + 300_000, **feedback)
    log = opened(bus.data)
    assert seconds(log, "CAMERA_FEEDBACK[0]").tolist() == [*range(10)]
    assert not log.ledger.has_losses
    assert entry_in(log, "EVENT-REPEAT").count == 20
    assert entry_in(log, "EVENTS-TRIGGER-TIME").kind == "note"


@pytest.mark.parametrize("flipped", [0, 1])
def test_signed_messages(opened, flipped):
    """A signature is 13 bytes behind the checksum: between two frames nothing is left over."""
    bus = Bus()
    sender = bus.library.MAVLink(None, 1, 1)
    sender.signing.secret_key = bytes(range(32))
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = 1
    bus.senders[1, 1] = sender
    for k in range(60):
        bus.vehicle(60_000 + 1000 * k, START_US + k * SECOND_US)
    assert all(frame[8 + 2] & 1 for frame in bus.frames)
    victim = bytearray(bus.frames[31])
    victim[20] ^= flipped  # a message lost in the middle costs that one
    bus.frames[31] = bytes(victim)
    log = opened(bus.data)
    assert log.messages == {"ATTITUDE": 60 - flipped, "SYSTEM_TIME": 60}
    assert log.bad_bytes == len(victim) * flipped


@pytest.mark.parametrize("turns", [0, 1, 3])
@pytest.mark.parametrize(
    "ahead_s",
    [-59, -1, 0, 1, 59],
)
def test_a_wrapped_stamp_is_completed_near_the_senders_clock(turns, ahead_s):
    """A count of microseconds of 32 bits wraps after 4294.967296 s."""
    assert WRAP_OF_US_NS == 4_294_967_296_000
    clock_ns = np.array([turns * WRAP_OF_US_NS + 100 * SECOND])
    stamp_ns = np.array([(100 + ahead_s) * SECOND])
    expected_ns = stamp_ns + turns * WRAP_OF_US_NS
    assert unrolled(stamp_ns, clock_ns, WRAP_OF_US_NS).tolist() == expected_ns.tolist()


def test_a_stamp_far_from_the_senders_clock_is_left():
    clock_ns = np.array([WRAP_OF_US_NS + 100 * SECOND])
    stamp_ns = np.array([100 * SECOND + MAX_MISFIT_NS + 1])
    assert unrolled(stamp_ns, clock_ns, WRAP_OF_US_NS).tolist() == stamp_ns.tolist()


def test_packets_that_others_overtake_are_no_boot_and_no_loss(opened):
    """Half a second of packets arrives 1.4 s late, behind those that were sent after it."""
    bus = Bus()
    for k in range(1200):
        utc_us = START_US + 50_000 * k
        boot_ms = 60_000 + 50 * k
        if k % 20 == 0:
            bus.vehicle(boot_ms, utc_us)
        place = PLACE | {"relative_alt": k}
        bus.send(
            "global_position_int",
            utc_us + 200_000,
            time_boot_ms=boot_ms,
            **place,
        )
    whole = opened(bus.data).channel("GLOBAL_POSITION_INT")
    for first in (400, 800):
        overtaken = bus.frames[first : first + 10]
        overtaking = bus.frames[first + 10 : first + 38]
        stamp = overtaking[-1][:8]
        late = [stamp + frame[8:] for frame in overtaken]
        bus.frames[first : first + 38] = overtaking + late
    log = opened(bus.data)
    assert log.boots == 1
    assert not {entry.kind for entry in log.ledger} & {"loss", "warning"}
    positions = log.channel("GLOBAL_POSITION_INT")
    # a SYSTEM_TIME less in the median of UTC
    assert np.abs(positions.time_ns - whole.time_ns).max() < 1000
    for name, column in whole.columns.items():
        assert_array_equal(positions[name], column, name)


ROLLOVER_US = 1024 * 604_800 * SECOND_US
UTC_2042_US = 2_272_147_200_000_000


def dated(opened, stated_us, *, host_us=START_US, fix=0):
    """A minute whose SYSTEM_TIME begins at a UTC, received at the stamps of a ground station."""
    bus = Bus()
    for k in range(60):
        at_us = host_us + SECOND_US * k + 200_000
        boot_ms = 10_000 + 1000 * k
        unix_us = stated_us + SECOND_US * k
        bus.send(
            "system_time",
            at_us,
            time_unix_usec=unix_us,
            time_boot_ms=boot_ms,
        )
        bus.send("attitude", at_us, time_boot_ms=boot_ms)
        place = PLACE | {"lat": 475_000_000 + k}
        bus.send(
            "gps_raw_int",
            at_us,
            time_usec=boot_ms * 1000,
            fix_type=fix,
            **place,
        )
        feedback = {"time_usec": unix_us, "img_idx": k, "lat": 475_000_000}
        bus.send("camera_feedback", at_us, **feedback)
    return opened(bus.data)


@pytest.mark.parametrize(
    "rollovers",
    [1, 2, -1],
)
def test_a_rollover_is_found_by_the_stamps_of_reception(opened, rollovers):
    log = dated(opened, START_US - rollovers * ROLLOVER_US, fix=3)
    begin_s = seconds(log)[0]
    assert begin_s == pytest.approx(0.0, abs=0.3)  # the receiver's delay may move all
    assert seconds(log, "CAMERA_FEEDBACK[0]")[0] == pytest.approx(begin_s, abs=1e-3)
    entry = entry_in(log, "TIME-WEEK-ROLLOVER")
    assert "2023-11-14" in entry.what


def test_2042_of_an_autopilot_without_a_fix_is_not_believed(opened):
    log = dated(opened, UTC_2042_US)
    for name in ("ATTITUDE", "CAMERA_FEEDBACK[0]"):
        assert seconds(log, name)[0] == pytest.approx(0.2, abs=1e-3)
    assert entry_in(log, "TIME-IMPOSSIBLE").kind == "warning"
    assert log.utc_sigma_s == 5.0


@pytest.mark.parametrize(
    ("fix", "expected_s", "code"),
    [(0, 0.2, "TIME-IMPOSSIBLE"), (3, -2 * 86_400.0, "TIME-SOURCES")],
)
def test_a_clock_that_no_receiver_has_set_yields_to_the_ground_stations(
    opened, fix, expected_s, code
):
    log = dated(opened, START_US - 2 * DAY_US, fix=fix)
    assert seconds(log)[0] == pytest.approx(expected_s, abs=0.3)
    codes = {entry.code for entry in log.ledger}
    assert codes & {"TIME-IMPOSSIBLE", "TIME-SOURCES"} == {code}


def test_two_clocks_that_nothing_checks_are_as_good_as_they_agree(opened):
    log = dated(opened, START_US - 3600 * SECOND_US)
    assert seconds(log)[0] == pytest.approx(-3600.0, abs=0.3)
    assert log.utc_sigma_s == pytest.approx(3600.2, abs=0.1)


def test_neither_clock_has_a_date(opened):
    log = dated(opened, UTC_2042_US, host_us=1_150_000_000_000_000)  # 2006
    assert not log.has_utc
    assert np.isnan(log.utc_sigma_s)
    assert log.to_json_dict()["start_utc"] is None
    assert with_code(log.ledger, "TIME-NO-UTC")


def test_what_each_clock_is_good_for(opened):
    vehicle, host = dated(opened, START_US, fix=3).to_json_dict()["clocks"]
    assert vehicle["use"] == "UTC of the log"
    assert host["use"] == "compared"
    assert vehicle["utc"] == host["utc"] == "2023-11-14"
    assert vehicle["sigma_s"] == pytest.approx(0.15)  # by the receiver, whose delay is unknown
    assert host["sigma_s"] == 5.0
    assert host["apart_s"] == pytest.approx(0.2)
