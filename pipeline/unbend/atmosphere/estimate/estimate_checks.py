"""Checks of an estimate: physical air that predicts readings held out, and sensors that fit it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere import refractive_index
from unbend.atmosphere.air_samples import part_of
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.covariance import RAY_STEPS, plane_rule
from unbend.atmosphere.estimate import external_readings, messages
from unbend.atmosphere.estimate.sensors import Barometer, Humidities, Thermometer
from unbend.atmosphere.estimate.solver import Estimate, layout_of, solve
from unbend.atmosphere.estimate.state import air_of, prior_of
from unbend.atmosphere.hypsometry import ADIABATIC_K_PER_M, COLDEST_K, WARMEST_K, hats
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.soundings.level_checks import DRIEST_RH
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array

OVERTURNING_M, SUNNY_M = 500.0, 100.0
"""A steeper fall over less height than the first may be a lag, and over the second above the ground
a sunny field [m']."""

CERTAIN = 3.0  # sigmas by which a lapse rate must exceed the adiabatic one

FARTHEST = 5.0
"""Sigmas of the climatology that no air of the real soundings comes near (2.9 at most)."""

UNCHANGED = 0.95  # where a sigma is still this much of the climatology's, nothing was learnt
LEAST_RAY_M = 100.0  # height over which sigmas of R are compared where less was flown [m]

HARMLESS_K, HARMLESS_LOG_P = 1.0, 1e-3
"""Held-out residuals of so little are no reason to fall back: a sharp inversion leaves them."""

HIGHEST_DEW_POINT_K = 308.15  # the highest ever reported near the ground, 35 C on the Persian Gulf

WETTEST_SIGMAS = 4.0
"""Sigmas above the climatology's dew point that no air of the real soundings comes near."""

CLOUD_RH, CLOUD_SHARE = 0.97, 0.9
CLOUD_M, CLOUD_EXCESS_K_PER_M = 1000.0, 3e-3
"""Air whose readings are saturated, nine of ten over so much height [m'], does not cool by 3 K/km
more than the saturated adiabat."""

DRY_BELOW_M = 3000.0  # no air below is as dry as `DRIEST_RH` throughout

UNLIKELY_COLUMN = 4.0  # sigmas of the climatology; 10 hPa, or 90 m of height, are one of pressure

LEAST_COMMON_M, CONTRADICTED_K, CONTRADICTED = 300.0, 2.0, 4.5
"""Sensors contradict a column that shares so much height [m'], by so much and so many sigma."""

MISFIT = 5.0  # readings with a larger sigma inflation factor disagree with the others


@dataclass(frozen=True)
class Check:
    """Result of a check: true where it is passed, else with the reason in words."""

    reason: str = ""

    def __bool__(self) -> bool:
        return not self.reason


PASSED = Check()


def is_plausible(made: Estimate, background: Climatology) -> Check:
    """Whether an estimate can be air, between the lowest and the highest measurement: between 180
    and 335 K, within 5 sigma of the climatology, and above the lowest 100 m no steeper than the
    dry adiabat by 3 sigma over 500 m."""
    layers = made.profile.layers
    # A balloon goes higher than a climatology does.
    bounds = (layers.edge, background.profile.layers.edge)
    low = max(made.readings.low, *(float(edge[0]) for edge in bounds))
    high = min(made.readings.high, *(float(edge[-1]) for edge in bounds))
    h = np.arange(low, max(high, low + 1.0), 50.0)
    height = background.profile.gravity.height(h)
    t = made.profile.temperature(height)
    if not bool(np.all((t > COLDEST_K) & (t < WARMEST_K))):
        return Check(messages.not_temperatures_of_air(lowest_k=t.min(), highest_k=t.max()))
    spread = background.spread.sigma_temperature(made.profile.break_heights_m)
    sigma = np.interp(h, layers.edge, spread)
    departure = (t - background.profile.temperature(height)) / sigma
    worst = int(np.argmax(np.abs(departure)))
    if abs(departure[worst]) > FARTHEST:
        reason = messages.far_from_climatology(
            kelvin=t[worst], height_m=height[worst], sigmas=abs(departure[worst])
        )
        return Check(reason)
    over = round(OVERTURNING_M / 50.0)
    h, t, height = (values[round(SUNNY_M / 50.0) :] for values in (h, t, height))
    if h.size > over:
        # One sigma of T(h) - T(h + 500 m) [K]; that of T_M stands for it.
        weights = hats(layers.edge, h[:-over]) - hats(layers.edge, h[over:])
        matrix = made.covariance.matrix[: layers.edge.size, : layers.edge.size]
        sigma = np.sqrt(np.einsum("ij,ij->i", weights @ matrix, weights))
        excess = t[:-over] - t[over:] - ADIABATIC_K_PER_M * OVERTURNING_M - CERTAIN * sigma
        steepest = int(np.argmax(excess))
        if excess[steepest] > 0.0:
            lapse = (t[steepest] - t[steepest + over]) / OVERTURNING_M * 1000.0
            return Check(messages.air_overturns(lapse=lapse, height_m=height[steepest]))
    return PASSED


def reasons_against(
    columns: Sequence[Sounding],
    own: Estimate | None,
    background: Climatology,
    flight: external_readings.TimeAndPlace,
) -> dict[str, str]:
    """Why columns are not used, by name: the climatology or the flight's ``own`` sensors."""
    reasons = {}
    for column in columns:
        check = column_is_plausible(column, background)
        if check and own is not None:
            check = column_agrees(column, own, background, flight)
        if not check:
            reasons[column.name] = check.reason
    return reasons


def column_is_plausible(column: Sounding, background: Climatology) -> Check:
    """Whether the climatology can have the lowest pressure and the temperatures of a column, whose
    heights may be those above ground, or in feet, and which may be of another season."""
    profile, h = background.profile, float(column.h_m[0])
    expected = float(profile.pressure(h))
    sigmas = float(np.log(column.pressure_pa[0] / expected)) / background.sigma_log_pressure(h)
    if abs(sigmas) > UNLIKELY_COLUMN:
        reason = messages.level_far_from_climatology(
            hpa=column.pressure_pa[0] / HECTOPASCAL,
            height_m=h,
            sigmas=abs(sigmas),
            expected_hpa=expected / HECTOPASCAL,
        )
        return Check(reason)
    heights: Array = column.h_m[column.h_m < h + 3000.0]
    off = column.temperature_k[: heights.size] - profile.temperature(heights)
    sigmas = float(np.mean(off / background.spread.sigma_temperature(heights)))
    if abs(sigmas) > UNLIKELY_COLUMN:
        reason = messages.column_far_from_climatology(kelvin=off.mean(), sigmas=abs(sigmas))
        return Check(reason)
    return PASSED


def column_agrees(
    column: Sounding, own: Estimate, background: Climatology, flight: external_readings.TimeAndPlace
) -> Check:
    """Whether temperatures of a column are, in the mean over the heights that both know, those that
    the flight's ``own`` sensors give, within the uncertainty of these, its age and distance."""
    gravity = background.profile.gravity
    levels = gravity.geopotential_height(column.h_m)
    low, high = max(own.readings.low, levels[0]), min(own.readings.high, levels[-1])
    departures = external_readings.sounding_departures((column,), background, flight)
    if high - low < LEAST_COMMON_M or not departures:
        return PASSED
    h = np.linspace(low, high, 30)
    measured = np.interp(h, levels, column.temperature_k)
    in_flight = own.profile.temperature(gravity.height(h))
    in_flight += np.interp(h, departures[0].knot, departures[0].expected_k)
    mean = float(np.mean(measured - in_flight))
    edge = own.profile.layers.edge
    # The variance of the mean of T(h); that of T_M stands for it.
    parts = (
        (hats(edge, h).mean(axis=0), own.covariance.matrix[: edge.size, : edge.size]),
        (hats(departures[0].knot, h).mean(axis=0), departures[0].covariance(background)),
    )
    sigma = float(
        np.sqrt(sum(w @ matrix @ w for w, matrix in parts) + external_readings.LEVEL_K**2)
    )
    if abs(mean) <= max(CONTRADICTED_K, CONTRADICTED * sigma):
        return PASSED
    reason = messages.column_contradicts_flight(
        kelvin=mean, sigmas=abs(mean) / sigma, extent_m=high - low
    )
    return Check(reason)


def has_information(made: Estimate, background: Climatology, moisture: Climatology) -> Check:
    """Whether R over the measured heights is more certain than without the flight's own sensors: a
    barometer beside a GNSS height that drifts has information from some 200 m of climb."""
    layout, profile = layout_of(made.readings, background), background.profile
    prior = prior_of(layout, background, moisture)
    others = [s for s in made.readings.sets if not isinstance(s, Thermometer | Barometer)]
    without = solve(layout, prior, others, profile).profile(profile)
    low, high = (float(profile.gravity.height(h)) for h in (made.readings.low, made.readings.high))
    h, weight = plane_rule(max(high, low + LEAST_RAY_M), low, RAY_STEPS)
    sigmas = [
        float(covariance.sigma_of(weight[None] @ covariance.refractivity_gradient(h))[0])
        for covariance in (made.covariance, without[1])
    ]
    if sigmas[0] < UNCHANGED * sigmas[1]:
        return PASSED
    percent_left = 100.0 * sigmas[0] / sigmas[1]
    return Check(messages.no_information(percent=percent_left))


def is_better_than_background(
    made: Estimate, background: Climatology, moisture: Climatology, name: str = "the climatology"
) -> Check:
    """Whether an estimate predicts held-out readings better than its background (``name``) does:
    every other bin of thermometer and barometer, about their median. Consistent readings do, even
    if all of them have the same error; unrelated noise does not."""
    measured = made.readings
    layout = made.layout
    prior = prior_of(layout, background, moisture)
    used, held_out = list(measured.sets), []
    for i, readings in enumerate(measured.sets):
        odd = np.arange(readings.height.size) % 2 == 1
        if isinstance(readings, Thermometer | Barometer) and bool(odd.any()):
            used[i] = part_of(readings, ~odd)
            held_out.append(part_of(readings, odd))
    if not held_out:
        return PASSED
    profile = background.profile
    air = solve(layout, prior, used, profile, made.state).air
    pressure = profile.pressure(profile.gravity.height(layout.knot))
    expected = air_of(layout, prior.mean, pressure, profile.constant)
    for readings in held_out:
        residuals = (readings.value - readings.predict(a)[0] for a in (air, expected))
        # Median distance from the median, as one sigma.
        by_estimate, by_background = (
            float(1.4826 * np.median(np.abs(r - np.median(r)))) for r in residuals
        )
        is_pressure = isinstance(readings, Barometer)
        if by_estimate > max(by_background, HARMLESS_LOG_P if is_pressure else HARMLESS_K):
            unit, factor = ("%", 100.0) if is_pressure else ("K", 1.0)
            reason = messages.held_out_readings_differ(
                sensor=readings.name,
                unit=unit,
                name=name,
                by_estimate=factor * by_estimate,
                by_background=factor * by_background,
            )
            return Check(reason)
    return PASSED


def hygrometer_is_outside(made: Estimate, moisture: Climatology) -> Check:
    """Whether air of the estimated temperatures can be as humid as the flight's hygrometer reads:
    no dew point above 35 C, or 4 sigma above that of the climatology, and no saturation over 1 km
    in which temperature falls too fast for a cloud."""
    gravity, spread = made.profile.gravity, moisture.spread
    for readings in made.readings.sets:
        if not isinstance(readings, Humidities) or readings.fault is None:
            continue
        h = gravity.height(readings.height)
        if h.min() < DRY_BELOW_M and readings.value.max() <= DRIEST_RH:
            return Check(messages.hygrometer_too_dry(percent=100.0 * readings.value.max()))
        saturated = refractive_index.saturation_vapour_pressure(made.profile.temperature(h))
        dew = refractive_index.dew_point(readings.value * saturated)
        usual = refractive_index.dew_point(moisture.profile.vapour_pressure(h))
        # d ln e_s / dT is about 5400 K / T^2.
        share = spread.sigma_relative_humidity(h) / np.maximum(moisture.relative_humidity(h), 0.01)
        sigma = np.hypot(spread.sigma_temperature(h), usual**2 / 5400.0 * share)
        limit = np.minimum(usual + WETTEST_SIGMAS * sigma, HIGHEST_DEW_POINT_K)
        worst = int(np.argmax(dew - limit))
        if dew[worst] > limit[worst]:
            reason = messages.hygrometer_too_wet(
                percent=100.0 * readings.value[worst],
                height_m=h[worst],
                dew_c=dew[worst] - ZERO_CELSIUS_K,
                limit_c=limit[worst] - ZERO_CELSIUS_K,
            )
            return Check(reason)
        wet = readings.height[readings.value >= CLOUD_RH]
        if wet.size == 0 or np.ptp(wet) < CLOUD_M:
            continue
        ends = np.array([wet.min(), wet.max()])
        inside = (readings.height >= ends[0]) & (readings.height <= ends[1])
        t = made.profile.temperature(gravity.height(ends))
        lapse = float(t[0] - t[1]) / float(np.ptp(ends))
        p = made.profile.pressure(gravity.height(ends))
        adiabat = float(refractive_index.saturated_lapse(t, p).mean())
        if wet.size >= CLOUD_SHARE * inside.sum() and lapse > adiabat + CLOUD_EXCESS_K_PER_M:
            reason = messages.hygrometer_in_no_cloud(
                percent=100.0 * CLOUD_RH,
                low_m=ends[0],
                high_m=ends[1],
                lapse=1e3 * lapse,
                adiabat=1e3 * adiabat,
            )
            return Check(reason)
    return PASSED
