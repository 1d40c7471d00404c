"""The locally adjusted profile: the climatology, adjusted to what the flight measured.

Sensors are checked, candidates are estimated in turn until one passes the checks of estimates, and
the result says in words why the profile is what it is. The estimate itself is made in `solver`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from pipeline.atmosphere.air_samples import AirSamples
from pipeline.atmosphere.climatology import Climatology, climatology, month_of
from pipeline.atmosphere.covariance import ProfileCovariance
from pipeline.atmosphere.estimate import sensor_checks
from pipeline.atmosphere.estimate.candidates import (
    Candidate,
    ExternalSources,
    SourceUse,
    UsedSamples,
    candidates,
    reason_unadjusted,
    source_usage,
)
from pipeline.atmosphere.estimate.estimate_checks import (
    UNCHANGED,
    Check,
    has_information,
    hygrometer_is_outside,
    is_better_than_background,
    is_plausible,
)
from pipeline.atmosphere.estimate.external_readings import TimeAndPlace, reason_uninformative
from pipeline.atmosphere.estimate.sensors import (
    Barometer,
    Humidities,
    SensorSettings,
    Temperatures,
    Thermometer,
)
from pipeline.atmosphere.estimate.solver import Estimate, FaultEstimate, estimate
from pipeline.atmosphere.estimate.thermometer_checks import MISFIT, thermometer_is_outside
from pipeline.atmosphere.layers import BAROMETRIC, MEASURED, RELAXED, STANDARD, stack_layers
from pipeline.atmosphere.profile import Profile
from pipeline.atmosphere.soundings import Sounding
from pipeline.atmosphere.surface_report import SurfaceReport
from pipeline.geodesy import normal_gravity
from pipeline.ledger import Ledger
from pipeline.units import Array, Mask

WIDEST_GAP_M = 400.0
"""Between two measured heights farther apart than this the layers are called relaxed [m']."""

FEWEST_TO_INFLATE = 5
"""The estimator never inflates the sigmas of fewer readings."""

LEFT_OUT = "with it no air fits what the flight measured"

UNMEASURED, UNADJUSTED = "climatology", "standard"
"""Bases of a profile without any measurement."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it was made.

    ``basis`` is thermometer | both | barometer | sounding | surface | climatology | standard;
    ``reason`` says why in words; ``time_ns`` is the middle of the samples that were used.
    ``covariance`` is that of the profile, None for a standard atmosphere as it is; ``faults`` the
    sensor faults as estimated; ``sources`` how each source was used, or why not; ``rejected`` the
    outliers among each sensor's samples. ``samples``, ``settings`` and ``moisture`` are what the
    estimate was made from, None where there is no estimate.
    """

    profile: Profile
    standard: Profile
    basis: str
    reason: str
    time_ns: int | None = None
    covariance: ProfileCovariance | None = None
    faults: tuple[FaultEstimate, ...] = ()
    sources: tuple[SourceUse, ...] = ()
    rejected: Mapping[str, Mask] = field(default_factory=dict)
    samples: AirSamples | None = None
    settings: SensorSettings | None = None
    moisture: Climatology | None = None

    @property
    def is_measured(self) -> bool:
        """Whether the profile rests on any measurement."""
        return self.basis not in (UNMEASURED, UNADJUSTED)


def build_adjusted_profile(
    samples: AirSamples,
    standard: Profile,
    latitude_rad: float,
    ledger: Ledger,
    *,
    settings: SensorSettings | None = None,
    background: Climatology | None = None,
    soundings: Sequence[Sounding] = (),
    surface: Sequence[SurfaceReport] = (),
    time_ns: int | None = None,
    longitude_rad: float = math.nan,
) -> Adjustment:
    """The locally adjusted atmosphere profile of a flight, with its covariance.

    Parameters
    ----------
    samples : what the flight measured outside, or a part of it.
    standard : shown beside the profile; its index formula and constants are kept.
    latitude_rad : of the flight, for gravity and climate.
    ledger : receives every fallback, and every sensor that is not used.
    settings : calibration of the sensors; by default none is known.
    background : the climatology to relax to; by default the standard, with the spread about it.
    soundings, surface : balloons and stations near the flight, weighted by age and distance;
        those that are too far in either to have any information are left out.
    time_ns, longitude_rad : of the flight, for age and distance; without samples this time gives
        the season.

    Where nothing has enough information, or the estimate fails its checks, the background is
    returned with its own sigma, and the reason.

    On nine real soundings (tests/atmosphere/test_estimate_montecarlo.py) the RMS error of R at
    1 / 3 / 6 / 10 km, where US 1976 errs by 20 / 13 / 7 / 7 %: clean sensors in climb and descent
    0.5 / 0.1 / 0.03 / 0.03 %; sensors with bias, lag, transient, drifts and outliers
    0.9 / 0.4 / 0.3 % at 1 / 3 / 6 km, in a climb alone 2.4 / 0.5 / 0.3 %; barometer and GNSS alone
    1.4 / 0.6 % at 3 / 6 km.
    """
    standard = under_gravity(standard, latitude_rad)
    sensors = (samples.temperature, samples.pressure, samples.humidity)
    middles = (sensor.middle_ns for sensor in sensors if sensor is not None)
    middle = next((middle for middle in middles if middle is not None), time_ns)
    flight = TimeAndPlace(middle, latitude_rad, longitude_rad)
    month = month_of(flight.time_ns)
    moisture = climatology(latitude_rad=latitude_rad, month=month, index=standard.index)
    if background is None:
        named = climatology(standard.name, latitude_rad=latitude_rad, month=month)
        background = replace(named, profile=standard)
    moisture = background if background.has_humidity else moisture
    samples, settings = sensor_checks.subtract_known_biases(
        samples, settings or SensorSettings(), ledger
    )
    usable = sensor_checks.usable_sensors(samples, standard, settings, ledger)
    indoors = sensor_checks.is_maybe_indoors(usable, standard, settings, ledger)
    settings = replace(settings, maybe_indoors=indoors)
    unused: dict[str, str] = {}
    external = ExternalSources(tuple(soundings), tuple(surface))
    for source in external.sources:
        why = reason_uninformative(source, flight)
        if why is not None:
            unused[source.name] = why
            ledger.loss("AIR-SOURCE-FAR", f"{source.name} is not used: {why}", where=source.name)
    near = [sounding for sounding in soundings if sounding.name not in unused]
    reports = [report for report in surface if report.name not in unused]
    tried: list[AirSamples] = []
    faults: list[str] = []
    refused: dict[str, str] = {}
    passed = _first_that_passes(
        candidates(usable, near, reports), background, settings, tried, faults,
        refused=refused, moisture=moisture, flight=flight, ledger=ledger,
    )  # fmt: skip
    usage = partial(source_usage, external=external, background=background, standard=standard.name)
    if passed is None:  # the background itself, in layers fine enough to carry its covariance
        profile = background.profile
        is_standard = profile.name == standard.name
        kept = f"the {'standard atmosphere' if is_standard else 'climatology'} {profile.name}"
        reason = reason_unadjusted(usable, faults, kept)
        ledger.fallback("AIR-STANDARD", reason)
        sensor_checks.note_unused_calibration(set(settings.calibration), ledger)
        made = estimate(AirSamples(), background)
        edge = made.profile.layers.edge
        t_m, _, vapour = profile.state(profile.gravity.height(edge))
        layers = stack_layers(
            edge, t_m, vapour, (STANDARD,) * (edge.size - 1),
            anchor=(0.0, float(profile.pressure(0.0))), constant=profile.constant,
        )  # fmt: skip
        profile = replace(profile, layers=layers)
        covariance = replace(made.covariance, profile=profile)
        basis = UNADJUSTED if is_standard else UNMEASURED
        sources = usage(UsedSamples(samples, usable, tried, refused=refused), (), unused=unused)
        return Adjustment(profile, standard, basis, reason, None, covariance, sources=sources)
    candidate, made = passed
    for name in candidate.external.left_out:
        unused[name] = LEFT_OUT
        ledger.loss("AIR-SOURCE-REFUSED", f"{name} is not used: {LEFT_OUT}", where=name)
    profile = replace(made.profile, layers=replace(made.profile.layers, source=_sources(made)))
    sensor_checks.note_pressure_level(profile, background, candidate.samples.pressure, ledger)
    _note_estimate(candidate, made, ledger)
    sensor_checks.check_calibration(made, settings, ledger)
    for readings in made.readings.sets:
        if isinstance(readings, Barometer):  # of a part of the flight pressure changes since here
            settings = replace(settings, highest=readings.highest)
    flown = UsedSamples(samples, usable, tried, candidate.samples, refused)
    used_ns = candidate.main.middle_ns if candidate.main is not None else None
    return Adjustment(
        profile, standard, candidate.basis, candidate.reason, used_ns,
        replace(made.covariance, profile=profile), made.faults,
        usage(flown, made.fits, unused=unused), made.readings.rejected,
        samples=candidate.samples, settings=settings, moisture=moisture,
    )  # fmt: skip


def _first_that_passes(
    choices: Sequence[Candidate],
    background: Climatology,
    settings: SensorSettings,
    tried: list[AirSamples],
    faults: list[str],
    *,
    refused: dict[str, str],
    moisture: Climatology,
    flight: TimeAndPlace,
    ledger: Ledger,
) -> tuple[Candidate, Estimate] | None:
    """The first estimate that passes its checks; all that were ``tried``, and their ``faults``.

    ``refused`` receives the sensors that are not used, by their quantity, and why.
    """
    remaining = list(choices)
    while remaining:
        candidate = remaining.pop(0)
        tried.append(candidate.samples)
        made = estimate(
            candidate.samples, background, settings=settings, moisture=moisture,
            soundings=candidate.external.soundings, surface=candidate.external.surface,
            flight=flight,
        )  # fmt: skip
        name = candidate.main.name if candidate.main is not None else ""
        check = thermometer_is_outside(candidate.samples, made, background, moisture, settings)
        if not check and candidate.main is not None:
            remaining = [other for other in remaining if other.samples.temperature is None]
            refused["temperature"] = check.reason
            ledger.loss("AIR-THERMOMETER", f"{name} is not used: {check.reason}", where=name)
        elif not (check := hygrometer_is_outside(made, moisture)):
            humidity = candidate.samples.humidity
            where = humidity.name if humidity is not None else ""
            refused["humidity"] = check.reason
            ledger.loss("AIR-HYGROMETER", f"{where} is not used: {check.reason}", where=where)
            remaining = [
                replace(other, samples=replace(other.samples, humidity=None))
                for other in (candidate, *remaining)
            ]
            continue
        elif candidate.basis == "barometer" and not (
            check := has_information(made, background, moisture)
        ):
            check = Check(f"{candidate.reason}, but {check.reason}")
            remaining = [other for other in remaining if other.basis != "barometer"]
        else:
            check = is_plausible(made, background)
            check = check and is_better_than_background(made, background, moisture)
            if check:
                return candidate, made
            what = f"the air estimated from {candidate.reason} is not used: {check.reason}"
            ledger.loss("AIR-IMPLAUSIBLE", what, where=name)
        faults.append(check.reason)
    return None


def _sources(made: Estimate) -> tuple[str, ...]:
    """Source of each layer: a thermometer's heights, a barometer's, neighbours, or nothing."""
    edge = made.profile.layers.edge
    middle = 0.5 * (edge[1:] + edge[:-1])
    warm = _covered(middle, made, (Thermometer, Temperatures), WIDEST_GAP_M)
    weighed = _covered(middle, made, (Barometer,), 2.0 * WIDEST_GAP_M)
    sigma = made.covariance.sigma_temperature(made.profile.break_heights_m)
    learnt = sigma < UNCHANGED * made.background_sigma_k
    between = np.where(learnt[1:] | learnt[:-1], RELAXED, STANDARD)
    source = np.where(warm, MEASURED, np.where(weighed, BAROMETRIC, between))
    return tuple(str(name) for name in source)


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard's layers in geopotential height, under the gravity of a latitude."""
    return replace(standard, gravity=normal_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    return Adjustment(standard, standard, UNADJUSTED, reason)


def _covered(middle: Array, made: Estimate, kinds: tuple[type, ...], widest: float) -> Mask:
    """Whether heights lie between two readings of some kinds, at most ``widest`` apart."""
    heights = [s.height for s in made.readings.sets if isinstance(s, kinds)]
    if not heights:
        return np.zeros(middle.size, dtype=bool)
    at = np.sort(np.concatenate(heights))
    above = np.searchsorted(at, middle)
    inside = (above > 0) & (above < at.size)
    upper, lower = np.minimum(above, at.size - 1), np.maximum(above - 1, 0)
    return np.asarray(inside & (at[upper] - at[lower] <= widest))


def _note_estimate(candidate: Candidate, made: Estimate, ledger: Ledger) -> None:
    """Report substitutes, estimated sensor faults, readings that do not fit, and outliers."""
    if candidate.basis == "barometer":
        where = candidate.main.name if candidate.main else ""
        ledger.fallback("AIR-BAROMETRIC", candidate.reason, where=where)
    if not any(isinstance(readings, Humidities) for readings in made.readings.sets):
        what = "no humidity measured outside: that of the climatology is taken"
        ledger.fallback("AIR-HUMIDITY-EXPECTED", what)
    if not made.converged:
        ledger.warning("AIR-UNSETTLED", "the estimate did not converge: its last step still moved")
    learnt = [f for f in made.faults if f.sigma < 0.7 * f.prior_sigma]
    if learnt:
        ledger.note("AIR-SENSORS", "; ".join(map(sensor_checks.described_fault, learnt)))
    for fit in made.fits:
        few = fit.count < FEWEST_TO_INFLATE
        if fit.sigma_inflation > MISFIT or (few and fit.rms > MISFIT):
            remark = "robust weights let the other readings prevail"
            if fit.sigma_inflation > MISFIT:
                remark = f"sigma inflation factor {fit.sigma_inflation:.0f}"
            what = (
                f"residuals of {fit.name} ({fit.quantity}) are {fit.rms:.1f} times what its errors "
                f"explain: {remark}"
            )
            ledger.warning("AIR-MISFIT", what, where=fit.name, count=fit.count)
    for name, rejected in made.readings.rejected.items():
        if bool(rejected.any()):
            sensor = getattr(candidate.samples, name)
            what = (
                f"{int(rejected.sum())} of {int(sensor.accepted.sum())} readings are far from "
                "their neighbours in height and time and are not used"
            )
            ledger.note("AIR-OUTLIERS", what, where=sensor.name, count=int(rejected.sum()))
