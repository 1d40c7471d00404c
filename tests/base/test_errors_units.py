"""Exit codes, texts of refusals, and constants against their definitions."""

import math
import pickle
from datetime import UTC, datetime

import pytest
import yaml

from unbend import errors, exit_codes, units

EXIT_CODES = yaml.safe_load("""
- [ConfigError, 2]
- [LogError, 6]
- [InputError, 6]
- [MissionError, 6]
- [PhysicsError, 2]
- [OutputInUseError, 4]
- [StorageError, 5]
""")


@pytest.mark.parametrize(("name", "code"), EXIT_CODES)
def test_exit_codes(name, code):
    error = getattr(errors, name)("A-B", "what", where="there", remedy="do")
    assert error.exit_code == code
    assert isinstance(error, errors.UnbendError)
    assert str(error) == "A-B: what\n  where: there\n  to do: do"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_a_refused_value_of_a_scalar_call_is_a_value_error():
    assert issubclass(errors.PhysicsError, ValueError)


def test_a_refusal_without_place_and_remedy_is_one_line():
    assert str(errors.LogError("A-B", "what")) == "A-B: what"


OTHER_EXIT_CODES = yaml.safe_load("""
- [DONE, 0]
- [BUG, 1]
- [LOSSES, 3]
- [INTERRUPTED, 130]
- [TERMINATED, 143]
""")


@pytest.mark.parametrize(("name", "code"), OTHER_EXIT_CODES)
def test_the_other_exit_codes(name, code):
    assert getattr(exit_codes, f"EXIT_{name}") == code


GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("DEGREE", math.radians(1.0)),
        ("ARCSEC", math.radians(1.0) / 3600.0),
        ("MICRORADIAN", 1e-6),
        ("HECTOPASCAL", 100.0),
        ("ZERO_CELSIUS_K", 273.15),
        ("UNIX_NS_OF_GPS_EPOCH", GPS_EPOCH.timestamp() * 1e9),
    ],
)
def test_units_by_their_definitions(name, value):
    assert getattr(units, name) == pytest.approx(value, rel=1e-15)


def test_constants_of_air_and_of_the_ellipsoid():
    """US 1976: 34.163195 K/km'; molar masses; the semi-minor axis of NIMA TR8350.2."""
    assert pytest.approx(0.034163195, rel=1e-7) == units.HYDROSTATIC_CONSTANT
    assert pytest.approx(1.0 - 18.015 / 28.9644, abs=5e-4) == units.VAPOUR_DEFICIT
    assert pytest.approx(6_356_752.3142, abs=1e-4) == units.WGS84_A * (1.0 - units.WGS84_F)
