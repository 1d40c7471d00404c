"""The locally adjusted profile: the climatology, adjusted to what the flight measured.

Sensors are checked, and candidates are estimated in turn until one passes the checks of estimates.
The result gives in words why the profile is what it is. The estimate itself is made in `solver`.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorUse, sensor_uses
from unbend.atmosphere.air_variation import solar_hour
from unbend.atmosphere.barometer_errors import NO_ERRORS, BarometerErrors
from unbend.atmosphere.climatology import Climatology, climatology, month_of
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate import candidates, estimate_checks, messages, sensor_checks, sensors
from unbend.atmosphere.estimate.candidates import Candidate, ExternalSources, SourceUse
from unbend.atmosphere.estimate.external_readings import (
    TimeAndPlace,
    pressure_sources,
    reason_uninformative,
)
from unbend.atmosphere.estimate.normal_equations import Fit
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.solver import Estimate, FaultEstimate, estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.estimate.trials import ExpectedAir, Passed, Trials, first_that_passes
from unbend.atmosphere.layers import BAROMETRIC, MEASURED, RELAXED, STANDARD, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason, Reasons, with_reason
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.geodesy import normal_gravity
from unbend.messages import Ledger, Message
from unbend.units import Array, Mask

WIDEST_GAP_M = 400.0
"""Layers between two measured heights that are farther apart are not called measured [m']."""

FEWEST_TO_INFLATE = 5  # the estimator never inflates the sigmas of a set with fewer readings
_NO_AIR_FITS = "with it, no air fits the measurements of the flight"

# Bases of a profile without any measurement.
UNMEASURED = "climatology"
UNADJUSTED = "standard"

_LEARNT_SHARE = 0.7  # of the prior sigma: a sensor fault with less is reported as determined


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it was made.

    ``standard``: shown beside it. ``basis``: thermometer | both | barometer | sounding |
    weather model | surface | climatology | standard; ``reason``: why, in words. ``time_ns``: middle
    of the samples of the main sensor. ``covariance``: None for an unchanged standard.
    ``rejected``: by quantity, why samples are not used, also of a sensor that is not used at all;
    ``sensor_uses`` counts them; both are empty where nothing was estimated. ``samples``,
    ``settings`` and ``moisture``: what the estimate was made from, None without one.
    """

    profile: Profile
    standard: Profile
    basis: str
    reason: str
    time_ns: int | None = None
    covariance: ProfileCovariance | None = None
    faults: tuple[FaultEstimate, ...] = ()
    sources: tuple[SourceUse, ...] = ()
    rejected: Mapping[str, Reasons] = field(default_factory=dict)
    sensor_uses: tuple[SensorUse, ...] = ()
    samples: AirSamples | None = None
    settings: SensorSettings | None = None
    moisture: Climatology | None = None
    utc_known: bool = True

    @property
    def is_measured(self) -> bool:
        """Whether the profile is from any measurement."""
        return self.basis not in (UNMEASURED, UNADJUSTED)

    @property
    def barometer_errors(self) -> BarometerErrors:
        """The errors of the barometer by the estimate; `NO_ERRORS` without a barometer."""
        if self.settings is None or self.settings.highest_log_p is None:
            return NO_ERRORS
        values = {fault.fault: fault.value for fault in self.faults}
        return BarometerErrors(
            offset_pa=values.get(SensorFault.PRESSURE_OFFSET, 0.0),
            lost_share=values.get(SensorFault.PRESSURE_SCALE, 0.0),
            highest_pa=math.exp(self.settings.highest_log_p),
        )


def build_adjusted_profile(  # noqa: PLR0913
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
    utc_known: bool = True,
    doubt_of_time: str = "",
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
        those too far in either to have any information are left out.
    time_ns, longitude_rad : of the flight, for age and distance; without samples this time gives
        the season.
    utc_known : whether the times of the samples are UTC; else they count from a boot, and
        ``time_ns`` alone gives the season.
    doubt_of_time : of ``time_ns``, in words for messages, as in `TimeAndPlace`.

    Where nothing has enough information, or no estimate passes its checks, it is the background
    with its own sigma, and the reason.

    On nine real soundings (tests/atmosphere/test_estimate_montecarlo.py) the RMS error of R at
    1 / 3 / 6 km, where US 1976 errs by 20 / 13 / 7 %: clean sensors in climb and descent
    0.6 / 0.1 / 0.04 %; sensors with bias, lag, transient, drifts and outliers 1.8 / 0.3 / 0.2 %, in
    a climb alone 3.2 / 0.5 / 0.2 %; barometer and GNSS alone 1.3 / 0.8 % at 3 / 6 km.
    """
    standard = under_gravity(standard, latitude_rad)
    middle_ns = _middle_of_samples(samples) if utc_known else None
    flight = TimeAndPlace(
        time_ns if middle_ns is None else middle_ns,
        latitude_rad,
        longitude_rad,
        doubt=doubt_of_time if middle_ns is None else "",
    )
    expected = _expected_air(standard, background, flight)
    samples, settings = ledger.take(
        sensor_checks.subtract_known_biases(samples, settings or SensorSettings())
    )
    usable = ledger.take(sensor_checks.usable_sensors(samples, standard))
    external = ExternalSources(tuple(soundings), tuple(surface))
    unused = _sources_too_far(external, flight, ledger)
    near = [sounding for sounding in soundings if sounding.name not in unused]
    reports = [report for report in surface if report.name not in unused]
    contradicting = _contradicting_soundings(near, usable, expected, settings)
    ledger.extend(_refused_sources(contradicting))
    unused |= contradicting
    near = [sounding for sounding in near if sounding.name not in unused]
    choices = candidates.candidates(usable, near, reports)
    trials = first_that_passes(choices, expected, settings)
    ledger.extend(trials.notes)
    sources = _Sources(samples, usable, external, unused)
    if trials.passed is None:
        made = _kept_background(trials, sources, expected, settings, ledger)
    else:
        made = _adjusted(trials, trials.passed, sources, expected, settings, ledger=ledger)
    return replace(made, utc_known=utc_known)


@dataclass(frozen=True, eq=False)
class _Sources:
    """The sources of the air.

    ``logged``: samples of the log; ``usable``: these after the sensor checks; ``external``: all
    soundings and stations; ``unused``: why some of them are not used, by name.
    """

    logged: AirSamples
    usable: AirSamples
    external: ExternalSources
    unused: dict[str, str]


def _middle_of_samples(samples: AirSamples) -> int | None:
    """Middle of the accepted samples of the first sensor that has any [Unix ns]; None without."""
    for sensor in samples.sensors.values():
        if sensor.middle_ns is not None:
            return sensor.middle_ns
    return None


def _expected_air(
    standard: Profile, background: Climatology | None, flight: TimeAndPlace
) -> ExpectedAir:
    """The air expected in a flight: the background, or without one the standard and its spread."""
    of_season = partial(
        climatology,
        latitude_rad=flight.latitude_rad,
        month=month_of(flight.time_ns),
        hour=solar_hour(flight.time_ns, flight.longitude_rad),
    )
    if background is None:
        background = replace(of_season(standard.name), profile=standard)
    moisture = background if background.has_humidity else of_season(index=standard.index)
    return ExpectedAir(flight, standard, background, moisture)


def _sources_too_far(
    external: ExternalSources, flight: TimeAndPlace, ledger: Ledger
) -> dict[str, str]:
    """Why soundings and stations are too old or too far away to be used, by name.

    Those that can be used are left out. Adds a message on each to the ledger.
    """
    too_far = {}
    for source in external.sources:
        reason = reason_uninformative(source, flight)
        if reason is not None:
            too_far[source.name] = reason
    for name, reason in too_far.items():
        ledger.add(messages.source_far(name=name, reason=reason, doubt=flight.doubt))
    return too_far


def _contradicting_soundings(
    soundings: Sequence[Sounding],
    usable: AirSamples,
    expected: ExpectedAir,
    settings: SensorSettings,
) -> dict[str, str]:
    """Why soundings are not used, by name: the climatology or the flight's sensors contradict them.

    The flight's sensors do so by an estimate without any sounding or station.
    """
    estimate_alone = None
    if soundings:
        choices = candidates.candidates(usable, (), ())
        passed = first_that_passes(choices, expected, settings).passed
        if passed is not None:
            estimate_alone = passed.made
    return estimate_checks.reasons_against(
        soundings, estimate_alone, expected.background, expected.flight
    )


def _kept_background(
    trials: Trials,
    sources: _Sources,
    expected: ExpectedAir,
    settings: SensorSettings,
    ledger: Ledger,
) -> Adjustment:
    """The unchanged background as the result, where no estimate passed its checks."""
    background = expected.background
    is_standard = background.profile.name == expected.standard.name
    kind = "standard atmosphere" if is_standard else "climatology"
    kept_background = f"the {kind} {background.profile.name}"
    reason = candidates.reason_unadjusted(sources.usable, trials.faults, kept_background)
    ledger.add(messages.air_standard(reason=reason))
    ledger.extend(sensor_checks.unused_calibration(set(settings.calibration)))
    covariance = covariance_of_background(background)
    rejected = _rejected_samples(sources.logged, sources.usable, {})
    return Adjustment(
        profile=covariance.profile,
        standard=expected.standard,
        basis=UNADJUSTED if is_standard else UNMEASURED,
        reason=reason,
        covariance=covariance,
        sources=_usage(trials, sources, expected, None, ()),
        rejected=rejected,
        sensor_uses=sensor_uses(sources.logged, rejected),
    )


def _adjusted(
    trials: Trials,
    passed: Passed,
    sources: _Sources,
    expected: ExpectedAir,
    settings: SensorSettings,
    *,
    ledger: Ledger,
) -> Adjustment:
    """The result from an estimate that passed; messages on it are added to the ledger.

    Adds the sources that the estimate leaves out to ``sources.unused``.
    """
    candidate, made = passed
    misfits = dict.fromkeys(candidate.external.left_out, _NO_AIR_FITS)
    ledger.extend(_refused_sources(misfits))
    sources.unused.update(misfits)
    layers = replace(made.profile.layers, source=_sources_of_layers(made))
    profile = replace(made.profile, layers=layers)
    ledger.add(
        sensor_checks.pressure_level(
            profile,
            expected.background,
            candidate.samples.pressure,
            other_sources=pressure_sources(candidate.external.sources, expected.flight),
        )
    )
    ledger.extend(_notes(candidate, made))
    ledger.extend(sensor_checks.maybe_in_a_bay(made, candidate.samples))
    estimate_with = partial(expected.estimate_of, candidate)
    ledger.extend(sensor_checks.check_calibration(made, settings, estimate_with))
    for readings in made.readings.sets:
        if isinstance(readings, sensors.Barometer):  # estimates of parts of the flight need it
            settings = replace(settings, highest_log_p=readings.highest_log_p)
    rejected = _rejected_samples(sources.logged, sources.usable, made.readings.rejected)
    return Adjustment(
        profile=profile,
        standard=expected.standard,
        basis=candidate.basis,
        reason=candidate.reason,
        time_ns=None if candidate.main is None else candidate.main.middle_ns,
        covariance=replace(made.covariance, profile=profile),
        faults=made.faults,
        sources=_usage(trials, sources, expected, candidate.samples, made.fits),
        rejected=rejected,
        sensor_uses=sensor_uses(sources.logged, rejected),
        samples=candidate.samples,
        settings=settings,
        moisture=expected.moisture,
    )


def _usage(
    trials: Trials,
    sources: _Sources,
    expected: ExpectedAir,
    used: AirSamples | None,
    fits: Sequence[Fit],
) -> tuple[SourceUse, ...]:
    """How each source is used, or why it is not.

    ``used``, ``fits``: samples and fits of the estimate that passed; None and empty without one.
    """
    flown = candidates.UsedSamples(
        logged=sources.logged,
        usable=sources.usable,
        tried=trials.tried,
        used=used,
        refused=trials.refused,
    )
    return candidates.source_usage(
        flown,
        fits,
        external=sources.external,
        unused=sources.unused,
        background=expected.background,
        standard=expected.standard.name,
    )


def _rejected_samples(
    logged: AirSamples, usable: AirSamples, by_estimate: Mapping[str, Reasons]
) -> dict[str, Reasons]:
    """Why samples of each sensor are not used, by quantity.

    ``by_estimate``: the reasons of the estimate's sensors; all samples of other sensors are unused.
    """
    rejected: dict[str, Reasons] = {}
    for quantity, sensor in logged.sensors.items():
        if quantity in by_estimate:
            rejected[quantity] = by_estimate[quantity]
            continue
        checked = usable.sensors.get(quantity, sensor)
        all_rows = np.ones(checked.rejected.shape, np.bool_)
        rejected[quantity] = with_reason(checked.rejected, all_rows, Reason.SENSOR_NOT_USED)
    return rejected


def _refused_sources(reasons: Mapping[str, str]) -> Iterator[Message]:
    """Messages on sources that contradict others; ``reasons`` by their names."""
    for name, reason in reasons.items():
        yield messages.source_refused(name=name, reason=reason)


def covariance_of_background(background: Climatology) -> ProfileCovariance:
    """The covariance of the unchanged background, with a profile in layers as fine as it needs."""
    made = estimate(AirSamples(), background)
    edge = made.profile.layers.edge
    profile = background.profile
    t_m, _, vapour = profile.state(profile.gravity.height(edge))
    layers = stack_layers(
        edge,
        t_m,
        vapour,
        (STANDARD,) * (edge.size - 1),
        anchor=(0.0, float(profile.pressure(0.0))),
        constant=profile.constant,
    )
    return replace(made.covariance, profile=replace(profile, layers=layers))


def _sources_of_layers(made: Estimate) -> tuple[str, ...]:
    """Source of each layer (`layers.MEASURED` ... `layers.STANDARD`).

    Measured between the heights of a thermometer, balloon or station; else barometric between those
    of a barometer; else relaxed where the sigma is smaller than that of the background; else
    standard.
    """
    edge = made.profile.layers.edge
    middle = 0.5 * (edge[1:] + edge[:-1])
    thermometers = (sensors.Thermometer, sensors.Temperatures)
    has_temperature = _is_between_readings(middle, made, thermometers, WIDEST_GAP_M)
    has_pressure = _is_between_readings(middle, made, (sensors.Barometer,), 2.0 * WIDEST_GAP_M)
    sigma = made.covariance.sigma_temperature(made.profile.break_heights_m)
    is_learnt = sigma < estimate_checks.UNCHANGED * made.background_sigma_k
    by_neighbours = np.where(is_learnt[1:] | is_learnt[:-1], RELAXED, STANDARD)
    by_pressure = np.where(has_pressure, BAROMETRIC, by_neighbours)
    source = np.where(has_temperature, MEASURED, by_pressure)
    return tuple(str(name) for name in source)


def _is_between_readings(
    height: Array,
    made: Estimate,
    kinds: tuple[type, ...],
    widest_m: float,
) -> Mask:
    """Which heights (n,) [m'] are between readings of these kinds at most ``widest_m`` apart."""
    heights_of_sets = [np.array([-np.inf, np.inf])]  # so that each height has two neighbours
    for readings in made.readings.sets:
        if isinstance(readings, kinds):
            heights_of_sets.append(readings.height)
    read_at = np.sort(np.concatenate(heights_of_sets))
    next_above = np.searchsorted(read_at, height)
    return np.asarray(read_at[next_above] - read_at[next_above - 1] <= widest_m)


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard with the normal gravity of a latitude; its layers in geopotential height stay."""
    return replace(standard, gravity=normal_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """An unchanged standard atmosphere as the result, with the reason in words."""
    return Adjustment(standard, standard, UNADJUSTED, reason)


def _notes(candidate: Candidate, made: Estimate) -> Iterator[Message]:
    """Messages on an estimate.

    What replaces a missing thermometer or hygrometer, a failed convergence, sensor faults that the
    flight determined, readings that do not fit, and outliers.
    """
    if candidate.basis == "barometer":
        where = candidate.main.name if candidate.main else ""
        yield messages.air_barometric(where=where, reason=candidate.reason)
    if not any(isinstance(readings, sensors.Humidities) for readings in made.readings.sets):
        yield messages.air_humidity_expected()
    if not made.converged:
        yield messages.air_unsettled()
    determined = []
    for fault in made.faults:
        if fault.sigma < _LEARNT_SHARE * fault.prior_sigma:
            determined.append(sensor_checks.described_fault(fault))
    if determined:
        yield messages.air_sensors(count=len(determined), faults="; ".join(determined))
    for fit in made.fits:
        yield from _misfit_notes(candidate, fit)
    yield from _outlier_notes(candidate, made)


def _misfit_notes(candidate: Candidate, fit: Fit) -> Iterator[Message]:
    """A message on a set of readings that does not fit the others; none if it fits."""
    is_never_inflated = fit.count < FEWEST_TO_INFLATE
    misfit = fit.rms if is_never_inflated else fit.sigma_inflation
    if misfit <= estimate_checks.MISFIT:
        return
    if is_never_inflated and fit.name in candidate.external.names:
        yield messages.air_contradicted(
            where=fit.name,
            count=fit.count,
            quantity=fit.quantity,
            rms=fit.rms,
        )
    else:
        yield messages.air_misfit(
            where=fit.name,
            count=fit.count,
            quantity=fit.quantity,
            rms=fit.rms,
            inflation=fit.sigma_inflation,
        )


def _outlier_notes(candidate: Candidate, made: Estimate) -> Iterator[Message]:
    """A message on the outliers of each sensor that has any."""
    for quantity, rejected in made.readings.rejected.items():
        count = int(np.count_nonzero(rejected == Reason.OUTLIER))
        if count:
            sensor = candidate.samples.sensors[quantity]
            total = int(sensor.accepted.sum())
            yield messages.air_outliers(where=sensor.name, count=count, total=total)
