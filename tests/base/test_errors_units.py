"""Exit codes, texts of refusals, and constants against their definitions."""

from __future__ import annotations

import math
import pickle
from datetime import UTC, datetime

import pytest

from unbend import errors, exit_codes, units


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("ConfigError", 2),
        ("LogError", 6),
        ("InputError", 6),
        ("MissionError", 6),
        ("PhysicsError", 2),
        ("OutputInUseError", 4),
        ("StorageError", 5),
    ],
)
def test_exit_codes(name, code):
    error = getattr(errors, name)("A-B", "what", where="there", remedy="do")
    assert error.exit_code == code
    assert isinstance(error, errors.UnbendError)
    assert str(error) == "A-B: what\n  where: there\n  to do: do"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_the_other_exit_codes():
    assert (exit_codes.EXIT_DONE, exit_codes.EXIT_BUG, exit_codes.EXIT_LOSSES) == (0, 1, 3)
    assert (exit_codes.EXIT_INTERRUPTED, exit_codes.EXIT_TERMINATED) == (130, 143)
    assert str(errors.LogError("A-B", "what")) == "A-B: what"


def test_units_by_their_definitions():
    assert pytest.approx(units.DEGREE) == units.ARCSEC * 3600.0
    assert pytest.approx(math.radians(1.0)) == units.DEGREE
    assert (units.MICRORADIAN, units.HECTOPASCAL, units.ZERO_CELSIUS_K) == (1e-6, 100.0, 273.15)
    epoch = datetime(1980, 1, 6, tzinfo=UTC).timestamp()
    assert epoch * 1e9 == units.UNIX_NS_OF_GPS_EPOCH
    # US 1976: 34.163195 K/km'; 1 - 18.015 / 28.964; NIMA TR8350.2: the semi-minor axis
    assert pytest.approx(0.034163195, rel=1e-7) == units.HYDROSTATIC_CONSTANT
    assert pytest.approx(1.0 - 18.015 / 28.9644, abs=5e-4) == units.VAPOUR_DEFICIT
    assert pytest.approx(6_356_752.3142, abs=1e-4) == units.WGS84_A * (1.0 - units.WGS84_F)
