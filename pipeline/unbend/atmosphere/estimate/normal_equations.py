"""Normal equations of a step of the estimate, and how well each set of readings fits.

Readings lose weight where they do not fit, their sigmas are inflated where their scatter is larger,
and drifts are as large as they show themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from unbend.atmosphere.estimate.sensors import Readings
from unbend.atmosphere.estimate.state import AirAtKnots, Layout, Prior
from unbend.units import Array

FREEDOM = 4.0  # degrees of freedom of Student's loss: a bin 5 sigma off weighs a sixth
HUBER_STEPS = 3  # the first iterations, while residuals are still those of the background

_HUBER = 3.0  # sigmas from which their loss is linear
_DRIFT_FREEDOM = 1.0  # that the expected size of a drift weighs, against those of the flight
_EXPECTED_SQUARE = 0.786  # of a normal residual under Student's weights
_MOST_CORRELATED = 0.8  # the few bins of a flight do not determine more
_CORRELATED = 0.2  # neighbouring residuals that correlate more than this are not independent
_FEWEST_TO_INFLATE = 5  # readings of a set whose scatter says anything of their sigmas


@dataclass(frozen=True)
class Fit:
    """How a set of readings fits.

    ``count`` of bins or levels, ``rms`` residual in sigmas, and the factor by which its sigmas were
    multiplied. ``signal_freedom`` are its degrees of freedom for signal, its weight among the
    sources: the trace of its share of the information times the covariance (Rodgers 2000, Eq.
    2.80).
    """

    name: str
    quantity: str
    count: int
    rms: float
    sigma_inflation: float
    signal_freedom: float = 0.0


class SetPart(NamedTuple):
    """What a set of readings adds: its fit, its share of the normal matrix, and its weights."""

    fit: Fit
    information: Array
    weight: Array


class NormalEquations(NamedTuple):
    """Matrix and right side of a step, the inflation of the next one, and the part of each set."""

    normal: Array
    right: Array
    inflation: Array
    parts: list[SetPart]

    def change(self) -> Array:
        """How the state changes: the solution of the equations, solved for states in sigmas.

        In their units the diagonal spans 20 orders of magnitude, and the solution loses digits.
        """
        sigma = self._sigma()
        scaled = self.normal * np.outer(sigma, sigma)
        in_sigmas = linalg.solve(scaled, sigma * self.right, assume_a="pos")
        return np.asarray(sigma * in_sigmas)

    def covariance(self) -> Array:
        """The inverse of the matrix, inverted for states in sigmas too."""
        sigma = self._sigma()
        units = np.outer(sigma, sigma)
        return np.asarray(units * np.linalg.inv(self.normal * units))

    def _sigma(self) -> Array:
        """(n,) sigma of each state if the others were known."""
        return np.asarray(1.0 / np.sqrt(np.diag(self.normal)))

    def fits(self, covariance: Array) -> tuple[Fit, ...]:
        """How each set fits, with its degrees of freedom for signal under a covariance."""
        fits = []
        for part in self.parts:
            freedom = float(np.sum(covariance * part.information))
            fits.append(replace(part.fit, signal_freedom=freedom))
        return tuple(fits)


def normal_equations(
    prior: Prior,
    sets: Sequence[Readings],
    air: AirAtKnots,
    inflation: Array,
    step: int,
) -> NormalEquations:
    """The equations of a Gauss-Newton step from an air."""
    normal = prior.precision.copy()
    right = prior.precision @ (prior.mean - air.x)
    next_inflation = inflation.copy()
    parts = []
    for i, readings in enumerate(sets):
        predicted, jacobian = readings.predict(air)
        residual = readings.value - predicted
        sigma = readings.sigma * inflation[i]
        z = residual / sigma
        factor = _weight_factors(readings, z, step)
        weight = factor / sigma**2
        information = _information(jacobian, weight)
        normal += information
        right += jacobian.T @ (weight * residual)
        if readings.robust and step > HUBER_STEPS and z.size >= _FEWEST_TO_INFLATE:
            next_inflation[i] = max(1.0, inflation[i] * np.sqrt(_variance_ratio(factor, z)))
        fit = Fit(
            readings.name,
            readings.quantity,
            count=z.size,
            rms=_rms(residual / readings.sigma),
            sigma_inflation=float(next_inflation[i]),
        )
        parts.append(SetPart(fit, information, weight))
    return NormalEquations(normal, right, next_inflation, parts)


def _information(jacobian: Array, weight: Array) -> Array:
    """J^T W J: a matrix times its own transpose costs half of a product of two."""
    weighted = jacobian * np.sqrt(weight)[:, None]
    return np.asarray(weighted.T @ weighted)


def _weight_factors(readings: Readings, z: Array, step: int) -> Array:
    """(m,) factors of the weights of readings, by their residuals ``z`` in sigmas."""
    if not readings.robust:
        return np.ones(z.size)
    if step < HUBER_STEPS:
        return np.asarray(1.0 / np.maximum(1.0, np.abs(z) / _HUBER))
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + z * z))


def _variance_ratio(factor: Array, z: Array) -> float:
    """Ratio of the variance of residuals to that of their sigmas.

    Readings are in the order of their bins, so neighbours are near in time and height; a
    first-order process with correlation r has means as uncertain as (1 + r)/(1 - r) times the
    variance.
    """
    square = float(np.mean(factor * z * z)) / _EXPECTED_SQUARE
    bounded = np.sqrt(factor) * z
    products = np.sum(bounded[1:] * bounded[:-1])
    pairs = np.sum(bounded[1:] ** 2 + bounded[:-1] ** 2)
    correlation = float(2.0 * products / max(pairs, 1e-12))
    correlation = min(correlation, _MOST_CORRELATED)
    if correlation > _CORRELATED:
        square *= (1.0 + correlation) / (1.0 - correlation)
    return square


def _rms(values: Array) -> float:
    """Root of the mean square; 0 of no values."""
    if not values.size:
        return 0.0
    return float(np.sqrt(np.mean(np.square(values))))


def drift_variances(
    precision: Array,
    layout: Layout,
    x: Array,
    normal: Array,
    variance: Array,
) -> Array:
    """The variance of each drift over the expected one, by the drift d as estimated.

    Maximum of the marginal likelihood by MacKay's step (1992, Neural Comput. 4, 415, Eq. 4.8):
    (d^T P d + nu)/(gamma + nu), where P is the expected precision, gamma the degrees of freedom
    for signal of the drift, and nu those of the expectation itself.
    """
    after = np.ones(variance.size)
    factor = linalg.cho_factor(normal)
    for i, drift in enumerate(layout.drifts):
        least, most = drift.scales
        if least == most:
            continue
        _, rows = layout.drift(drift.name)
        expected = precision[rows, rows]
        columns = np.zeros((layout.size, drift.knot.size))
        columns[rows] = expected / variance[i]
        by_expectation = linalg.cho_solve(factor, columns)[rows]
        freedom = drift.knot.size - float(np.trace(by_expectation))
        square = float(x[rows] @ expected @ x[rows])
        ratio = (square + _DRIFT_FREEDOM) / (freedom + _DRIFT_FREEDOM)
        after[i] = min(max(ratio, least**2), most**2)
    return after
