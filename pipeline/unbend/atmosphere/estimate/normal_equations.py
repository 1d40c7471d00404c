"""Normal equations of a step of the estimate, and how well each set of readings fits.

Readings that do not fit lose weight. The sigmas of a set of readings are inflated where its scatter
is larger than they are. The variance of a drift follows from the drift as estimated.
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
_DRIFT_FREEDOM = 1.0  # degrees of freedom of a drift's expected variance, its weight in the new one
_EXPECTED_SQUARE = 0.786  # mean weighted square of a normal residual under Student's weights
_MOST_CORRELATED = 0.8  # the few bins of a flight do not determine more
_CORRELATED = 0.2  # neighbouring residuals that correlate more than this are not independent
_FEWEST_TO_INFLATE = 5  # the sigmas of a set with fewer readings are not inflated


@dataclass(frozen=True)
class Fit:
    """How a set of readings fits.

    ``count``: of its bins or levels. ``rms``: residual in sigmas, before these are inflated.
    ``sigma_inflation``: the factor by which its sigmas are multiplied. ``signal_freedom``: its
    degrees of freedom for signal, the trace of its information matrix times the covariance of the
    state (Rodgers 2000, Eq. 2.80).
    """

    name: str
    quantity: str
    count: int
    rms: float
    sigma_inflation: float
    signal_freedom: float = 0.0


class SetPart(NamedTuple):
    """What a set of m readings adds to the equations.

    ``information`` (s, s): its share of the normal matrix. ``weight`` (m,): of its readings.
    """

    fit: Fit
    information: Array
    weight: Array


class NormalEquations(NamedTuple):
    """Normal equations of a step: ``normal`` (s, s) times the change of the state = ``right`` (s,).

    ``inflation``: of each set of readings, the sigma inflation factor for the next step.
    ``parts``: of each set, in the same order.
    """

    normal: Array
    right: Array
    inflation: Array
    parts: list[SetPart]

    def change(self) -> Array:
        """(s,) how the state changes in this step: the solution of the equations.

        They are solved in units of sigmas: in the units of the state the diagonal spans 20 orders
        of magnitude, and the solution would lose digits.
        """
        sigma = self._sigma()
        scaled = self.normal * np.outer(sigma, sigma)
        in_sigmas = linalg.solve(scaled, sigma * self.right, assume_a="pos")
        return np.asarray(sigma * in_sigmas)

    def covariance(self) -> Array:
        """(s, s) the inverse of the matrix, computed in units of sigmas too."""
        sigma = self._sigma()
        units = np.outer(sigma, sigma)
        return np.asarray(units * np.linalg.inv(self.normal * units))

    def _sigma(self) -> Array:
        """(s,) sigma of each number of the state if the others were known."""
        return np.asarray(1.0 / np.sqrt(np.diag(self.normal)))

    def fits(self, covariance: Array) -> tuple[Fit, ...]:
        """How each set fits, with its degrees of freedom for signal.

        ``covariance`` (s, s): of the state.
        """
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
    """The normal equations of Gauss-Newton step number ``step``, linearised at the state of an air.

    ``inflation``: the present sigma inflation factor of each set; it is not changed, the new ones
    are in the result. The first `HUBER_STEPS` steps have another loss and inflate no sigma.
    """
    normal = prior.precision.copy()
    right = prior.precision @ (prior.mean - air.x)
    next_inflation = inflation.copy()
    parts = []
    for i, readings in enumerate(sets):
        predicted, jacobian = readings.predict(air)
        residual = readings.value - predicted
        sigma = readings.sigma * inflation[i]
        z = residual / sigma
        weight_factor = _weight_factors(readings, z, step)
        weight = weight_factor / sigma**2
        information = _information(jacobian, weight)
        normal += information
        right += jacobian.T @ (weight * residual)
        if readings.robust and step > HUBER_STEPS and z.size >= _FEWEST_TO_INFLATE:
            next_inflation[i] = max(1.0, inflation[i] * np.sqrt(_variance_ratio(weight_factor, z)))
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
    """(s, s) J^T W J of a (m, s) Jacobian and weights (m,).

    Computed as A^T A, which costs half as much as the product of two different matrices.
    """
    weighted = jacobian * np.sqrt(weight)[:, None]
    return np.asarray(weighted.T @ weighted)


def _weight_factors(readings: Readings, z: Array, step: int) -> Array:
    """(m,) factors from 0 to 1 of the weights of readings, by their residuals ``z`` in sigmas.

    Huber's loss in the first steps, because it has one minimum, then Student's; 1 of a set that is
    not robust.
    """
    if not readings.robust:
        return np.ones(z.size)
    if step < HUBER_STEPS:
        return np.asarray(1.0 / np.maximum(1.0, np.abs(z) / _HUBER))
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + z * z))


def _variance_ratio(weight_factor: Array, z: Array) -> float:
    """By how much the variance of a set of readings must grow so that its residuals fit.

    ``z`` (m,): residuals in sigmas, in the order of the bins, so that neighbours are near in time
    and height. ``weight_factor`` (m,): see `_weight_factors`. Where neighbours correlate by r, the
    variance of the mean of a first-order process is (1 + r)/(1 - r) times that of independent ones.
    """
    square = float(np.mean(weight_factor * z * z)) / _EXPECTED_SQUARE
    bounded = np.sqrt(weight_factor) * z
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
    """New factors (d,) of the prior variance of each drift, by the drift as estimated.

    Maximum of the marginal likelihood by MacKay's step (1992, Neural Comput. 4, 415, Eq. 4.8):
    (d^T P d + nu)/(gamma + nu), where d is the estimated drift, P its expected precision, gamma its
    degrees of freedom for signal, and nu = 1 those of the expected variance.

    ``precision`` (s, s): of the expected prior; ``x`` (s,): state; ``normal`` (s, s): matrix of the
    step; ``variance`` (d,): the factors in that step. A drift of fixed variance keeps 1.
    """
    after = np.ones(variance.size)
    cholesky = linalg.cho_factor(normal)
    for i, drift in enumerate(layout.drifts):
        least, most = drift.scales
        if least == most:  # fixed
            continue
        _, rows = layout.drift(drift.name)
        expected = precision[rows, rows]
        prior_columns = np.zeros((layout.size, drift.knot.size))
        prior_columns[rows] = expected / variance[i]
        share_of_prior = linalg.cho_solve(cholesky, prior_columns)[rows]
        freedom = drift.knot.size - float(np.trace(share_of_prior))
        square = float(x[rows] @ expected @ x[rows])
        ratio = (square + _DRIFT_FREEDOM) / (freedom + _DRIFT_FREEDOM)
        after[i] = min(max(ratio, least**2), most**2)
    return after
