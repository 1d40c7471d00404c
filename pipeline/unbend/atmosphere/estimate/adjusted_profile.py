"""The locally adjusted profile: the climatology, adjusted to what the flight measured.

Sensors are checked, candidates are estimated in turn until one passes the checks of estimates, and
the result says in words why the profile is what it is. The estimate itself is made in `solver`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from unbend.atmosphere.air_samples import AirSamples, SensorUse, sensor_uses
from unbend.atmosphere.air_variation import solar_hour
from unbend.atmosphere.barometer_errors import NO_ERRORS, BarometerErrors
from unbend.atmosphere.climatology import Climatology, climatology, month_of
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate import (
    candidates,
    estimate_checks,
    messages,
    sensor_checks,
    sensors,
    thermometer_checks,
)
from unbend.atmosphere.estimate.candidates import Candidate, ExternalSources, SourceUse
from unbend.atmosphere.estimate.external_readings import TimeAndPlace, reason_uninformative
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.solver import Estimate, FaultEstimate, estimate
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.layers import BAROMETRIC, MEASURED, RELAXED, STANDARD, stack_layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.rejection import Reason, Reasons, with_reason
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.geodesy import normal_gravity
from unbend.messages import Ledger, Message, Notes
from unbend.units import Array, Mask

WIDEST_GAP_M = 400.0
"""Between two measured heights farther apart than this the layers are called relaxed [m']."""

FEWEST_TO_INFLATE = 5  # the estimator never inflates the sigmas of fewer readings
_NO_AIR_FITS = "with it, no air fits the measurements of the flight"
UNMEASURED, UNADJUSTED = "climatology", "standard"  # bases of a profile without any measurement


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A profile, and how it was made.

    ``basis`` is thermometer | both | barometer | sounding | surface | climatology | standard, and
    ``reason`` why; ``time_ns`` is the middle of the samples that were used. ``covariance`` is None
    for a standard as it is; ``rejected`` says of each sensor why samples are not used, also of one
    that is not used at all, and ``sensor_uses`` counts them; both are empty where nothing was
    estimated. ``samples``,
    ``settings`` and ``moisture`` are what the estimate was made from, None where there is none.
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
        """Whether the profile rests on any measurement."""
        return self.basis not in (UNMEASURED, UNADJUSTED)

    @property
    def barometer_errors(self) -> BarometerErrors:
        """Those that the flight has determined; none without a barometer."""
        if self.settings is None or self.settings.highest is None:
            return NO_ERRORS
        values = {fault.fault: fault.value for fault in self.faults}
        return BarometerErrors(
            offset_pa=values.get(SensorFault.PRESSURE_OFFSET, 0.0),
            lost_share=values.get(SensorFault.PRESSURE_SCALE, 0.0),
            highest_pa=math.exp(self.settings.highest),
        )


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
    utc_known: bool = True,
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

    Where nothing has enough information, or no estimate passes its checks, it is the background
    with its own sigma, and the reason.

    On nine real soundings (tests/atmosphere/test_estimate_montecarlo.py) the RMS error of R at
    1 / 3 / 6 / 10 km, where US 1976 errs by 20 / 13 / 7 / 7 %: clean sensors in climb and descent
    0.5 / 0.1 / 0.03 / 0.03 %; sensors with bias, lag, transient, drifts and outliers
    0.9 / 0.4 / 0.3 % at 1 / 3 / 6 km, in a climb alone 2.6 / 0.5 / 0.3 %; barometer and GNSS alone
    1.4 / 0.6 % at 3 / 6 km.
    """
    standard = under_gravity(standard, latitude_rad)
    middle = time_ns
    if utc_known:
        middles = (sensor.middle_ns for sensor in samples.sensors.values())
        middle = next((middle for middle in middles if middle is not None), time_ns)
    flight = TimeAndPlace(middle, latitude_rad, longitude_rad)
    expected = partial(
        climatology,
        latitude_rad=latitude_rad,
        month=month_of(middle),
        hour=solar_hour(middle, longitude_rad),
    )
    moisture = expected(index=standard.index)
    if background is None:
        background = replace(expected(standard.name), profile=standard)
    moisture = background if background.has_humidity else moisture
    samples, settings = ledger.take(
        sensor_checks.subtract_known_biases(samples, settings or SensorSettings())
    )
    usable = ledger.take(sensor_checks.usable_sensors(samples, standard))
    external = ExternalSources(tuple(soundings), tuple(surface))
    whys = {source.name: reason_uninformative(source, flight) for source in external.sources}
    unused = {name: why for name, why in whys.items() if why is not None}
    ledger.extend(messages.source_far(name=name, reason=why) for name, why in unused.items())
    near = [sounding for sounding in soundings if sounding.name not in unused]
    reports = [report for report in surface if report.name not in unused]
    make = partial(_estimate_of, background=background, moisture=moisture, flight=flight)
    try_all = partial(
        _first_that_passes, make=make, background=background, settings=settings, moisture=moisture
    )
    own = try_all(candidates.candidates(usable, (), ()))[0].passed if near else None
    against = estimate_checks.reasons_against(near, own and own[1], background, flight)
    ledger.extend(_refused_sources(against))
    unused |= against
    near = [sounding for sounding in near if sounding.name not in unused]
    choices = candidates.candidates(usable, near, reports)
    trials = ledger.take(try_all(choices))
    flown = candidates.UsedSamples(samples, usable, trials.tried, refused=trials.refused)
    usage = partial(
        candidates.source_usage, external=external, background=background, standard=standard.name
    )
    if trials.passed is None:
        is_standard = background.profile.name == standard.name
        kept = "standard atmosphere" if is_standard else "climatology"
        kept = f"the {kept} {background.profile.name}"
        reason = candidates.reason_unadjusted(usable, trials.faults, kept)
        ledger.add(messages.air_standard(reason=reason))
        ledger.extend(sensor_checks.unused_calibration(set(settings.calibration)))
        air = covariance_of_background(background)
        basis, uses = UNADJUSTED if is_standard else UNMEASURED, usage(flown, (), unused=unused)
        rejected = _rejected_samples(samples, usable, {})
        return Adjustment(
            air.profile, standard, basis, reason, None, air, sources=uses,
            rejected=rejected, sensor_uses=sensor_uses(samples, rejected), utc_known=utc_known,
        )  # fmt: skip
    candidate, made = trials.passed
    misfits = dict.fromkeys(candidate.external.left_out, _NO_AIR_FITS)
    ledger.extend(_refused_sources(misfits))
    unused |= misfits
    profile = replace(made.profile, layers=replace(made.profile.layers, source=_sources(made)))
    ledger.add(sensor_checks.pressure_level(profile, background, candidate.samples.pressure))
    ledger.extend(_notes(candidate, made))
    ledger.extend(sensor_checks.maybe_in_a_bay(made, candidate.samples))
    ledger.extend(
        sensor_checks.check_calibration(made, settings, lambda s: make(candidate, settings=s))
    )
    for readings in made.readings.sets:
        if isinstance(readings, sensors.Barometer):  # pressure changes since here, in parts too
            settings = replace(settings, highest=readings.highest)
    uses = usage(replace(flown, used=candidate.samples), made.fits, unused=unused)
    rejected = _rejected_samples(samples, usable, made.readings.rejected)
    return Adjustment(
        profile, standard, candidate.basis, candidate.reason,
        None if candidate.main is None else candidate.main.middle_ns,
        replace(made.covariance, profile=profile), made.faults, uses,
        rejected, sensor_uses(samples, rejected),
        samples=candidate.samples, settings=settings, moisture=moisture, utc_known=utc_known,
    )  # fmt: skip


def _rejected_samples(
    given: AirSamples, usable: AirSamples, of_estimate: Mapping[str, Reasons]
) -> dict[str, Reasons]:
    """Why samples of each sensor are not used; of one that the estimate lacks, none is."""
    rejected: dict[str, Reasons] = {}
    for quantity, sensor in given.sensors.items():
        if quantity in of_estimate:
            rejected[quantity] = of_estimate[quantity]
            continue
        checked = usable.sensors.get(quantity, sensor)
        every = np.ones(checked.rejected.shape, np.bool_)
        rejected[quantity] = with_reason(checked.rejected, every, Reason.SENSOR_NOT_USED)
    return rejected


@dataclass(frozen=True, eq=False)
class _Trials:
    """The samples of the estimates that were ``tried``, why they failed, and the one that
    ``passed``; ``refused`` are the sensors that are not used, by their quantity, and why."""

    tried: Sequence[AirSamples]
    faults: Sequence[str]
    refused: Mapping[str, str]
    passed: tuple[Candidate, Estimate] | None = None


def _first_that_passes(
    choices: Sequence[Candidate],
    make: Callable[..., Estimate],
    background: Climatology,
    settings: SensorSettings,
    moisture: Climatology,
) -> tuple[_Trials, Notes]:
    """The first estimate that passes its checks."""
    remaining, notes = list(choices), list[Message]()
    tried, faults, refused = list[AirSamples](), list[str](), dict[str, str]()
    while remaining:
        candidate = remaining.pop(0)
        tried.append(candidate.samples)
        made = make(candidate, settings=settings)
        name = candidate.main.name if candidate.main is not None else ""
        check = thermometer_checks.thermometer_is_outside(
            candidate.samples, made, background, moisture, settings
        )
        if not check and candidate.main is not None:
            remaining = [other for other in remaining if other.samples.temperature is None]
            refused["temperature"] = check.reason
            notes.append(messages.thermometer_not_used(name=name, reason=check.reason))
        elif not (check := estimate_checks.hygrometer_is_outside(made, moisture)):
            humidity = candidate.samples.humidity
            name = humidity.name if humidity is not None else ""
            refused["humidity"] = check.reason
            notes.append(messages.hygrometer_not_used(name=name, reason=check.reason))
            remaining = [
                replace(other, samples=replace(other.samples, humidity=None))
                for other in (candidate, *remaining)
            ]
            continue
        elif candidate.basis == "barometer" and not (
            check := estimate_checks.has_information(made, background, moisture)
        ):
            check = estimate_checks.Check(f"{candidate.reason}, but {check.reason}")
            remaining = [other for other in remaining if other.basis != "barometer"]
        else:
            check = estimate_checks.is_plausible(made, background)
            check = check and estimate_checks.is_better_than_background(made, background, moisture)
            if check:
                return _Trials(tried, faults, refused, (candidate, made)), tuple(notes)
            notes.append(
                messages.air_implausible(sources=candidate.reason, reason=check.reason, sensor=name)
            )
        faults.append(check.reason)
    return _Trials(tried, faults, refused), tuple(notes)


def _refused_sources(reasons: Mapping[str, str]) -> Iterator[Message]:
    """What is reported of sources that contradict others, by their names."""
    for name, reason in reasons.items():
        yield messages.source_refused(name=name, reason=reason)


def covariance_of_background(background: Climatology) -> ProfileCovariance:
    """Of the background as it is, in layers fine enough to carry its covariance."""
    made, profile = estimate(AirSamples(), background), background.profile
    edge = made.profile.layers.edge
    t_m, _, vapour = profile.state(profile.gravity.height(edge))
    layers = stack_layers(
        edge, t_m, vapour, (STANDARD,) * (edge.size - 1),
        anchor=(0.0, float(profile.pressure(0.0))), constant=profile.constant,
    )  # fmt: skip
    return replace(made.covariance, profile=replace(profile, layers=layers))


def _estimate_of(candidate: Candidate, **how: Any) -> Estimate:
    """The estimate from a candidate's samples and sources; ``how`` as `estimate` takes it."""
    external = candidate.external
    return estimate(
        candidate.samples, soundings=external.soundings, surface=external.surface, **how
    )


def _sources(made: Estimate) -> tuple[str, ...]:
    """Source of each layer: a thermometer's heights, a barometer's, neighbours, or nothing."""
    edge = made.profile.layers.edge
    middle = 0.5 * (edge[1:] + edge[:-1])

    def covered(kinds: tuple[type, ...], widest: float) -> Mask:
        """Between two readings of some kinds, at most ``widest`` apart."""
        heights = [s.height for s in made.readings.sets if isinstance(s, kinds)]
        at: Array = np.sort(np.concatenate([*heights, [-np.inf, np.inf]]))
        above = np.searchsorted(at, middle)
        return np.asarray(at[above] - at[above - 1] <= widest)

    warm = covered((sensors.Thermometer, sensors.Temperatures), WIDEST_GAP_M)
    weighed = covered((sensors.Barometer,), 2.0 * WIDEST_GAP_M)
    sigma = made.covariance.sigma_temperature(made.profile.break_heights_m)
    learnt = sigma < estimate_checks.UNCHANGED * made.background_sigma_k
    between = np.where(learnt[1:] | learnt[:-1], RELAXED, STANDARD)
    source = np.where(warm, MEASURED, np.where(weighed, BAROMETRIC, between))
    return tuple(str(name) for name in source)


def under_gravity(standard: Profile, latitude_rad: float) -> Profile:
    """A standard's layers in geopotential height, under the gravity of a latitude."""
    return replace(standard, gravity=normal_gravity(latitude_rad))


def unadjusted(standard: Profile, reason: str) -> Adjustment:
    """A standard atmosphere in the place of an adjusted profile, with the reason in words."""
    return Adjustment(standard, standard, UNADJUSTED, reason)


def _notes(candidate: Candidate, made: Estimate) -> Iterator[Message]:
    """Substitutes, estimated sensor faults, readings that do not fit, and outliers."""
    if candidate.basis == "barometer":
        where = candidate.main.name if candidate.main else ""
        yield messages.air_barometric(where=where, sources=candidate.reason)
    if not any(isinstance(readings, sensors.Humidities) for readings in made.readings.sets):
        yield messages.air_humidity_expected()
    if not made.converged:
        yield messages.air_unsettled()
    learnt = [f for f in made.faults if f.sigma < 0.7 * f.prior_sigma]
    if learnt:
        faults = "; ".join(sensor_checks.described_fault(fault) for fault in learnt)
        yield messages.air_sensors(count=len(learnt), faults=faults)
    for fit in made.fits:
        few = fit.count < FEWEST_TO_INFLATE
        if (fit.rms if few else fit.sigma_inflation) <= estimate_checks.MISFIT:
            continue
        if few and fit.name in candidate.external.names:
            yield messages.air_contradicted(
                where=fit.name, count=fit.count, quantity=fit.quantity, rms=fit.rms
            )
        else:
            yield messages.air_misfit(
                where=fit.name,
                count=fit.count,
                quantity=fit.quantity,
                rms=fit.rms,
                inflation=fit.sigma_inflation,
            )
    for name, rejected in made.readings.rejected.items():
        if count := int(np.count_nonzero(rejected == Reason.OUTLIER)):
            sensor = getattr(candidate.samples, name)
            total = int(sensor.accepted.sum())
            yield messages.air_outliers(where=sensor.name, count=count, total=total)
