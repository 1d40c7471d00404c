"""The air of a flight: T, p, e and N against height, with sigmas, samples and the standard."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.refractive_index import vapour_pressure
from pipeline.refraction.effect import FlightAir
from pipeline.report.style import ADJUSTED, STANDARD, height_range, new_figure, scatter, styled
from pipeline.report.words import effect_lines
from pipeline.units import HECTOPASCAL, ZERO_CELSIUS_K

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_WINDOW = "#93c5fd"
_PPM = 1e6


@styled
def profile_figure(air: FlightAir, samples: AirSamples) -> Figure:
    """T, p, e and N of the air and of the standard against height, and the effect on R.

    One-sigma bands where there is a covariance; the samples, those that are not used paler; thin
    lines for the parts of a long flight.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    figure, axes = new_figure(3, 10.2, 6.4, rows=2)
    adjustment = air.adjustment
    profile, standard, covariance = adjustment.profile, adjustment.standard, adjustment.covariance
    low, high = height_range(samples)
    h = np.linspace(max(low, profile.bottom_m), min(high, profile.top_m), 300)
    p = profile.pressure(h)
    sigmas: Sequence[Array | None] = (None,) * 4
    if covariance is not None:
        sigmas = (
            covariance.sigma_temperature(h),
            covariance.sigma_log_pressure(h) * p / HECTOPASCAL,
            covariance.sigma_vapour_pressure(h) / HECTOPASCAL,
            covariance.sigma_refractivity(h) * _PPM,
        )
    _draw_samples(axes, air, samples)
    windows = [w.air.profile for w in air.windows if not w.why_not]
    labels = ("temperature [°C]", "pressure [hPa]", "vapour pressure [hPa]", "(n - 1) 10⁶")
    quantities = [_quantities(one, h) for one in (profile, standard, *windows)]
    for i, (axis, label, sigma) in enumerate(zip(axes, labels, sigmas, strict=False)):
        for number, others in enumerate(quantities[2:]):
            named = "parts of the flight" if number == 0 else None
            axis.plot(others[i], h, color=_WINDOW, lw=0.7, label=named)
        axis.plot(quantities[1][i], h, color=STANDARD, lw=1.2, label=standard.name)
        if profile is not standard:
            _draw_band(axis, quantities[0][i], sigma, h)
            axis.plot(quantities[0][i], h, color=ADJUSTED, lw=1.3, label=profile.name)
        axis.set_xlabel(label)
        axis.set_ylim(low, high)
    # The layout leaves no room for a number at the very end of an axis.
    axes[2].xaxis.set_major_locator(MaxNLocator(5, prune="upper"))
    axes[1].set_xscale("log")
    axes[1].minorticks_off()
    axes[1].xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes[1].xaxis.set_major_formatter(ScalarFormatter())
    _draw_against(axes[4], air, h, sigmas[3])
    axes[4].set_ylim(low, high)
    for axis in (axes[0], axes[3]):
        axis.set_ylabel("height above sea level [m]")
    for axis in (axes[1], axes[2], axes[4]):
        axis.tick_params(labelleft=False)
    _write_effect(axes[5], axes[0], air)
    return figure


def _quantities(profile: Profile, h: Array) -> tuple[Array, Array, Array, Array]:
    """In the units of the axes."""
    return (
        profile.temperature(h) - ZERO_CELSIUS_K,
        profile.pressure(h) / HECTOPASCAL,
        profile.vapour_pressure(h) / HECTOPASCAL,
        profile.refractivity(h) * _PPM,
    )


def _draw_band(axis: Axes, value: Array, sigma: Array | None, h: Array) -> None:
    if sigma is not None:
        axis.fill_betweenx(
            h, value - sigma, value + sigma, color=ADJUSTED, alpha=0.18, lw=0, label="one sigma"
        )


def _draw_samples(axes: Sequence[Axes], air: FlightAir, samples: AirSamples) -> None:
    rejected, profile = air.adjustment.rejected, air.adjustment.profile
    warm, weighed, moist = samples.temperature, samples.pressure, samples.humidity
    if warm is not None:
        scatter(axes[0], warm, warm.value - ZERO_CELSIUS_K, rejected.get("temperature"))
    if weighed is not None:
        scatter(axes[1], weighed, weighed.value / HECTOPASCAL, rejected.get("pressure"))
    if moist is not None:
        t, p = profile.temperature(moist.h_m), profile.pressure(moist.h_m)
        e = vapour_pressure(np.clip(moist.value, 0.0, 1.0), t, p) / HECTOPASCAL
        scatter(axes[2], moist, np.asarray(e), rejected.get("humidity"))


def _draw_against(axis: Axes, air: FlightAir, h: Array, sigma: Array | None) -> None:
    """Refractivity against the standard, where a sigma can be seen."""
    profile, standard = air.adjustment.profile, air.adjustment.standard
    n = standard.refractivity(h)
    excess = 100.0 * (profile.refractivity(h) / n - 1.0)
    axis.axvline(0.0, color=STANDARD, lw=1.2)
    if profile is not standard:
        _draw_band(axis, excess, None if sigma is None else 100.0 * sigma / _PPM / n, h)
        axis.plot(excess, h, color=ADJUSTED, lw=1.3)
    axis.set_xlabel(f"n - 1 against {standard.name} [%]")


def _write_effect(axis: Axes, labelled: Axes, air: FlightAir) -> None:
    """The legend, and what the air does to R."""
    axis.set_axis_off()
    handles, names = labelled.get_legend_handles_labels()
    axis.legend(handles, names, frameon=False, markerscale=5.0, loc="upper left")
    rows = [effect.row() for effect in air.effects]
    lines = effect_lines(rows, air.adjustment.standard.name)
    broken = "\n\n".join(line.replace(": ", ":\n") for line in lines)
    axis.text(0.0, 0.0, broken, va="bottom", transform=axis.transAxes)
