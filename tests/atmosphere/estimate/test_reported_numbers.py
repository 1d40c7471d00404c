"""What the report says of sensors and sources: each number by hand, and the limits of each kind."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from unbend.atmosphere.air_samples import AirSamples, SensorSamples
from unbend.atmosphere.estimate.candidates import (
    NO_ESTIMATE,
    ExternalSources,
    UsedSamples,
    source_usage,
)
from unbend.atmosphere.estimate.sensor_checks import pressure_level, subtract_known_biases
from unbend.atmosphere.estimate.sensors import SensorCalibration, SensorFault, SensorSettings
from unbend.messages import Kind

HEIGHTS_M = np.array([500.0, 900.0, 1500.0])


def sensor(name, values):
    return SensorSamples(np.arange(3), HEIGHTS_M, np.asarray(values), name=name)


THERMOMETER = sensor("IMET[0]", [285.0, 282.5, 279.0])
BAROMETER = sensor("BARO[0]", [95_000.0, 90_500.0, 84_000.0])
GIVEN = AirSamples(THERMOMETER, BAROMETER)


def test_known_biases_are_subtracted_and_named():
    calibration = {
        SensorFault.THERMOMETER_BIAS: SensorCalibration(mean=0.5, sigma=0.1),
        SensorFault.PRESSURE_OFFSET: SensorCalibration(mean=-120.0),
        SensorFault.HYGROMETER_BIAS: SensorCalibration(mean=0.02),  # there is no hygrometer
    }
    with_calibration = SensorSettings(calibration=calibration)
    (corrected, settings), (note,) = subtract_known_biases(GIVEN, with_calibration)
    assert_allclose(corrected.temperature.value, [284.5, 282.0, 278.5])
    assert_allclose(corrected.pressure.value, [95_120.0, 90_620.0, 84_120.0])
    left = settings.calibration[SensorFault.THERMOMETER_BIAS]
    assert left == SensorCalibration(mean=0.0, sigma=0.1, subtracted=0.5)
    assert settings.calibration[SensorFault.HYGROMETER_BIAS].mean == 0.02
    assert note.where == "atmosphere.sensors"
    assert note.count == 2
    assert "IMET[0] 0.5" in note.what
    assert "BARO[0] -120" in note.what
    assert subtract_known_biases(GIVEN, SensorSettings())[1] == ()


@pytest.mark.parametrize(
    ("sigmas", "kind"),
    {
        0.0: Kind.NOTE,
        4.9: Kind.NOTE,
        -4.9: Kind.NOTE,
        5.1: Kind.WARNING,
        -9.9: Kind.WARNING,
        10.1: Kind.LOSS,
        -10.1: Kind.LOSS,
    }.items(),
)
def test_the_level_of_pressures_is_judged_at_sea_level(sigmas, kind):
    """The climatology has 1000 hPa there, with a sigma of 1 %; readings are 1, 2 and 4 hPa off."""
    at_sea_pa = 100_000.0 * math.exp(0.01 * sigmas)
    profile = SimpleNamespace(pressure=lambda h: at_sea_pa * np.exp(-np.asarray(h) / 8000.0))
    background = SimpleNamespace(
        profile=SimpleNamespace(pressure=lambda h: 100_000.0),
        spread=SimpleNamespace(pressure_ratio=0.01),
    )
    readings = np.add(profile.pressure(HEIGHTS_M), [100.0, -200.0, 400.0])
    message = pressure_level(profile, background, sensor("BARO[1]", readings), other_sources=())
    assert message.kind is kind
    assert message.where == "BARO[1]"
    assert message.count == 3
    assert message.values == pytest.approx(
        {"sigmas": abs(sigmas), "median": 2.0, "largest": 4.0, "at_sea": at_sea_pa / 100.0}
    )


def usage(used, standard, **refused):
    """Why each source is not used, "" for those that are, with two soundings of which one is."""
    flown = UsedSamples(GIVEN, GIVEN, tried=(GIVEN,), used=used, refused=refused)
    soundings = (SimpleNamespace(name="sounding A"), SimpleNamespace(name="sounding B"))
    background = SimpleNamespace(profile=SimpleNamespace(name="climate"), origin="47 N, June")
    uses = source_usage(
        flown,
        (),
        external=ExternalSources(soundings=soundings),
        unused={"sounding B": "too old"},
        background=background,
        standard=standard,
    )
    return {use.source: use.why_not for use in uses}


def test_every_source_is_named_with_why_it_is_not_used():
    used = usage(AirSamples(THERMOMETER), "us1976", pressure="it leaps")
    assert used["sounding B"] == "too old"
    assert "sounding A" not in used  # its fit says how it is used
    assert used["surface report"] == "none in the mission file"
    assert used["climate (47 N, June)"] == ""
    assert used["us1976"] == "only shown for comparison"
    assert [why for name, why in used.items() if "BARO[0]" in name] == ["it leaps"]
    assert not any("IMET[0]" in name for name in used)


def test_without_an_estimate_no_source_is_used():
    kept = usage(None, "climate")
    assert kept["sounding A"] == NO_ESTIMATE
    assert kept["climate"] == ""
    assert "us1976" not in kept
