"""Logs whose values are at their limits: read, with losses, or refused; never a traceback."""

import numpy as np
import pytest

from tests.faults.extremes import EXTREME, extreme_log
from tests.faults.hostile import BARO_LINES, baro_lines, text_log
from tests.faults.mutate import limited, work_unit_s
from tests.helpers import codes_of_losses
from unbend.errors import LogError
from unbend.ingest import Log, open_log
from unbend.units import whole_numbers

LONGEST_UNITS = 100.0  # of work, for a log of some 20 KB


def read(path, data) -> Log:
    path.write_bytes(data)
    return open_log(path, needs_channels=False)


@pytest.mark.parametrize("suffix", EXTREME)
def test_values_at_their_limits(tmp_path, mutation_count, mutation_seed, suffix):
    limit_s = LONGEST_UNITS * work_unit_s()
    for seed in range(mutation_seed, mutation_seed + mutation_count // 25):
        print(f"extreme_log({suffix!r}, {seed})")
        with limited(limit_s):
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


def with_a_line_at(folder, time_us) -> Log:
    """Thirty lines of a barometer and one at this time among them."""
    lines = [*BARO_LINES, *baro_lines(30)]
    lines.insert(20, f"BARO, {time_us}, 0, 90000.5, 20.25")
    return read(folder / "time.log", text_log(lines))


@pytest.mark.parametrize("time_us", ["-5", str(2**64), "nan", "1e400", str(-(2**63))])
def test_a_line_with_an_impossible_time_is_damaged(tmp_path, time_us):
    log = with_a_line_at(tmp_path, time_us)
    assert log.messages["BARO"] == 30
    assert codes_of_losses(log.ledger) == ["LOG-BAD-BYTES"]


def test_a_line_with_the_latest_time_is_stray(tmp_path):
    log = with_a_line_at(tmp_path, str(2**64 - 1))
    assert len(log.channel("BARO[0]")) == 30
    assert codes_of_losses(log.ledger) == ["TIME-STRAY"]


SIGNALLING_NAN = np.frombuffer(b"\1\0\0\0\0\0\xf0\x7f", "f8")


@pytest.mark.parametrize(
    ("values", "least", "expected"),
    [
        (SIGNALLING_NAN, 0, [0]),
        (np.array([-(2**63), 3], np.int64), -1, [-1, 3]),
        (np.array([6e4, np.nan], np.float16), 0, [5, 0]),
        (np.array([True]), 0, [1]),
    ],
)
def test_whole_numbers_of_any_type(values, least, expected):
    assert whole_numbers(values, least, 5).tolist() == expected
