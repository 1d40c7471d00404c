"""Logs whose values are at their limits: read, with losses, or refused; never a traceback."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.faults.extremes import EXTREME, extreme_log
from tests.faults.hostile import BARO_LINES, baro_lines, text_log
from unbend.errors import LogError
from unbend.ingest import Log, open_log
from unbend.units import whole_numbers

LONGEST_UNITS = 100.0  # of work, for a log of some 20 KB


def read(path: Path, data: bytes) -> Log:
    path.write_bytes(data)
    return open_log(path, needs_channels=False)


@pytest.mark.parametrize("suffix", EXTREME)
def test_values_at_their_limits(
    tmp_path: Path, mutate: ModuleType, mutation_count: int, mutation_seed: int, suffix: str
) -> None:
    limit_s = LONGEST_UNITS * mutate.work_unit_s()
    for seed in range(mutation_seed, mutation_seed + mutation_count // 25):
        print(f"extreme_log({suffix!r}, {seed})")
        with mutate.limited(limit_s):
            try:
                log = read(tmp_path / f"extreme{suffix}", extreme_log(suffix, seed))
            except LogError:
                continue
            log.to_json_dict()
            for channel in log.channels:
                channel.__post_init__()  # shapes, and time that rises
            for kind in log.message_types():
                try:
                    log.message(kind)
                except LogError:
                    continue


@pytest.mark.parametrize("time", ["-5", str(2**64), "nan", "1e400", str(-(2**63))])
def test_a_line_with_an_impossible_time_is_damaged(tmp_path: Path, time: str) -> None:
    lines = [*BARO_LINES, *baro_lines(30)]
    lines.insert(20, f"BARO, {time}, 0, 90000.5, 20.25")
    log = read(tmp_path / "time.log", text_log(lines))
    assert log.messages["BARO"] == 30
    assert [entry.code for entry in log.ledger if entry.kind == "loss"] == ["LOG-BAD-BYTES"]


def test_a_line_with_the_latest_time_is_stray(tmp_path: Path) -> None:
    lines = [*BARO_LINES, *baro_lines(30)]
    lines.insert(20, f"BARO, {2**64 - 1}, 0, 90000.5, 20.25")
    log = read(tmp_path / "time.log", text_log(lines))
    assert len(log.channel("BARO[0]")) == 30
    assert [entry.code for entry in log.ledger if entry.kind == "loss"] == ["TIME-STRAY"]


def test_whole_numbers_of_any_type() -> None:
    signalling = np.frombuffer(b"\1\0\0\0\0\0\xf0\x7f", "f8")
    assert whole_numbers(signalling, 0, 5).tolist() == [0]
    assert whole_numbers(np.array([-(2**63), 3], np.int64), -1, 5).tolist() == [-1, 3]
    assert whole_numbers(np.array([6e4, np.nan], np.float16), 0, 5).tolist() == [5, 0]
    assert whole_numbers(np.array([True]), 0, 5).tolist() == [1]
