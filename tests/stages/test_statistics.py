"""How large corrections are, from counts in bins."""

import numpy as np
import pytest

from unbend.refraction.image import COLUMNS, Corrections
from unbend.stages.distribution import Distribution
from unbend.stages.statistics import ShiftStatistics
from unbend.tables.manifest.results import ShiftField


def distribution_of(values):
    distribution = Distribution()
    distribution.add(values)
    return distribution


def test_no_quantile_is_larger_than_the_largest():
    distribution = distribution_of(np.full(100, 0.424768))
    quantile = distribution.quantile(0.95)
    assert quantile <= distribution.maximum == 0.424768
    assert quantile == pytest.approx(0.424768, rel=0.02)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_quantiles_are_those_of_the_values_to_a_bin(share):
    values = np.random.default_rng(1).lognormal(0.0, 1.0, 20_000)
    quantile = distribution_of(values).quantile(share)
    exact = np.quantile(values, share)
    assert quantile == pytest.approx(exact, rel=0.02)


def test_each_number_under_its_own_key():
    values = np.append(np.arange(1.0, 1000.0), np.nan)
    summary = distribution_of(values).summary()
    assert summary.count == 999
    assert summary.median == pytest.approx(500.0, rel=0.01)
    assert summary.p95 == pytest.approx(950.0, rel=0.01)
    assert summary.maximum == 999.0


def corrections_of(**columns):
    """Corrections of three rows with these columns, all others 0.5, of status ok."""
    values = dict.fromkeys(COLUMNS, 0.5) | columns
    arrays = {name: np.full(3, value) for name, value in values.items()}
    return Corrections(**arrays, status=np.zeros(3, np.uint8))


def test_shifts_are_averaged_where_they_are():
    """Two points in the upper right cell, one in the lower left of 14 x 10; twice."""
    x = np.array([1390.0, 1310.0, 10.0])
    y = np.array([10.0, 90.0, 990.0])
    corrections = corrections_of(
        dx_px=[1.0, 3.0, 7.0],
        dy_px=[-1.0, -2.0, 5.0],
    )
    statistics = ShiftStatistics(1400, 1000)
    statistics.add(x, y, corrections)
    twice = statistics + statistics
    assert twice.summary().field == ShiftField(
        format_px=[1400, 1000],
        columns=14,
        x_px=[1350.0, 50.0],
        y_px=[50.0, 950.0],
        dx_px=[2.0, 7.0],
        dy_px=[-1.5, 5.0],
    )
    assert twice.distributions["shift_px"].total == 6


def test_every_quantity_is_counted_in_its_own_unit():
    arcsec = np.pi / 180.0 / 3600.0
    statistics = ShiftStatistics(1400, 1000)
    corrections = corrections_of(
        dx_px=[3.0, 3.0, np.nan],
        dy_px=[4.0, 4.0, np.nan],
        shift_ground_m=0.25,
        r_c_rad=20.0 * arcsec,
        r_cc_rad=-12.0 * arcsec,
    )
    statistics.add(np.full(3, 700.0), np.full(3, 500.0), corrections)
    largest = {
        "shift_px": 5.0,
        "shift_ground_m": 0.25,
        "refraction_arcsec": 20.0,
        "window_arcsec": 12.0,
    }
    assert set(statistics.distributions) == set(largest)
    for name, distribution in statistics.distributions.items():
        summary = distribution.summary()
        assert summary.count == 2
        assert summary.maximum == largest[name]
