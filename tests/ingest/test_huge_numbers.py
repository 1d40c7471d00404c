"""Numbers of a log that are larger than any measured one: no other number, no overflow."""

import re

import numpy as np

from tests.faults.extremes import extreme_log
from tests.faults.hostile import BARO_LINES, baro_lines, text_log
from tests.helpers import with_code
from unbend.ingest import open_log
from unbend.ingest.channel_builder import limited
from unbend.units import LARGEST_NUMBER

HUGE = "-1e308"
PRESSURE = r"\d{5}\.5"


def test_huge_pressures_have_the_largest_number(tmp_path):
    """A line or two of them would be left out as damaged; all are, say, of a broken driver."""
    spoilt = [re.sub(PRESSURE, HUGE, line) for line in baro_lines(30)]
    path = tmp_path / "huge.log"
    path.write_bytes(text_log([*BARO_LINES, *spoilt]))

    log = open_log(path, needs_channels=False)

    pressure_pa = log.channel("BARO[0]")["pressure_pa"]
    assert pressure_pa.tolist() == [-LARGEST_NUMBER] * 30
    log.to_json_dict()  # sums of them do not overflow


def test_what_is_huge_alone_has_the_largest_number_and_its_sign():
    usual = np.array([np.nan, np.inf, -LARGEST_NUMBER, 3.0])
    np.testing.assert_array_equal(limited(usual), usual)
    mixed = np.append(usual, [1e13, -1e13])
    expected = np.append(usual, [LARGEST_NUMBER, -LARGEST_NUMBER])
    np.testing.assert_array_equal(limited(mixed), expected)
    empty = np.empty(0)
    assert limited(empty) is empty


def test_exposures_centuries_apart_are_stray(tmp_path):
    """Their dates are impossible, and moved: beyond 64 bits there is no later time."""
    path = tmp_path / "extreme.bin"
    path.write_bytes(extreme_log(".bin", 20261129001478))
    log = open_log(path, needs_channels=False)
    assert with_code(log.ledger, "TIME-STRAY")


def test_a_log_that_spans_more_than_64_bits_of_time_is_described(tmp_path):
    """The difference of two of its times has no 64 bits."""
    path = tmp_path / "extreme.bin"
    path.write_bytes(extreme_log(".bin", 20261129003539))
    log = open_log(path, needs_channels=False)
    log.to_json_dict()
