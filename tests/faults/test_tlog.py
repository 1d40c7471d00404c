"""Damaged telemetry logs: complete, salvaged with a ledger, or refused with a code."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tests.faults.mutate import Trial, mutated
from tests.helpers import with_code
from unbend.errors import LogError
from unbend.ingest import Log, open_log

STAMP_US = 1_700_000_000_000_000
YEAR_US = 31_536_000_000_000
BOOT_UTC_US = STAMP_US - 60_000_000
REFUSALS = {"LOG-FORMAT", "LOG-NO-MESSAGES", "LOG-EMPTY"}


def small_log(version: int, seconds: int) -> bytes:
    """A vehicle, a second barometer and a ground station, written by pymavlink's own encoder."""
    from pymavlink.dialects.v20 import all as library

    senders = {key: library.MAVLink(None, *key) for key in ((1, 1), (1, 25), (255, 190))}
    frames = []

    def send(kind: str, ms: int, source: tuple[int, int] = (1, 1), **fields: object) -> None:
        message = getattr(library, f"MAVLink_{kind}_message")(**fields)
        packet = message.pack(senders[source], force_mavlink1=version == 1)
        senders[source].seq = (senders[source].seq + 1) % 256
        frames.append(struct.pack(">Q", STAMP_US + (ms - 60_000) * 1000 + 40_000) + packet)

    for k in range(seconds * 5):
        ms = 60_000 + 200 * k
        if k % 5 == 0:
            send("system_time", ms, time_unix_usec=BOOT_UTC_US + ms * 1000, time_boot_ms=ms)
            send("system_time", ms, (255, 190), time_unix_usec=16 * 10**14, time_boot_ms=5)
            send(
                "vfr_hud",
                ms,
                airspeed=40.0,
                groundspeed=41.0,
                heading=90,
                throttle=50,
                alt=600.0,
                climb=0.1,
            )
            send(
                "camera_feedback",
                ms,
                cam_idx=0,
                img_idx=k,
                target_system=0,
                lat=470000000,
                time_usec=ms * 1000,
                lng=-1225000000,
                alt_msl=600.0,
                alt_rel=30.0,
                roll=1.0,
                pitch=2.0,
                yaw=3.0,
                foc_len=0.0,
                flags=0,
            )
        send(
            "attitude",
            ms,
            time_boot_ms=ms,
            roll=0.1,
            pitch=-0.2,
            yaw=0.01 * k,
            rollspeed=0.0,
            pitchspeed=0.0,
            yawspeed=0.0,
        )
        for source in ((1, 1), (1, 25)):
            send(
                "scaled_pressure",
                ms,
                source,
                time_boot_ms=ms,
                press_abs=700.0 + source[1],
                press_diff=0.0,
                temperature=4500,
                temperature_press_diff=0,
            )
        send(
            "gps_raw_int",
            ms,
            time_usec=ms * 1000,
            fix_type=3,
            lat=470000000 + k,
            lon=-1225000000,
            alt=600_250,
            eph=80,
            epv=90,
            vel=0,
            cog=0,
            satellites_visible=12,
            alt_ellipsoid=580_500,
            h_acc=450,
            v_acc=0,
        )
    return b"".join(frames)


@pytest.fixture(scope="module")
def logs() -> list[bytes]:
    return [small_log(2, 25), small_log(1, 25)]


@pytest.fixture(scope="module")
def trial(logs: list[bytes], tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return Trial(logs, ".tlog", open_log, tmp_path_factory.mktemp("tlog"))


def at_a_boundary(data: bytes, whole: bytes) -> bool:
    """Whether whole frames alone are missing from a log, which nothing in the file can tell."""
    return not set(frames_of(data)) - set(frames_of(whole))


def frames_of(data: bytes) -> list[bytes]:
    frames = []
    begin = 0
    while begin < len(data):
        two = data[begin + 8] == 0xFD
        end = begin + 8 + data[begin + 9] + (12 if two else 8)
        frames.append(data[begin:end])
        begin = end
    return frames


def test_mutations(trial, run_mutations, mutation_count):
    run_mutations(trial)

    assert set(trial.ends) <= {"complete", "reported", "unreported"} | REFUSALS
    assert len(trial.unreported) <= 0.01 * mutation_count, trial.unreported
    for recipe in trial.unreported:
        whole = trial.logs[recipe.file]
        data = mutated(whole, recipe.kind, recipe.seed)
        assert at_a_boundary(data, whole), recipe


def test_every_cut_of_the_first_and_last_1000_bytes(trial, run_cuts):
    ends = run_cuts(trial)

    # a log that begins or ends at a frame is whole by all that it says; there are 20 each way
    assert set(ends) <= {"reported", "unreported", "LOG-FORMAT"}
    assert ends["unreported"] <= 0.04 * ends.total() + 4


def read(path: Path, data: bytes) -> Log:
    path.write_bytes(data)
    return open_log(path)


@pytest.mark.parametrize("junk", [b"", b"\xfd\xfe" * 3000, bytes(9000), bytes(range(256)) * 40])
def test_what_is_no_log_is_refused(tmp_path, junk):
    with pytest.raises(LogError) as caught:
        read(tmp_path / "junk.tlog", junk)
    assert caught.value.code in REFUSALS


def test_a_log_that_another_log_was_sent_through(tmp_path, logs):
    """Frames inside a payload are not frames, whatever their checksum says."""
    from pymavlink.dialects.v20 import all as library

    frames = frames_of(logs[0])
    inner = frames[7]
    payload = list(inner.ljust(96, b"\0"))
    outer = library.MAVLink_data96_message(type=1, len=len(inner), data=payload)
    stamp = frames[50][:8]
    frames.insert(50, stamp + outer.pack(library.MAVLink(None, 9, 9)))

    whole = read(tmp_path / "a.tlog", logs[0])
    log = read(tmp_path / "a.tlog", b"".join(frames))

    assert dict(log.messages) == dict(whole.messages) | {"DATA96": 1}


def test_a_stray_host_stamp_is_mended_and_counted(tmp_path, logs):
    whole = read(tmp_path / "a.tlog", logs[0])
    frames = frames_of(logs[0])
    row = next(k for k, frame in enumerate(frames) if k > 60 and frame[15] == 74)
    frame = frames[row]
    (stamp_us,) = struct.unpack_from(">Q", frame)
    for years in (-1, 3):
        moved_us = stamp_us + years * YEAR_US
        frames[row] = struct.pack(">Q", moved_us) + frame[8:]
        log = read(tmp_path / "a.tlog", b"".join(frames))
        (stray,) = with_code(log.ledger, "TIME-STRAY")
        assert stray.kind == "loss"
        assert stray.count == 1
        late = log.channel("VFR_HUD").time_ns - whole.channel("VFR_HUD").time_ns
        assert abs(late).max() < 1_000_000
