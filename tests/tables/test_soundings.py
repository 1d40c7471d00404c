"""A radiosonde from a netCDF file with ARM's names, made here."""

import zipfile
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.arm_sounding import CELSIUS, RELEASE_S, write_arm
from unbend.messages import Ledger
from unbend.tables.soundings import read_sounding


def test_a_release_is_the_base_time_and_the_first_offset():
    sounding = read_sounding(write_arm(Path("sonde.cdf")), Ledger())

    assert sounding.time_ns == RELEASE_S * 10**9 + 12_500_000_000
    assert sounding.station == "sonde.cdf"
    assert sounding.temperature_k == pytest.approx(CELSIUS + 273.15)


def zipped(name, *members):
    path = Path(name)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for member in members:
            archive.write(member, member.name)
    return path


def test_a_station_file_as_it_is_distributed():
    plain = write_arm(Path("sonde.cdf"))
    archive = zipped("sonde.zip", plain)

    sounding = read_sounding(archive, Ledger())

    assert_array_equal(sounding.h_m, read_sounding(plain, Ledger()).h_m)


def test_an_archive_that_does_not_hold_one_file_is_refused():
    first = write_arm(Path("sonde.cdf"))
    second = write_arm(Path("other.cdf"))
    whole = zipped("two.zip", first, second)
    cut = Path("cut.zip")
    cut.write_bytes(whole.read_bytes()[:-40])
    for path in (whole, cut):
        with refused("SOUNDING-ZIP"):
            read_sounding(path, Ledger())
