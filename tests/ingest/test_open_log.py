"""Opening: refusals, every real log, and what a log says about itself."""

import hashlib
import json
import os
import random

import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from tests import helpers
from tests.ingest.written_logs import DataFlashWriter
from tests.logs import LOGS, at_hand
from unbend.cli.app import app
from unbend.ingest import open_log

# Format, message totals and types: by a loop of recv_msg over the file (pymavlink 2.4.50,
# BAD_DATA left out), and by the Statistics record of the MCAP.
KNOWN = """
beastayyg_sample.bin        dataflash   24837  52
ardusub_small.BIN           dataflash    7510  39
pymavlink_test.BIN          dataflash    1731  47
flight.bin                  dataflash   77765  16
flight.tlog                 tlog        51336  10
flight.mcap                 mcap        60778  10
glitch_cleared.bin          dataflash    1537   9
gps0_lost.bin               dataflash    1910   8
hover.bin                   dataflash    1549   8
two_vehicles.tlog           tlog         1304   6
week_rollover.tlog          tlog         1287   6
host_clock.tlog             tlog         1212   5
px4_triggers.ulg            ulog         1328   5
sitl_survey.BIN             dataflash  564101  54
sitl_belowsea_2cam.BIN      dataflash  425135  52
ardusub_small.tlog          tlog        35912  46
pymavlink_swift_flight.tlog tlog       163851  38
sitl_survey.tlog            tlog       118791  41
sitl_belowsea_2cam.tlog     tlog        72265  41
cubs2_cub_stabilize.mcap    mcap        21258   2
"""
ROWS = {row.split()[0]: row for row in KNOWN.strip().splitlines()}
LOSSES = {
    "ardusub_small.BIN": {"LOG-DROPOUT"},
    "beastayyg_sample.bin": {"LOG-DROPOUT"},
    "sitl_survey.BIN": {"LOG-DROPOUT"},
    "pymavlink_test.BIN": {"LOG-TRUNCATED"},
    "sitl_belowsea_2cam.BIN": {"LOG-TRUNCATED", "LOG-DROPOUT"},
    "pymavlink_swift_flight.tlog": {"LOG-TRUNCATED", "LOG-LINK-LOSS", "LOG-GAP"},
}


@pytest.mark.parametrize("name", at_hand(*ROWS))
def test_every_log_opens(name):
    path = LOGS[name]
    log = open_log(path)
    form, messages, kinds = ROWS[name].split()[1:]
    assert log.format == form
    assert sum(log.messages.values()) == int(messages)
    assert len(log.messages) == int(kinds)
    assert log.bad_bytes == 0
    assert log.size_bytes == path.stat().st_size
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert list(log.messages) == sorted(log.messages)
    assert len({channel.name for channel in log.channels}) == len(log.channels)
    losses = {entry.code for entry in log.ledger if entry.kind in ("loss", "finding")}
    assert losses == LOSSES.get(name, set())
    for channel in log.channels:
        assert len(channel) > 0
        assert all(channel.fits_role(role) for role in channel.roles)
        assert log.start_ns <= channel.time_ns[0] <= channel.time_ns[-1] <= log.end_ns
    assert json.loads(json.dumps(log.to_json_dict()))["format"] == form


def refusal(path, code):
    """The refusal of a log, which names its file."""
    with helpers.refused(code) as caught:
        open_log(path)
    assert str(path) in caught.value.where
    return caught.value


RANDOM = random.Random(3).randbytes(200_000)
DATAFLASH = LOGS["hover.bin"].read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "code", "words"),
    [
        ("flight.bin", b"", "LOG-EMPTY", "0 bytes"),
        ("flight.tlog", b"", "LOG-EMPTY", "0 bytes"),
        ("flight.mcap", b"", "LOG-EMPTY", "0 bytes"),
        ("flight.csv", b"", "LOG-EMPTY", "0 bytes"),
        ("flight.bin", RANDOM, "LOG-FORMAT", ""),
        ("flight.BIN", RANDOM, "LOG-FORMAT", ""),
        ("flight.tlog", RANDOM, "LOG-FORMAT", ""),
        ("flight.mcap", RANDOM, "LOG-FORMAT", ""),
        ("flight.txt", RANDOM, "LOG-FORMAT", ""),
        ("flight.tlog", DATAFLASH, "LOG-FORMAT", "DataFlash"),
        ("flight.mcap", DATAFLASH, "LOG-FORMAT", "DataFlash"),
        ("flight.log", DATAFLASH, "LOG-FORMAT", "DataFlash"),
        ("flight", DATAFLASH, "LOG-FORMAT", "DataFlash"),
        ("flight.bin", b"ULog\x01\x12\x35" + bytes(100), "LOG-FORMAT", "ULog"),
        ("flight.bin", b"#ROSBAG V2.0\n" + bytes(100), "LOG-FORMAT", "a ROS 1 bag"),
        ("flight.bin", b"\x1f\x8b\x08" + bytes(100), "LOG-FORMAT", "compressed with gzip"),
        ("flight.bin", b"PK\x03\x04" + bytes(100), "LOG-FORMAT", "a ZIP archive"),
        ("flight.db3", b"SQLite format 3\0" + bytes(100), "LOG-FORMAT", "a ROS 2 bag in SQLite"),
    ],
    ids=lambda value: f"{len(value)} bytes" if isinstance(value, bytes) else value,
)
def test_what_is_no_log(tmp_path, name, content, code, words):
    path = tmp_path / name
    path.write_bytes(content)
    assert words in refusal(path, code).what


