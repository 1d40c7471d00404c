"""Temperature of the air from pressure at known heights, for a flight without a thermometer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.profile import Profile, stack_layers

Array = NDArray[np.float64]

LAYER_M = 500.0
"""Thickness of the layers that pressure can resolve [m']."""

_BIN_M = 50.0
_PRESSURE_NOISE = 3e-4  # of p: 0.2 hPa of barometer and 1.5 m of GNSS height, averaged in a bin
_KINK_K = 4.0  # how far the departure from the standard bends from one layer to the next [K]
_DEPARTURE_K = 20.0


def temperatures_from_pressure(
    geopotential: Array, pressure_pa: Array, standard: Profile
) -> tuple[Array, Array]:
    """Virtual temperatures at layer edges such that Eq. 52 passes through measured pressures.

    Parameters
    ----------
    geopotential, pressure_pa : (n,) heights [m'] and static pressures [Pa] there; any order.
    standard : supplies the temperature that the solution departs from smoothly.

    Returns
    -------
    edge, virtual : (k,) edges about 500 m' apart over the sampled range, T_M there [K].

    Pressure decides the mean temperature of a layer only; of the temperatures that fit, the one
    is taken whose departure from the standard bends least. Least squares, Gauss-Newton with the
    analytic derivative of ln p = ln p_0 - (G M0 / R*) * integral of dH / T_M.
    """
    count = max(1, round(float(np.ptp(geopotential)) / LAYER_M))
    edge = np.linspace(geopotential.min(), geopotential.max(), count + 1)
    height, log_p = _binned(geopotential, np.log(pressure_pa))
    background = standard.virtual_temperature(standard.gravity.height(edge))
    virtual, anchor = background.copy(), float(np.interp(edge[0], height, log_p))
    bend = _second_difference(edge.size) / _KINK_K
    weak = np.eye(edge.size) / _DEPARTURE_K
    for _ in range(20):
        layers = stack_layers(
            edge,
            virtual,
            np.zeros(edge.size),
            ("",) * count,
            anchor=(float(edge[0]), float(np.exp(anchor))),
            constant=standard.constant,
        )
        model = Profile(layers, standard.gravity, constant=standard.constant)
        residual = log_p - np.log(model.pressure(standard.gravity.height(height)))
        slope = standard.constant * _weight_integrals(height, edge, virtual)
        departure = virtual - background
        matrix = np.vstack(
            [
                np.column_stack([slope, np.ones(height.size)]) / _PRESSURE_NOISE,
                np.column_stack([bend, np.zeros(bend.shape[0])]),
                np.column_stack([weak, np.zeros(edge.size)]),
            ]
        )
        right = np.concatenate([residual / _PRESSURE_NOISE, -bend @ departure, -weak @ departure])
        step = np.linalg.lstsq(matrix, right, rcond=None)[0]
        virtual, anchor = virtual + step[:-1], anchor + float(step[-1])
        if np.abs(step[:-1]).max() < 1e-6:
            break
    return edge, virtual


def _binned(height: Array, value: Array) -> tuple[Array, Array]:
    """Means of height and value in bins of height, from the ground up."""
    number = np.floor((height - height.min()) / _BIN_M).astype(np.int64)
    filled, inverse, count = np.unique(number, return_inverse=True, return_counts=True)
    size = filled.size
    return (
        np.bincount(inverse, height, size) / count,
        np.bincount(inverse, value, size) / count,
    )


def _second_difference(n: int) -> Array:
    return np.diff(np.eye(n), n=2, axis=0)


def _weight_integrals(height: Array, edge: Array, virtual: Array) -> Array:
    """(n, k) integrals from the lowest edge to each height of phi_k / T^2, phi_k the hats."""
    grid = np.union1d(np.linspace(edge[0], edge[-1], 40 * edge.size), height)
    hats = np.stack([np.interp(grid, edge, row) for row in np.eye(edge.size)], axis=1)
    integrand = hats / np.interp(grid, edge, virtual)[:, None] ** 2
    steps = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)[:, None]
    cumulative = np.vstack([np.zeros(edge.size), np.cumsum(steps, axis=0)])
    return np.asarray(cumulative[np.searchsorted(grid, height)])
