"""Clocks of a telemetry log, of which samples are kept: what they place, and how many there are."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.logs import LOGS, at_hand
from unbend.ingest import Log, open_log
from unbend.ingest.tlog.clock_samples import Sampler
from unbend.ingest.tlog.sender_clocks import NEAR_NS, WRAP_OF_US_NS, unrolled

SECOND = 10**9
START_US = 1_700_000_000_000_000


def log_of(path: Path, boot_ms: np.ndarray, received_us: np.ndarray) -> Log:
    """An attitude at each time since boot, right behind it an airspeed without a time."""
    from pymavlink.dialects.v20 import all as library

    sender = library.MAVLink(None, 1, 1)
    frames = []
    for k, (ms, us) in enumerate(zip(boot_ms.tolist(), received_us.tolist(), strict=True)):
        messages = [
            library.MAVLink_attitude_message(ms, 0.1, -0.2, 3.0, 0.0, 0.0, 0.0),
            library.MAVLink_vfr_hud_message(40.0 + k, 41.0, 90, 50, 600.0, 0.1),
        ]
        if k == 0:
            messages.insert(0, library.MAVLink_system_time_message(START_US, ms))
        for message in messages:
            frames.append(struct.pack(">Q", us) + message.pack(sender))
            sender.seq = (sender.seq + 1) % 256
    path.write_bytes(b"".join(frames))
    return open_log(path)


@pytest.mark.parametrize("seed", range(5))
def test_a_link_that_stalls_shifts_nothing_by_more_than_a_sample(tmp_path: Path, seed: int) -> None:
    """For 1.7 s nothing arrives, then lumps: by the host's clock it would be 1.6 s wrong."""
    draw = np.random.default_rng(seed)
    boot_ms = 60_000 + 20 * np.arange(1500)
    sent_us = START_US + (boot_ms - 60_000) * 1000
    received_us = sent_us + draw.integers(30_000, 38_000, boot_ms.shape)
    for begin in (400, 1000):
        held = slice(begin, begin + 100)
        lumps = 90_000 * (np.arange(100) // 30)  # thirty at a time, a pause between
        received_us[held] = received_us[begin + 85] + 300 * np.arange(100) + lumps
    received_us = np.maximum.accumulate(received_us)
    log = log_of(tmp_path / "stall.tlog", boot_ms, received_us)
    shown = log.channel("VFR_HUD")
    sent_ns = sent_us[(shown["airspeed_m_s"] - 40.0).round().astype(int)] * 1000
    assert np.abs(received_us - sent_us).max() > 1_600_000
    assert np.abs(shown.time_ns - sent_ns).max() < 60_000_000
    assert len(shown) > 1490


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("rows", [12, 25, 400])
def test_a_short_boot_is_one(tmp_path: Path, rows: int, place: int) -> None:
    begin_ms = [9_000_000, 5_000, 4_000]
    length = [400, 400, 400]
    length[place] = rows
    steady = [ms + 50 * np.arange(n) for ms, n in zip(begin_ms, length, strict=True)]
    boot_ms = np.concatenate(steady)
    log = log_of(tmp_path / "boots.tlog", boot_ms, START_US + 50_000 * np.arange(boot_ms.shape[0]))
    assert log.boots == 3
    assert np.bincount(log.message("ATTITUDE")["boot"]).tolist() == length


@pytest.mark.parametrize("rows", [1, 3])
def test_a_glitch_of_the_clock_is_no_boot(tmp_path: Path, rows: int) -> None:
    boot_ms = 60_000 + 50 * np.arange(800)
    boot_ms[300 : 300 + rows] += 86_400_000
    log = log_of(tmp_path / "glitch.tlog", boot_ms, START_US + 50_000 * np.arange(800))
    assert log.boots == 1


def test_few_samples_of_a_steady_clock_are_kept() -> None:
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
        rows["host_us"] = START_US + rows["place"] * 20_000 + 5_000 + draw.integers(0, 1000, 18_000)
        rows["source"] = 257
        sampler.take([rows[::2], rows[1::2]])
    kept = sampler.readings({1})
    assert bool(np.all(np.diff(kept["place"]) > 0))
    assert 3600 <= kept.size < 10_000
    assert not sampler.readings({1}).size


class Bus:
    """Messages of some components, an attitude of the autopilot each second, as received."""

    def __init__(self) -> None:
        from pymavlink.dialects.v20 import all as library

        self.library = library
        self.senders: dict[tuple[int, int], Any] = {}
        self.frames: list[bytes] = []

    def send(self, us: int, source: tuple[int, int], name: str, *fields: object) -> None:
        sender = self.senders.setdefault(source, self.library.MAVLink(None, *source))
        packet = getattr(self.library, f"MAVLink_{name}_message")(*fields).pack(sender)
        sender.seq = (sender.seq + 1) % 256
        self.frames.append(struct.pack(">Q", us) + packet)

    def vehicle(self, k: int, boot_ms: int, utc_us: int) -> None:
        self.send(utc_us + 200_000, (1, 1), "system_time", utc_us, boot_ms)
        self.send(utc_us + 200_000, (1, 1), "attitude", boot_ms, 0, 0, 0.01 * k, 0, 0, 0)

    def image(
        self, k: int, boot_ms: int, utc_us: int, at_us: int, q: object = (1, 0, 0, 0)
    ) -> None:
        fields = (boot_ms, utc_us, 0, 475_000_000, 80_000_000, 600_000, 30_000, q, k, 1, b"")
        self.send(at_us, (1, 100), "camera_image_captured", *fields)

    def opened(self, path: Path) -> Log:
        path.write_bytes(b"".join(self.frames))
        return open_log(path)


def entries(log: Log, code: str) -> list[Any]:
    return [entry for entry in log.ledger if entry.code == code]


def test_a_boot_whose_first_time_is_later_than_the_last(tmp_path: Path) -> None:
    bus = Bus()
    for begin_s, utc_s, rows in ((10, 0, 30), (60, 3600, 600)):
        for k in range(rows):
            bus.vehicle(k, 1000 * (begin_s + k), START_US + 10**6 * (utc_s + k))
    log = bus.opened(tmp_path / "two.tlog")
    shown = (log.channel("ATTITUDE").time_ns // 1000 - START_US) / 1e6
    np.testing.assert_array_equal(shown, [*range(30), *range(3600, 4200)])
    assert log.boots == 2
    assert [entry.kind for entry in entries(log, "TIME-REBOOT")] == ["warning"]
    assert entries(log, "LOG-GAP") == []  # the vehicle was off


def test_without_utc_the_stamps_of_the_log_tell_a_boot(tmp_path: Path) -> None:
    bus = Bus()
    for begin_s, at_s, rows in ((10, 0, 30), (60, 3600, 600)):
        for k in range(rows):
            at_us = START_US + 10**6 * (at_s + k)
            bus.send(at_us, (1, 1), "attitude", 1000 * (begin_s + k), 0, 0, 0, 0, 0, 0)
    log = bus.opened(tmp_path / "two.tlog")
    shown = (log.channel("ATTITUDE").time_ns // 1000 - START_US) / 1e6
    np.testing.assert_array_equal(shown, [*range(30), *range(3600, 4200)])
    assert log.boots == 2


@pytest.mark.parametrize(
    ("behind_ms", "own_utc_s", "expected_s", "code", "kind"),
    [
        (0, None, 0.0, "TIME-BORROWED", "note"),  # set to the autopilot's clock
        (30_000, 0.0, 0.0, None, None),  # its own clock, and UTC
        (30_000, None, 0.3, "TIME-BORROWED", "loss"),  # its own clock: when it was received
        (0, -86_400.0, 0.0, "TIME-OWN-UTC", "loss"),  # UTC of yesterday
        (30_000, -5.0, -5.0, None, None),  # received up to 10 s after the exposure
        (0, 5.0, 0.0, "TIME-OWN-UTC", "loss"),  # no message arrives before its exposure
    ],
)
def test_the_clock_of_a_camera(
    tmp_path: Path,
    behind_ms: int,
    own_utc_s: float | None,
    expected_s: float,
    code: str | None,
    kind: str | None,
) -> None:
    bus = Bus()
    for k in range(60):
        utc_us = START_US + k * 10**6
        bus.vehicle(k, 60_000 + 1000 * k, utc_us)
        own_us = 0 if own_utc_s is None else utc_us + round(own_utc_s * 1e6)
        bus.image(k, 60_000 - behind_ms + 1000 * k, own_us, utc_us + 300_000)
    log = bus.opened(tmp_path / "camera.tlog")
    shown = (log.channel("CAMERA_IMAGE_CAPTURED[0]").time_ns // 1000 - START_US) / 1e6
    # the ground station's clock is 0.2 s behind, which the clock of the vehicle takes out
    np.testing.assert_allclose(shown, np.arange(60) + expected_s, atol=0.2 if expected_s else 1e-6)
    told = {entry.code: entry.kind for entry in log.ledger if entry.code != "TIME-FIT"}
    told.pop("TIME-HOST-CLOCK", None)
    assert told == ({} if code is None else {"TIME-BORROWED": "note"} | {code: kind})


def test_no_clock_is_borrowed_from_another_system(tmp_path: Path) -> None:
    """A camera of system 2 in a log whose only clock is that of system 1, hours away."""
    bus = Bus()
    for k in range(60):
        at_us = START_US + k * 10**6
        bus.vehicle(k, 60_000 + 1000 * k, at_us + 7200 * 10**6)
        bus.frames[-2:] = [struct.pack(">Q", at_us) + frame[8:] for frame in bus.frames[-2:]]
        bus.send(at_us, (2, 1), "camera_trigger", 60_000_000 + k * 10**6, k)
    log = bus.opened(tmp_path / "two.tlog")
    trigger = next(c for c in log.channels if c.source.message == "CAMERA_TRIGGER")
    np.testing.assert_array_equal(trigger.time_ns // 1000, START_US + np.arange(60) * 10**6)
    assert [entry.where for entry in entries(log, "TIME-HOST-CLOCK")] == ["system 2, component 1"]


def test_the_first_message_of_a_boot_may_come_before_its_clock(tmp_path: Path) -> None:
    bus = Bus()
    for boot in (0, 1):
        for k in range(60):
            utc_us = START_US + (1000 * boot + k) * 10**6
            fields = (50_000_000 + k * 10**6, 3, 470_000_000, 80_000_000, 600_000, 0, 0, 0, 0, 9)
            bus.send(utc_us + 200_000, (1, 1), "gps_raw_int", *fields)
            bus.vehicle(k, 50_000 + 1000 * k, utc_us)
    log = bus.opened(tmp_path / "two.tlog")
    channel = log.channel("GPS_RAW_INT")
    shown = (channel.time_ns // 1000 - START_US) / 1e6
    np.testing.assert_array_equal(shown, [*range(60), *range(1000, 1060)])
    np.testing.assert_array_equal(channel.boot, [0] * 60 + [1] * 60)


def test_the_attitude_of_an_image(tmp_path: Path) -> None:
    bus = Bus()
    for k in range(10):
        utc_us = START_US + k * 10**6
        bus.vehicle(k, 60_000 + 1000 * k, utc_us)
        bus.image(k, 60_000 + 1000 * k, utc_us, utc_us + 300_000, (0.1, 0.2, 0.3, 0.4))
    channel = bus.opened(tmp_path / "camera.tlog").channel("CAMERA_IMAGE_CAPTURED[0]")
    for axis, value in zip("wxyz", (0.1, 0.2, 0.3, 0.4), strict=True):
        assert channel[f"camera_q_{axis}"][0] == pytest.approx(value)


def test_what_hygrometer_and_pitot_do_not_know(tmp_path: Path) -> None:
    bus = Bus()
    for k in range(10):
        utc_us = START_US + k * 10**6
        bus.vehicle(k, 60_000 + 1000 * k, utc_us)
        bus.send(utc_us, (1, 1), "hygrometer_sensor", 0, 32767 if k == 3 else 1250, 4500)
        pitot = (60_000 + 1000 * k, 700.25, 0.0, 4500, 0 if k == 3 else -1250)
        bus.send(utc_us, (1, 1), "scaled_pressure", *pitot)
    log = bus.opened(tmp_path / "air.tlog")
    for name, kelvin in (
        ("HYGROMETER_SENSOR[0]", 285.65),
        ("SCALED_PRESSURE.temperature_press_diff", 260.65),
    ):
        shown = log.channel(name)["temperature_k"]
        assert np.flatnonzero(np.isnan(shown)).tolist() == [3]
        np.testing.assert_allclose(np.delete(shown, 3), kelvin)
    assert not log.ledger.has_losses


def test_repeated_feedback_is_a_note_and_costs_nothing(tmp_path: Path) -> None:
    """Also in Unix time, which is what an autopilot without a feedback pin sends."""
    bus = Bus()
    for k in range(10):
        utc_us = START_US + k * 10**6
        bus.vehicle(k, 60_000 + 1000 * k, utc_us)
        for _ in range(3):
            fields = (utc_us, 0, 0, k, 475_000_000, 80_000_000, 600.0, 30.0, 0, 0, 0, 0, 0)
            bus.send(utc_us + 300_000, (1, 1), "camera_feedback", *fields)
    log = bus.opened(tmp_path / "shots.tlog")
    channel = log.channel("CAMERA_FEEDBACK[0]")
    np.testing.assert_array_equal(channel.time_ns // 1000, START_US + np.arange(10) * 10**6)
    assert not log.ledger.has_losses
    assert [entry.count for entry in entries(log, "EVENT-REPEAT")] == [20]
    assert [entry.kind for entry in entries(log, "EVENTS-TRIGGER-TIME")] == ["note"]


@pytest.mark.parametrize("flip", [False, True])
def test_signed_messages(tmp_path: Path, flip: bool) -> None:
    """A signature is 13 bytes behind the checksum: between two frames nothing is left over."""
    from pymavlink import mavutil

    bus = Bus()
    sender = bus.library.MAVLink(None, 1, 1)
    sender.signing.secret_key = bytes(range(32))
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = 1
    bus.senders[1, 1] = sender
    for k in range(60):
        bus.vehicle(k, 60_000 + 1000 * k, START_US + k * 10**6)
    assert all(frame[8 + 2] & 1 for frame in bus.frames)
    if flip:  # a message lost in the middle costs that one
        bus.frames[31] = bus.frames[31][:20] + bytes([bus.frames[31][20] ^ 1]) + bus.frames[31][21:]
    log = bus.opened(tmp_path / "signed.tlog")
    assert log.messages == {"ATTITUDE": 60 - flip, "SYSTEM_TIME": 60}
    assert log.bad_bytes == (len(bus.frames[31]) - 8) * flip + 8 * flip
    reader = mavutil.mavlink_connection(str(tmp_path / "signed.tlog"), dialect="all")
    theirs = 0
    while (row := reader.recv_match(type="ATTITUDE")) is not None:
        assert row.get_header().incompat_flags == 1
        theirs += 1
    reader.close()
    assert theirs == 60 - flip


@pytest.mark.parametrize("turns", [0, 1, 3])
@pytest.mark.parametrize("ahead_s", [-59, -1, 0, 1, 59])
def test_a_wrapped_stamp_is_completed_near_the_senders_clock(turns: int, ahead_s: int) -> None:
    """A count of microseconds of 32 bits wraps after 4294.967296 s."""
    assert WRAP_OF_US_NS == 4_294_967_296_000
    clock_ns = np.array([turns * WRAP_OF_US_NS + 100 * 10**9])
    stamp_ns = np.array([(100 + ahead_s) * 10**9])
    expected = stamp_ns + turns * WRAP_OF_US_NS
    np.testing.assert_array_equal(unrolled(stamp_ns, clock_ns, WRAP_OF_US_NS), expected)


def test_a_stamp_far_from_the_senders_clock_is_left() -> None:
    clock_ns = np.array([WRAP_OF_US_NS + 100 * 10**9])
    stamp_ns = np.array([100 * 10**9 + NEAR_NS + 1])
    assert unrolled(stamp_ns, clock_ns, WRAP_OF_US_NS).tolist() == stamp_ns.tolist()


REPOSITORY = Path(__file__).resolve().parents[3]


def frames_of(data: bytes) -> list[bytes]:
    """The frames of a log without damage, each with the stamp before it."""
    from unbend.ingest.tlog.frames import frame_length

    frames = []
    at = 0
    while at < len(data) and (length := frame_length(data[at : at + 400], 0)):
        frames.append(data[at : at + length])
        at += length
    return frames


@pytest.mark.parametrize("name", at_hand("flight.tlog", "sitl_belowsea_2cam.tlog"))
def test_packets_that_others_overtake_are_no_boot_and_no_loss(tmp_path: Path, name: str) -> None:
    """Half a second of packets arrives 1.4 s late, behind those that were sent after it."""
    whole = LOGS[name]
    frames = frames_of(whole.read_bytes())
    stamps = np.array([struct.unpack(">Q", frame[:8])[0] for frame in frames])
    for fraction in (0.3, 0.6):
        first = int(np.searchsorted(stamps, stamps[0] + fraction * (stamps[-1] - stamps[0])))
        last, back = (int(k) for k in np.searchsorted(stamps, stamps[first] + [500_000, 1_900_000]))
        stamp = frames[back][:8]
        moved = [stamp + frame[8:] for frame in frames[first:last]]
        frames = frames[:first] + frames[last:back] + moved + frames[back:]
    path = tmp_path / "late.tlog"
    path.write_bytes(b"".join(frames))
    log = open_log(path)
    expected = open_log(whole)
    assert log.boots == expected.boots == 1
    known = {(entry.code, entry.count) for entry in expected.ledger if entry.kind == "loss"}
    assert {(entry.code, entry.count) for entry in log.ledger if entry.kind == "loss"} == known
    assert not {entry.code for entry in log.ledger} & {"TIME-SET-BACK", "TIME-BACKWARD"}
    for channel in expected.channels:
        ours = log.channel(channel.name)
        if channel.name in ("ATTITUDE", "GLOBAL_POSITION_INT"):  # which carry their own time
            # a SYSTEM_TIME less in the median of UTC
            assert np.abs(ours.time_ns - channel.time_ns).max() < 1000
            for column in channel.columns:
                np.testing.assert_array_equal(ours[column], channel[column], column)


ROLLOVER_US = 1024 * 604_800 * 10**6
UTC_2042_US = 2_272_147_200_000_000
DAY_US = 86_400 * 10**6


def dated(
    tmp_path: Path, stated_us: int, *, host_us: int = START_US, fix: int = 0, name: str = "a.tlog"
) -> Log:
    """A minute whose SYSTEM_TIME begins at a UTC, received at the stamps of a ground station."""
    bus = Bus()
    for k in range(60):
        at_us = host_us + 10**6 * k + 200_000
        boot_ms = 10_000 + 1000 * k
        bus.send(at_us, (1, 1), "system_time", stated_us + 10**6 * k, boot_ms)
        bus.send(at_us, (1, 1), "attitude", boot_ms, 0, 0, 0.01 * k, 0, 0, 0)
        place = (475_000_000 + k, 80_000_000, 600_000)
        bus.send(at_us, (1, 1), "gps_raw_int", boot_ms * 1000, fix, *place, 80, 80, 500, 0, 12)
        feedback = (475_000_000, 80_000_000, 600.0, 100.0, 0.0, 0.0, 0.0, 24.0, 0)
        bus.send(at_us, (1, 1), "camera_feedback", stated_us + 10**6 * k, 1, 0, k, *feedback)
    return bus.opened(tmp_path / name)


def shown_s(log: Log, channel: str = "ATTITUDE") -> float:
    """When the first message of a channel was sent, after the true beginning."""
    return float(log.channel(channel).time_ns[0] // 1000 - START_US) / 1e6


@pytest.mark.parametrize("rollovers", [1, 2, -1])
def test_a_rollover_is_found_by_the_stamps_of_reception(tmp_path: Path, rollovers: int) -> None:
    log = dated(tmp_path, START_US - rollovers * ROLLOVER_US, fix=3)
    assert shown_s(log) == pytest.approx(0.0, abs=0.3)  # the receiver's delay may move all
    assert shown_s(log, "CAMERA_FEEDBACK[0]") == pytest.approx(shown_s(log), abs=1e-3)
    (entry,) = entries(log, "TIME-WEEK-ROLLOVER")
    assert "2023-11-14" in entry.what


def test_2042_of_an_autopilot_without_a_fix_is_not_believed(tmp_path: Path) -> None:
    log = dated(tmp_path, UTC_2042_US)
    assert shown_s(log) == pytest.approx(0.2, abs=1e-3)
    assert shown_s(log, "CAMERA_FEEDBACK[0]") == pytest.approx(0.2, abs=1e-3)
    assert [entry.kind for entry in entries(log, "TIME-IMPOSSIBLE")] == ["warning"]
    assert log.utc_sigma_s == 5.0


@pytest.mark.parametrize(
    ("fix", "expected_s", "codes"),
    [(0, 0.2, ["TIME-IMPOSSIBLE"]), (3, -2 * 86_400.0, ["TIME-SOURCES"])],
)
def test_a_clock_that_no_receiver_has_set_yields_to_the_ground_stations(
    tmp_path: Path, fix: int, expected_s: float, codes: list[str]
) -> None:
    log = dated(tmp_path, START_US - 2 * DAY_US, fix=fix)
    assert shown_s(log) == pytest.approx(expected_s, abs=0.3)
    said = {entry.code for entry in log.ledger}
    assert sorted(said & {"TIME-IMPOSSIBLE", "TIME-SOURCES"}) == codes


def test_two_clocks_that_nothing_checks_are_as_good_as_they_agree(tmp_path: Path) -> None:
    log = dated(tmp_path, START_US - 3600 * 10**6)
    assert shown_s(log) == pytest.approx(-3600.0, abs=0.3)
    assert log.utc_sigma_s == pytest.approx(3600.2, abs=0.1)


def test_neither_clock_has_a_date(tmp_path: Path) -> None:
    log = dated(tmp_path, UTC_2042_US, host_us=1_150_000_000_000_000)  # 2006
    assert not log.has_utc
    assert np.isnan(log.utc_sigma_s)
    assert log.to_json_dict()["start_utc"] is None
    assert entries(log, "TIME-NO-UTC")


def test_what_each_clock_is_good_for(tmp_path: Path) -> None:
    clocks = dated(tmp_path, START_US, fix=3).to_json_dict()["clocks"]
    uses = [(clock["use"], clock["utc"]) for clock in clocks]
    assert uses == [("UTC of the log", "2023-11-14"), ("compared", "2023-11-14")]
    assert clocks[0]["sigma_s"] == pytest.approx(0.15)  # by the receiver, whose delay is unknown
    assert clocks[1]["sigma_s"] == 5.0
    assert clocks[1]["apart_s"] == pytest.approx(0.2)
