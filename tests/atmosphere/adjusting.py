"""Estimates of air that is known: how a test asks for one, and by how much it errs."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.random import default_rng

from tests.atmosphere import flights
from tests.atmosphere.flights import Truth
from tests.helpers import with_code
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import Adjustment, build_adjusted_profile
from unbend.atmosphere.estimate.sensors import SensorCalibration
from unbend.atmosphere.estimate.state import SensorFault
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import LOSSES, Kind, Ledger

US1976 = standard_atmosphere("us1976")
NO_SENSORS = AirSamples()
HOUR_NS = 3_600 * 10**9
QUIET = flights.Sensors(noise_k=0.2)

ARCTIC, DESERT, MONSOON, TRADES, NIGHT = range(5)
"""Places of the five extreme airs."""


@cache
def real_airs():
    """Nine soundings of five sites."""
    return tuple(Truth(balloon) for balloon in flights.balloons())


@cache
def extreme_airs():
    """Five airs of straight lines, with inversions of 6 to 15 K."""
    return tuple(Truth(balloon) for balloon in flights.extremes())


def extreme(number):
    return extreme_airs()[number]


def all_airs():
    """Both; the soundings first."""
    return real_airs() + extreme_airs()


@dataclass(frozen=True)
class Adjusted:
    """An adjustment to air that is known, and what the ledger has of it."""

    made: Adjustment
    ledger: Ledger
    truth: Truth

    @property
    def basis(self):
        return self.made.basis

    @property
    def reason(self):
        return self.made.reason

    @property
    def profile(self):
        return self.made.profile

    @property
    def covariance(self):
        return self.made.covariance

    def error(self, climb_m):
        """Relative error of R from the top of the climb to the ground."""
        return self.truth.error(self.profile, climb_m)

    def sigma(self, climb_m):
        """The stated sigma of R, relative."""
        return sigma_of_r(self, self.truth, climb_m)

    def departure(self, climb_m):
        """The size of the error of R in its sigmas."""
        return abs(self.error(climb_m)) / self.sigma(climb_m)

    @property
    def losses(self):
        return self.codes(Kind.LOSS)

    @property
    def is_told(self):
        """Whether a run would end with exit code 3."""
        return any(message.kind in LOSSES for message in self.ledger)

    def codes(self, kind=None):
        return codes(self.ledger, kind)

    def entry(self, code, kind=None):
        """The only entry with this code, of this kind."""
        return entry(self.ledger, code, kind)

    def why_not(self, source):
        """Why a source is not used."""
        (reason,) = (use.why_not for use in self.made.sources if use.source == source)
        return reason


def expected_air(truth, **more):
    """The climatology of place and month."""
    return climatology(
        latitude_rad=truth.latitude,
        month=month_of(truth.start_ns),
        ground_h_m=truth.ground_m,
        **more,
    )


def adjust(truth, samples=NO_SENSORS, **options):
    """The air by these samples, about the climatology of place and month; ``options`` go before."""
    usual = {"background": expected_air(truth), "time_ns": truth.start_ns}
    ledger = Ledger()
    made = build_adjusted_profile(
        samples,
        US1976,
        truth.latitude,
        ledger,
        **usual | options,
    )
    return Adjusted(made, ledger, truth)


def flown(
    truth,
    climb_m,
    sensors=flights.REALISTIC,
    seed=1,
    **how,
):
    """What these sensors measure on a flight (`flights.fly`)."""
    return flights.fly(truth, climb_m, sensors, default_rng(seed), **how)


def drawn_flight(
    truth,
    climb_m,
    seed,
    sensors_of=flights.drawn,
    **how,
):
    """What drawn sensors measure on a flight."""
    rng = default_rng(seed)
    return flights.fly(truth, climb_m, sensors_of(rng), rng, **how)


NO_PRESSURE_LOST = {SensorFault.PRESSURE_SCALE: SensorCalibration(sigma=1e-5)}
"""Of clean readings: a static pressure that loses nothing of its change."""


def sigma_of_r(made, truth, climb_m):
    """The stated sigma of R, relative, of an estimate or an adjustment."""
    top_m = truth.ground_m + climb_m
    return made.covariance.relative_sigma(top_m, truth.ground_m)


def codes(ledger, kind=None):
    """The codes in a ledger, of one kind or of all."""
    return [message.code for message in ledger if kind in (None, message.kind)]


def entry(ledger, code, kind=None):
    """The only entry of a ledger with this code, of this kind."""
    entries = with_code(ledger, code)
    assert len(entries) == 1, codes(ledger)
    assert kind in (None, entries[0].kind)
    return entries[0]


def rms(values):
    mean_square = np.mean(np.square(values))
    return float(np.sqrt(mean_square))


def balloon_of(truth, step_m=200, **change):
    """A sounding that measured an air exactly, at the start of its flights."""
    levels = slice(0, None, step_m)
    columns = {
        "h_m": truth.h[levels],
        "pressure_pa": truth.p[levels],
        "temperature_k": truth.t[levels],
        "vapour_pressure_pa": truth.e[levels],
        "time_ns": truth.start_ns,
        "station": "72357",
    }
    return Sounding(**(columns | change))


def balloon_beside(truth, step_m=200, **change):
    """The same, which rose where the flight was."""
    place = {"latitude_rad": truth.latitude, "longitude_rad": 0.0}
    return balloon_of(truth, step_m, **place | change)


def fault_of(made, fault):
    """What was estimated of a fault of a sensor."""
    (estimated,) = (each for each in made.faults if each.fault is fault)
    return estimated


def station_at(truth, row=0):
    """A station that measured the pressure exactly, so many metres above the ground."""
    return SurfaceReport(
        truth.h[row],
        truth.p[row],
        math.nan,
        math.nan,
        truth.start_ns,
    )


def with_readings(samples, value, sensor="temperature"):
    """The same flight, on which one sensor read something else."""
    readings = replace(getattr(samples, sensor), value=value)
    return replace(samples, **{sensor: readings})


def warmer(samples, kelvin):
    """The same flight, on which the thermometer read so much more."""
    return with_readings(samples, samples.temperature.value + kelvin)


def seconds_of(samples):
    """Seconds of a flight's temperatures since the first of them."""
    time_ns = samples.temperature.time_ns
    return (time_ns - time_ns[0]) * 1e-9
