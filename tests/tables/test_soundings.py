"""A radiosonde from a netCDF file with ARM's names, made here."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.tables.arm_sounding import CELSIUS, HECTOPASCAL, RELEASE_S, VARIABLES, write_arm
from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.soundings import read_sounding


def test_levels_release_and_place():
    path = write_arm(Path("sonde.cdf"))

    sounding = read_sounding(path, Ledger())

    assert sounding.time_ns == RELEASE_S * 10**9 + 12_500_000_000
    assert sounding.station == "sonde.cdf"
    assert sounding.temperature_k == pytest.approx(CELSIUS + 273.15)
    assert sounding.pressure_pa == pytest.approx(HECTOPASCAL * 100.0)
    # Geopotential heights: 5000 m' are some 5 m more at 36.6 degrees, where g is 9.7983 m/s2.
    geometric = 5000.0 * 9.80665 / 9.7983 * (1 + 5000.0 / 6.36e6)
    assert sounding.h_m[10] == pytest.approx(geometric, abs=1)


def test_a_fill_value_is_no_reading():
    filled = CELSIUS.copy()
    filled[3] = -9999.0
    path = write_arm(Path("filled.cdf"), VARIABLES | {"tdry": filled})

    sounding = read_sounding(path, Ledger())

    assert np.nanmin(sounding.temperature_k) == pytest.approx(CELSIUS.min() + 273.15)


def test_a_missing_variable_is_refused():
    variables = dict(VARIABLES)
    variables.pop("rh")
    path = write_arm(Path("without.cdf"), variables)
    with pytest.raises(InputError, match="it has no variable rh"):
        read_sounding(path, Ledger())


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
