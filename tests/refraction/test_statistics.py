"""How large corrections are, told from counts in bins."""

from __future__ import annotations

import numpy as np

from pipeline.refraction.statistics import Distribution


def test_no_quantile_is_larger_than_the_largest():
    distribution = Distribution()
    distribution.add(np.full(100, 0.424768))
    assert distribution.quantile(0.95) <= distribution.maximum == 0.424768
    assert abs(distribution.quantile(0.95) / 0.424768 - 1.0) < 0.02


def test_quantiles_are_those_of_the_values_to_a_bin():
    values = np.random.default_rng(1).lognormal(0.0, 1.0, 20_000)
    distribution = Distribution()
    distribution.add(values)
    for share in (0.1, 0.5, 0.95):
        assert abs(distribution.quantile(share) / np.quantile(values, share) - 1.0) < 0.02
