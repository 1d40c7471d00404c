"""How the use of a source is written for a person."""

from unbend.atmosphere.estimate.candidates import SourceUse
from unbend.atmosphere.estimate.normal_equations import Fit

FIT = Fit("IMET[0]", "temperature", 41, 1.234, 2.345, 7.891)


def test_a_sentence_names_the_inflation_only_where_there_is_one():
    assert SourceUse("IMET[0]", fit=FIT).sentence() == (
        "IMET[0]: temperature, 41 bins or levels that fit to 1.2 sigma, sigma inflation factor "
        "2.3, 7.9 degrees of freedom for signal"
    )
    plain = SourceUse("IMET[0]", fit=Fit("IMET[0]", "temperature", 41, 1.0, 1.0, 7.891))
    assert "inflation" not in plain.sentence()
    assert SourceUse("us1976").sentence() == "us1976: used"
