"""Damaged telemetry logs: complete, salvaged with a ledger, or refused with a code."""

import struct

import pytest

from tests.faults.mutate import REFUSALS, Trial, mutated
from tests.helpers import with_code
from tests.ingest.tlog.test_log import PLACE, flight
from tests.ingest.written_logs import opened
from unbend.ingest import open_log

YEAR_US = 31_536_000_000_000
HYGROMETER = b"\x78\x32"  # the number of its message, which has no time since boot


def small_log(version):
    """A flight, and behind it the messages of a camera."""
    writer = flight(version, seconds=25)
    for number in range(25):
        ms = 85_000 + 200 * number
        writer.sent(
            "camera_feedback",
            ms,
            time_usec=1000 * ms,
            img_idx=number,
            **PLACE,
        )
    return writer.data


@pytest.fixture(scope="module")
def logs():
    return [small_log(2), small_log(1)]


@pytest.fixture(scope="module")
def trial(logs, tmp_path_factory) -> Trial:
    return Trial(
        logs,
        ".tlog",
        open_log,
        tmp_path_factory.mktemp("tlog"),
    )


def at_a_boundary(data, whole):
    """Whether whole frames alone are missing from a log, which nothing in the file can tell."""
    return not set(frames_of(data)) - set(frames_of(whole))


def frames_of(data):
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


@pytest.mark.parametrize("junk", [b"", b"\xfd\xfe" * 3000, bytes(9000), bytes(range(256)) * 40])
def test_what_is_no_log_is_refused(trial, junk):
    assert trial.examine(0, junk, "junk") in REFUSALS


def test_a_log_that_another_log_was_sent_through(tmp_path, logs):
    """Frames inside a payload are not frames, whatever their checksum says."""
    from pymavlink.dialects.v20 import all as library

    frames = frames_of(logs[0])
    inner = frames[7]
    payload = list(inner.ljust(96, b"\0"))
    outer = library.MAVLink_data96_message(
        type=1,
        len=len(inner),
        data=payload,
    )
    stamp = frames[50][:8]
    frames.insert(50, stamp + outer.pack(library.MAVLink(None, 9, 9)))

    whole = opened(tmp_path / "a.tlog", logs[0])
    log = opened(tmp_path / "a.tlog", b"".join(frames))

    assert dict(log.messages) == dict(whole.messages) | {"DATA96": 1}


def test_a_stray_host_stamp_is_mended_and_counted(tmp_path, logs):
    whole = opened(tmp_path / "a.tlog", logs[0])
    frames = frames_of(logs[0])
    row = next(k for k, frame in enumerate(frames) if k > 60 and frame[15:17] == HYGROMETER)
    frame = frames[row]
    (stamp_us,) = struct.unpack_from(">Q", frame)
    for years in (-1, 3):
        moved_us = stamp_us + years * YEAR_US
        frames[row] = struct.pack(">Q", moved_us) + frame[8:]
        log = opened(tmp_path / "a.tlog", b"".join(frames))
        (stray,) = with_code(log.ledger, "TIME-STRAY")
        assert stray.kind == "loss"
        assert stray.count == 1
        name = "HYGROMETER_SENSOR[2]"
        late = log.channel(name).time_ns - whole.channel(name).time_ns
        assert abs(late).max() < 1_000_000
