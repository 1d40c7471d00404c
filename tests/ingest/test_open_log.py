"""Opening: refusals, every real log, and what a log says about itself."""

from __future__ import annotations

import hashlib
import json
import os
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.logs import LOGS, at_hand
from unbend.cli.app import app
from unbend.errors import LogError
from unbend.ingest import hash_file, open_log

# Message totals and types by a loop of recv_msg over the file (pymavlink 2.4.50, BAD_DATA left
# out) and by the Statistics record of the MCAP.
KNOWN = {
    "beastayyg_sample.bin": ("dataflash", 24_837, 52),
    "ardusub_small.BIN": ("dataflash", 7_510, 39),
    "pymavlink_test.BIN": ("dataflash", 1_731, 47),
    "flight.bin": ("dataflash", 77_765, 16),
    "flight.tlog": ("tlog", 51_336, 10),
    "flight.mcap": ("mcap", 60_778, 10),
    "glitch_cleared.bin": ("dataflash", 1_537, 9),
    "gps0_lost.bin": ("dataflash", 1_910, 8),
    "hover.bin": ("dataflash", 1_549, 8),
    "two_vehicles.tlog": ("tlog", 1_304, 6),
    "week_rollover.tlog": ("tlog", 1_287, 6),
    "host_clock.tlog": ("tlog", 1_212, 5),
    "px4_triggers.ulg": ("ulog", 1_328, 5),
    "sitl_survey.BIN": ("dataflash", 564_101, 54),
    "sitl_belowsea_2cam.BIN": ("dataflash", 425_135, 52),
    "ardusub_small.tlog": ("tlog", 35_912, 46),
    "pymavlink_swift_flight.tlog": ("tlog", 163_851, 38),
    "sitl_survey.tlog": ("tlog", 118_791, 41),
    "sitl_belowsea_2cam.tlog": ("tlog", 72_265, 41),
    "cubs2_cub_stabilize.mcap": ("mcap", 21_258, 2),
}
LOSSES = {
    "ardusub_small.BIN": {"LOG-DROPOUT"},
    "beastayyg_sample.bin": {"LOG-DROPOUT"},
    "sitl_survey.BIN": {"LOG-DROPOUT"},
    "pymavlink_test.BIN": {"LOG-TRUNCATED"},
    "sitl_belowsea_2cam.BIN": {"LOG-TRUNCATED", "LOG-DROPOUT"},
    "pymavlink_swift_flight.tlog": {"LOG-TRUNCATED", "LOG-LINK-LOSS", "LOG-GAP"},
}


@pytest.mark.parametrize("name", at_hand(*KNOWN))
def test_every_log_opens(name: str) -> None:
    path = LOGS[name]
    log = open_log(path)
    form, messages, kinds = KNOWN[name]
    assert (log.format, sum(log.messages.values()), len(log.messages)) == (form, messages, kinds)
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


def refused(path: Path, code: str) -> LogError:
    with pytest.raises(LogError) as caught:
        open_log(path)
    assert caught.value.code == code
    assert str(path) in caught.value.where
    assert caught.value.remedy
    return caught.value


@pytest.mark.parametrize("extension", [".bin", ".tlog", ".mcap", ".csv"])
def test_empty_file(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"flight{extension}"
    path.touch()
    assert "0 bytes" in refused(path, "LOG-EMPTY").what


def test_missing_file_and_folder(tmp_path: Path) -> None:
    refused(tmp_path / "none.bin", "LOG-MISSING")
    assert "folder" in refused(tmp_path, "LOG-MISSING").what
    assert "no such file" in refused(tmp_path / "none.bin", "LOG-MISSING").what


def test_a_pipe_is_not_missing(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "flight.bin")
    assert "pipe" in refused(tmp_path / "flight.bin", "LOG-MISSING").what


def test_what_is_no_log_is_refused_before_it_is_hashed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashed = []
    monkeypatch.setattr("unbend.ingest.registry.hash_file", hashed.append)
    for extension in (".mcap", ".bin", ".tlog"):
        path = tmp_path / f"flight{extension}"
        path.write_bytes(bytes(5000))
        refused(path, "LOG-FORMAT")
    assert hashed == []


@pytest.mark.parametrize("extension", [".bin", ".BIN", ".tlog", ".mcap", ".txt"])
def test_random_bytes(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"flight{extension}"
    path.write_bytes(random.Random(3).randbytes(200_000))
    refused(path, "LOG-FORMAT")


def test_wrong_extension(tmp_path: Path) -> None:
    content = LOGS["hover.bin"].read_bytes()
    for extension in (".tlog", ".mcap", ".log", ""):
        path = tmp_path / f"flight{extension}"
        path.write_bytes(content)
        assert "DataFlash" in refused(path, "LOG-FORMAT").what


def test_relatives_are_named(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(b"ULog\x01\x12\x35" + bytes(100))
    assert "ULog" in refused(path, "LOG-FORMAT").what


def test_a_log_without_flight_data_says_what_it_holds(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.define(10, "MODE", "QB", "TimeUS,Mode")
    for k in range(5):
        writer.row("MODE", k * 10**6, 1)
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.data)
    assert "MODE" in refused(path, "LOG-NO-MESSAGES").remedy
    log = open_log(path, needs_channels=False)
    assert (log.channels, log.start_ns, log.end_ns) == ((), 0, 0)
    assert log.message("MODE")["Mode"].tolist() == [1] * 5
    assert CliRunner().invoke(app, ["inspect", str(path), "--type", "MODE"]).exit_code == 0


def test_unknown_channel_names_the_near_ones() -> None:
    log = open_log(LOGS["flight.bin"])
    with pytest.raises(LogError, match="BARO") as caught:
        log.channel("BARO[2]")
    assert caught.value.code == "LOG-NO-CHANNEL"
    assert "perhaps BARO[" in caught.value.remedy
    assert "ATT" in caught.value.remedy


def test_gaps_rates_and_pandas(real_log: Callable[[str], Path]) -> None:
    log = open_log(real_log("beastayyg_sample.bin"))
    told = {channel["name"]: channel for channel in log.to_json_dict()["channels"]}
    gaps = told["BARO"]["gaps"]
    assert len(gaps) == 1
    assert gaps[0]["seconds"] == pytest.approx(628, abs=1)  # LOGS.md: disarmed in the middle
    assert told["BARO"]["rate_hz"] == pytest.approx(10, rel=0.02)
    frame = log.to_pandas("BARO")
    assert str(frame.index.tz) == "UTC"
    np.testing.assert_array_equal(frame["pressure_pa"], log.channel("BARO")["pressure_pa"])


def test_hash_is_that_of_the_library(tmp_path: Path) -> None:
    path = tmp_path / "blob"
    path.write_bytes(b"x" * 3_000_001)
    assert hash_file(path) == hashlib.sha256(b"x" * 3_000_001).hexdigest()


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
