"""How sources and sensors of the air become records of the manifest."""

from dataclasses import asdict

from unbend.atmosphere.air_samples import SensorUse
from unbend.atmosphere.estimate.candidates import SourceUse
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.atmosphere.rejection import Reason
from unbend.stages.results import record_of_samples, record_of_source


def test_every_number_of_a_fit_has_its_own_key():
    fit = Fit("IMET[0]", "temperature", 41, 1.234, 2.345, 7.891)
    assert asdict(record_of_source(SourceUse("IMET[0]", fit=fit))) == {
        "source": "IMET[0]",
        "used": True,
        "quantity": "temperature",
        "readings": 41,
        "rms_sigma": 1.234,
        "sigma_inflation": 2.345,
        "degrees_of_freedom_for_signal": 7.891,
    }
    unused = SourceUse("barometer", "none outside in the log")
    assert asdict(record_of_source(unused)) == {
        "source": "barometer",
        "used": False,
        "why_not": "none outside in the log",
    }
    assert asdict(record_of_source(SourceUse("us1976"))) == {
        "source": "us1976",
        "used": True,
        "why_not": "",
    }


def test_samples_that_are_not_used_are_counted_by_the_reason_in_words():
    use = SensorUse("temperature", "HYGR[0]", 900, {Reason.NO_VALUE: 2})
    assert asdict(record_of_samples(use)) == {
        "sensor": "HYGR[0]",
        "quantity": "temperature",
        "samples": 900,
        "used": 898,
        "rejected": {Reason.NO_VALUE.text: 2},
    }
