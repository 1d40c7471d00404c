"""Temperature of the air from pressure at known heights, for a flight without a thermometer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.profile import Profile, stack_layers
from pipeline.atmosphere.samples import BIN_M, Samples, bin_by_height

Array = NDArray[np.float64]

LAYER_M = 500.0
"""Thickness of the layers that pressure can resolve [m']."""

COLDEST_K, WARMEST_K = 180.0, 335.0
"""Temperatures that air has; a solution outside them is none [K]."""

_PRESSURE_NOISE = 3e-4  # of p: 0.2 hPa of barometer and 1.5 m of GNSS height, averaged in a bin
_KINK_K = 4.0  # how far the departure from the standard bends from one layer to the next [K]
_DEPARTURE_K = 20.0
_HUBER = 3.0  # residuals beyond so many sigma lose weight


def implied_temperature(pressure: Samples, standard: Profile) -> float | None:
    """Mean virtual temperature that the fall of pressure with height implies [K].

    By the hypsometric equation over the whole sampled range, from medians in bins of height:
    1000 m of climb give it to about 2 K. None where there are too few heights, or where pressure
    does not fall.
    """
    height, log_p = _binned(pressure, standard)
    if height.size < 3:
        return None
    slope = float(np.polyfit(height - height.mean(), log_p, 1)[0])
    return None if slope >= 0.0 else -standard.constant / slope


def temperatures_from_pressure(pressure: Samples, standard: Profile) -> tuple[Array, Array] | None:
    """Virtual temperatures at layer edges such that Eq. 52 passes through measured pressures.

    Parameters
    ----------
    pressure : static pressures [Pa] at GNSS heights.
    standard : supplies the temperature that the solution departs from smoothly.

    Returns
    -------
    edge, virtual : (k,) edges about 500 m' apart over the sampled range, T_M there [K]; None
        where the pressures fit no air between 180 and 335 K.

    Pressure decides the mean temperature of a layer only; of the temperatures that fit, the one
    is taken whose departure from the standard bends least. Least squares on medians in bins of
    height with Huber's weights, Gauss-Newton with the analytic derivative of
    ln p = ln p_0 - (G M0 / R*) * integral of dH / T_M.
    """
    height, log_p = _binned(pressure, standard)
    if height.size < 3:
        return None
    count = max(1, round(float(np.ptp(height)) / LAYER_M))
    edge = np.linspace(height[0], height[-1], count + 1)
    background = standard.virtual_temperature(standard.gravity.height(edge))
    virtual, anchor = background.copy(), float(log_p[0])
    bend = np.diff(np.eye(edge.size), n=2, axis=0) / _KINK_K
    weak = np.eye(edge.size) / _DEPARTURE_K
    weight = np.ones(height.size)
    for _ in range(30):
        residual = (
            log_p - _log_pressure(height, edge, virtual, anchor, standard)
        ) / _PRESSURE_NOISE
        weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(np.abs(residual), 1e-12)))
        slope = standard.constant * _weight_integrals(height, edge, virtual) / _PRESSURE_NOISE
        level = np.full(height.size, 1.0 / _PRESSURE_NOISE)
        departure = virtual - background
        matrix = np.vstack(
            [
                np.column_stack([slope, level]) * weight[:, None],
                np.column_stack([bend, np.zeros(bend.shape[0])]),
                np.column_stack([weak, np.zeros(edge.size)]),
            ]
        )
        right = np.concatenate([residual * weight, -bend @ departure, -weak @ departure])
        step = np.linalg.lstsq(matrix, right, rcond=None)[0]
        virtual, anchor = virtual + step[:-1], anchor + float(step[-1])
        if not bool(np.all((virtual > COLDEST_K) & (virtual < WARMEST_K))):
            return None
        if np.abs(step[:-1]).max() < 1e-6:
            break
    return edge, virtual


def _log_pressure(
    height: Array, edge: Array, virtual: Array, anchor: float, standard: Profile
) -> Array:
    """ln p at geopotential heights, through temperatures at edges, from ln p at the lowest."""
    layers = stack_layers(
        edge,
        virtual,
        np.zeros(edge.size),
        ("",) * (edge.size - 1),
        anchor=(float(edge[0]), float(np.exp(anchor))),
        constant=standard.constant,
    )
    model = Profile(layers, standard.gravity, constant=standard.constant)
    return np.log(model.pressure(standard.gravity.height(height)))


def _binned(pressure: Samples, standard: Profile) -> tuple[Array, Array]:
    """Heights [m'] and ln p in bins, by medians of the departure from the standard."""
    geopotential = standard.gravity.geopotential_height(pressure.h_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        departure = np.log(pressure.value) - np.log(standard.pressure(pressure.h_m))
    height, middle = bin_by_height(geopotential, pressure, BIN_M, departure)
    if height.size == 0:
        return height, middle
    return height, middle + np.log(standard.pressure(standard.gravity.height(height)))


def _weight_integrals(height: Array, edge: Array, virtual: Array) -> Array:
    """(n, k) integrals from the lowest edge to each height of phi_k / T^2, phi_k the hats."""
    grid = np.union1d(np.linspace(edge[0], edge[-1], 40 * edge.size), height)
    hats = np.stack([np.interp(grid, edge, row) for row in np.eye(edge.size)], axis=1)
    integrand = hats / np.interp(grid, edge, virtual)[:, None] ** 2
    steps = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)[:, None]
    cumulative = np.vstack([np.zeros(edge.size), np.cumsum(steps, axis=0)])
    return np.asarray(cumulative[np.searchsorted(grid, height)])