def test_the_refusal_of_a_table_names_the_formats_of_logs(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time,lat,lon\n1,2,3\n")
    assert ".bin" in refusal(path, "LOG-FORMAT").remedy


def test_missing_file_and_folder(tmp_path):
    assert "folder" in refusal(tmp_path, "LOG-MISSING").what
    assert "no such file" in refusal(tmp_path / "none.bin", "LOG-MISSING").what


def test_a_pipe_is_not_missing(tmp_path):
    os.mkfifo(tmp_path / "flight.bin")
    assert "pipe" in refusal(tmp_path / "flight.bin", "LOG-MISSING").what


@pytest.mark.parametrize(
    "extension",
    [".mcap", ".bin", ".tlog"],
)
def test_what_is_no_log_is_refused_before_it_is_hashed(tmp_path, monkeypatch, extension):
    hashed = []
    monkeypatch.setattr("unbend.ingest.registry.hash_file", hashed.append)
    path = tmp_path / f"flight{extension}"
    path.write_bytes(bytes(5000))
    refusal(path, "LOG-FORMAT")
    assert hashed == []


def test_a_log_without_flight_data_says_what_it_holds(tmp_path):
    writer = DataFlashWriter()
    writer.define(
        10,
        "MODE",
        "QB",
        "TimeUS,Mode",
    )
    for k in range(5):
        writer.row(
            "MODE",
            k * 10**6,
            1,
        )
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.data)
    assert "MODE" in refusal(path, "LOG-NO-MESSAGES").remedy
    log = open_log(path, needs_channels=False)
    assert log.channels == ()
    assert log.start_ns == log.end_ns == 0
    assert log.message("MODE")["Mode"].tolist() == [1] * 5
    assert CliRunner().invoke(app, ["inspect", str(path), "--type", "MODE"]).exit_code == 0


def test_unknown_channel_names_the_near_ones():
    log = open_log(LOGS["hover.bin"])
    with helpers.refused("LOG-NO-CHANNEL") as caught:
        log.channel("BARO[7]")
    assert "BARO[7]" in str(caught.value)
    assert "perhaps BARO" in caught.value.remedy
    assert "ATT" in caught.value.remedy


def test_rates_and_pandas(real_log):
    log = open_log(real_log("beastayyg_sample.bin"))
    (baro,) = [channel for channel in log.to_json_dict()["channels"] if channel["name"] == "BARO"]
    assert baro["rate_hz"] == pytest.approx(10, rel=0.02)
    frame = log.to_pandas("BARO")
    assert str(frame.index.tz) == "UTC"
    assert_array_equal(
        frame["pressure_pa"],
        log.channel("BARO")["pressure_pa"],
    )


def test_a_log_and_a_channel_say_what_they_are(flown):
    """The counts of messages are those of the summary."""
    log = open_log(flown.logs["bin"])
    text = repr(log)
    count = sum(log.messages.values())
    assert text.startswith(f"<Log {log.path.name}: dataflash, {log.duration_s:.1f} s, from 20")
    assert f"{len(log.channels)} channels, {count:,} messages of {len(log.messages)} types" in text
    assert text.endswith("0 bad bytes, 0 losses and findings>")
    assert log._repr_html_().count("<tr") == 1 + min(len(log.channels), 11)
    channel = log.channel("GPS[0]")
    assert repr(channel).startswith(f"<Channel GPS[0]: {len(channel)} samples, ")
    assert "lat_rad" in repr(channel)
