"""How true the sigma of the flown air is when its sensors have faults: drawn flights, real air.

    python benchmarks/judge_faults.py [--flights N] [--seed N] [--climbs KM ...] [FAULT ...]

Draws flights with one fault of a sensor each through nine real ascents and five extreme airs
(`tests/atmosphere/flights.py`, which shares nothing with the estimator), estimates the air as a
mission does, and prints for each fault and climb the error of R at 45 degrees, its stated sigma,
and how many flights are beyond 4 sigma although the run would end with code 0. ``right`` flights
have usual sensors only; none of their exposures may be flagged.

A flight is *told* if the run ends with code 3, *lost* if an exposure is flagged, and *wrong* if
it errs by more than 4 sigma without being told. ``--errors`` prints the wrong flights.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.flight import stations as flight_stations
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.contradictions import examine
from unbend.messages import LOSSES, Ledger
from unbend.stages.air_of_mission import CameraHeights, profiles_in_time

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "atmosphere"))
import flights

CLIMBS_KM = (0.8, 1.0, 1.5, 2.0, 3.0)
US1976 = standard_atmosphere("us1976")
WRONG_SIGMAS = 4.0
EXPOSURES = 20  # while the flight is level
LONG_CRUISE_S = 3 * 3600.0  # of the flights in which the weather changes [s]
CRUISE_S = 300.0
WEATHER_PA_PER_3H = 150.0  # what pressure changes by in three hours, one sigma [Pa]
WEATHER_PA_PER_ROOT_H = 20.0  # of a random walk beside [Pa]
METRES_PER_RAD = 6_371_000.0


@dataclass(frozen=True)
class Flight:
    """A drawn flight: its air, what its sensors read, and the height that it climbs [m]."""

    truth: flights.Truth
    samples: AirSamples
    climb_m: float


Draw = Callable[[flights.Truth, float, np.random.Generator], Flight]


@dataclass(frozen=True)
class Outcome:
    """Error of R and its stated sigma [%], whether the run is told, and how many exposures are
    flagged."""

    air: str
    error: float
    sigma: float
    told: bool
    flagged: int
    basis: str
    codes: tuple[str, ...]

    @property
    def sigmas(self) -> float:
        """The error over its sigma."""
        return self.error / self.sigma

    @property
    def is_wrong(self) -> bool:
        """Whether it is sure and wrong, and nothing says so."""
        return not self.told and abs(self.sigmas) > WRONG_SIGMAS


# --- flights -------------------------------------------------------------------------------------


def fly_as_drawn(
    truth: flights.Truth,
    climb_m: float,
    rng: np.random.Generator,
    *,
    sensors: flights.Sensors | None = None,
    descent: bool | None = None,
    thermometer: bool | None = None,
    cruise_s: float = CRUISE_S,
) -> Flight:
    """A flight with usual sensors; what is not given is drawn.

    It climbs at 2 to 5 m/s, half of the flights come down again, and a quarter has no thermometer.
    """
    drawn_sensors = flights.drawn(rng)
    rate = rng.uniform(2.0, 5.0)
    comes_down = bool(rng.random() < 0.5)
    is_warm = bool(rng.random() < 0.75)
    samples = flights.fly(
        truth,
        climb_m,
        sensors or drawn_sensors,
        rng,
        thermometer=is_warm if thermometer is None else thermometer,
        humidity="none",
        rate=rate,
        cruise_s=cruise_s,
        descent=comes_down if descent is None else descent,
    )
    return Flight(truth, samples, climb_m)


def right(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """Usual sensors."""
    return fly_as_drawn(truth, climb_m, rng)


def surveyed(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """Usual sensors with the heights of a survey receiver."""
    return fly_as_drawn(truth, climb_m, rng, sensors=flights.surveyed(rng))


def in_a_bay(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """A thermometer partly in the outside air: T = 294 K - f (294 K - T_out), f of 0.2 to 0.7."""
    flight = fly_as_drawn(truth, climb_m, rng, thermometer=True)
    outside = flight.samples.temperature
    share = rng.uniform(0.2, 0.7)
    mixed = replace(outside, value=294.0 - share * (294.0 - outside.value))
    return replace(flight, samples=replace(flight.samples, temperature=mixed))


def in_another_bay(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """The same with a bay of 283 to 308 K, and f of 0.05 to 0.95."""
    flight = fly_as_drawn(truth, climb_m, rng, thermometer=True)
    outside = flight.samples.temperature
    share = rng.uniform(0.05, 0.95)
    bay_k = rng.uniform(283.0, 308.0)
    mixed = replace(outside, value=bay_k - share * (bay_k - outside.value))
    return replace(flight, samples=replace(flight.samples, temperature=mixed))


def warm_in_the_climb(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """A thermometer that reads 1 to 3 K more in the climb only: engine, sun."""
    flight = fly_as_drawn(truth, climb_m, rng, thermometer=True, descent=True)
    sensor = flight.samples.temperature
    seconds = (sensor.time_ns - sensor.time_ns[0]) * 1e-9
    up = np.gradient(sensor.h_m, seconds) > 0.0
    up = np.convolve(up, np.full(61, 1.0 / 61.0), mode="same") > 0.75
    warmer = rng.uniform(1.0, 3.0) * up
    sensor = replace(sensor, value=sensor.value + warmer)
    return replace(flight, samples=replace(flight.samples, temperature=sensor))


def coarse_barometer(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """A barometer that reads whole hectopascals, beside the heights of a survey receiver or not."""
    sensors = flights.surveyed(rng) if rng.random() < 0.5 else flights.drawn(rng)
    flight = fly_as_drawn(truth, climb_m, rng, sensors=sensors)
    sensor = flight.samples.pressure
    sensor = replace(sensor, value=100.0 * np.round(sensor.value / 100.0))
    return replace(flight, samples=replace(flight.samples, pressure=sensor))


def coarse_thermometer(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """A thermometer that reads whole kelvins."""
    flight = fly_as_drawn(truth, climb_m, rng, thermometer=True)
    sensor = flight.samples.temperature
    sensor = replace(sensor, value=np.round(sensor.value - 0.15) + 0.15)
    return replace(flight, samples=replace(flight.samples, temperature=sensor))


def leaking(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """A static pressure that loses 3 to 7 % of its change."""
    sensors = replace(flights.drawn(rng), pressure_scale=rng.uniform(0.03, 0.07))
    return fly_as_drawn(truth, climb_m, rng, sensors=sensors)


def long_and_level(truth: flights.Truth, climb_m: float, rng: np.random.Generator) -> Flight:
    """Three hours level after the climb, in which the weather changes, sooner or later; the log
    ends up there."""
    sensors = flights.surveyed(rng) if rng.random() < 0.5 else flights.drawn(rng)
    sensors = replace(sensors, pressure_ramp_pa=0.0)
    flight = fly_as_drawn(
        truth, climb_m, rng, sensors=sensors, descent=False, cruise_s=LONG_CRUISE_S
    )
    sensor = flight.samples.pressure
    hours = (sensor.time_ns - sensor.time_ns[0]) / 3.6e12
    memory_h = rng.uniform(0.5, 6.0)
    passed = -np.expm1(-hours / memory_h)
    change = rng.normal(0.0, WEATHER_PA_PER_3H) * passed / passed[-1]
    change += WEATHER_PA_PER_ROOT_H * np.cumsum(rng.normal(0.0, 1.0 / 60.0, hours.size))
    sensor = replace(sensor, value=sensor.value * (1.0 + change / 1e5))
    return replace(flight, samples=replace(flight.samples, pressure=sensor))


FAULTS: dict[str, Draw] = {
    "right": right,
    "surveyed": surveyed,
    "bay": in_a_bay,
    "any-bay": in_another_bay,
    "level": long_and_level,
    "coarse": coarse_barometer,
    "coarse-t": coarse_thermometer,
    "leak": leaking,
    "climb": warm_in_the_climb,
}


# --- what a mission makes of them ----------------------------------------------------------------


def channel_of(name: str, time_ns: np.ndarray, roles: tuple[str, ...], **columns) -> Channel:
    """A channel of a log."""
    instance = name.partition("[")[2].rstrip("]")
    return Channel(name, time_ns, columns, Source(name.partition("[")[0], instance), roles=roles)


def without_drifts(flight: Flight, ledger: Ledger) -> AirSamples:
    """The samples without the pressures that the evidence of the log speaks against."""
    pressure = flight.samples.pressure
    seconds = (pressure.time_ns - pressure.time_ns[0]) * 1e-9
    east_m = 30.0 * seconds
    receiver = channel_of(
        "GPS[0]",
        pressure.time_ns,
        ("height", "position"),
        lat_rad=np.full(seconds.size, flight.truth.latitude),
        lon_rad=flight.truth.longitude + east_m / METRES_PER_RAD / np.cos(flight.truth.latitude),
        h_msl_m=pressure.h_m,
        v_north_m_s=np.zeros(seconds.size),
        v_east_m_s=np.full(seconds.size, 30.0),
        v_down_m_s=-np.gradient(pressure.h_m, seconds),
    )
    barometer = channel_of("BARO[0]", pressure.time_ns, ("pressure",), pressure_pa=pressure.value)
    roles = {"position": receiver, "height": receiver, "pressure": barometer}
    examined, suspect, notes = examine([receiver, barometer], roles)
    ledger.extend(notes)
    kept = np.isin(pressure.time_ns, examined["pressure"].time_ns)
    for stretch in suspect:
        if stretch.quantity == "height":
            kept &= ~stretch.covers(pressure.time_ns)
    pressure = replace(
        pressure,
        time_ns=pressure.time_ns[kept],
        h_m=pressure.h_m[kept],
        value=pressure.value[kept],
        rejected=pressure.rejected[kept],
    )
    return replace(flight.samples, pressure=pressure)


def exposures_of(flight: Flight) -> flight_stations.Stations:
    """Exposures while the flight is at its height, with the pressures that were logged there."""
    pressure = flight.samples.pressure
    level = np.flatnonzero(pressure.h_m > pressure.h_m.max() - 30.0)
    rows = level[np.linspace(0, level.size - 1, EXPOSURES).round().astype(int)]
    names = np.array([f"image_{i}" for i in range(EXPOSURES)], object)
    empty = flight_stations.empty_stations(names, np.full(EXPOSURES, "camera", object), "ok")
    return replace(
        empty,
        time_ns=pressure.time_ns[rows],
        h_msl_m=pressure.h_m[rows],
        lat_rad=np.full(EXPOSURES, flight.truth.latitude),
        lon_rad=np.full(EXPOSURES, flight.truth.longitude),
        pressure_pa=pressure.value[rows],
    )


def outcome_of(flight: Flight) -> Outcome:
    """What a mission would make of a flight.

    It differs from a mission in one thing: the air of all its exposures is the same, so that no
    sigma grows with the distance on the flight's path.
    """
    truth = flight.truth
    ledger = Ledger()
    samples = without_drifts(flight, ledger)
    ground_m = float(truth.h[0])
    background = climatology(
        latitude_rad=truth.latitude,
        month=month_of(truth.start_ns),
        ground_h_m=ground_m,
        longitude_rad=truth.longitude,
        hour=truth.hour,
    )
    adjustment = build_adjusted_profile(
        samples,
        US1976,
        truth.latitude,
        ledger,
        background=background,
        time_ns=truth.start_ns,
        longitude_rad=truth.longitude,
    )
    exposures = exposures_of(flight)
    levels = CameraHeights([ground_m + flight.climb_m] * 3, ground_m)
    air = profiles_in_time(adjustment, exposures, levels, None, ledger)
    flagged = 0
    if adjustment.is_measured:
        errors = adjustment.barometer_errors
        flagged_exposures = flight_stations.flag_height_misfits(exposures, air.series, errors)
        exposures = ledger.take(flagged_exposures)
        flagged = int(np.count_nonzero(~exposures.ok))
    middle = air.series.timed_profiles[air.series.profile_number[EXPOSURES // 2]]
    sigma = middle.covariance.relative_sigma(ground_m + flight.climb_m, ground_m)
    return Outcome(
        air=truth.name,
        error=100.0 * truth.error(middle.profile, flight.climb_m),
        sigma=100.0 * sigma,
        told=any(entry.kind in LOSSES for entry in ledger),
        flagged=flagged,
        basis=adjustment.basis,
        codes=tuple(sorted({entry.code for entry in ledger})),
    )


# --- figures -------------------------------------------------------------------------------------


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def print_row(label: str, rows: list[Outcome]) -> None:
    """One line of the table: of flights that are not told, errors and sigmas."""
    quiet = [row for row in rows if not row.told]
    error = np.array([row.error for row in quiet] or [np.nan])
    sigma = np.array([row.sigma for row in quiet] or [np.nan])
    wrong = sum(row.is_wrong for row in rows)
    lost = sum(row.flagged > 0 for row in rows)
    told = len(rows) - len(quiet)
    worst = max((abs(row.sigmas) for row in quiet), default=np.nan)
    print(
        f"{label:<18}{len(rows):>5}{rms(error):>8.2f}{np.median(sigma):>8.2f}"
        f"{rms(error / sigma):>9.2f}{worst:>8.1f}{wrong:>7}{told:>6}{lost:>6}",
        flush=True,
    )


def drawn_flights(fault: str, climb_m: float, number: int, seed: int) -> Iterator[Flight]:
    """Flights with a fault, in turn through each air."""
    airs = [flights.Truth(balloon) for balloon in (*flights.balloons(), *flights.extremes())]
    for i in range(number):
        rng = np.random.default_rng([seed, sorted(FAULTS).index(fault), round(climb_m), i])
        yield FAULTS[fault](airs[i % len(airs)], climb_m, rng)


def main() -> None:
    """Draw, estimate, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("faults", nargs="*", metavar="FAULT", help=", ".join(FAULTS))
    parser.add_argument("--flights", type=int, default=56, help="for each fault and climb")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--climbs", type=float, nargs="+", default=CLIMBS_KM, help="[km]")
    parser.add_argument("--errors", action="store_true", help="print the wrong flights")
    arguments = parser.parse_args()
    print(
        f"{'fault, climb':<18}{'n':>5}{'error%':>8}{'sigma%':>8}{'err/sig':>9}{'worst':>8}"
        f"{'wrong':>7}{'told':>6}{'lost':>6}"
    )
    for fault in arguments.faults or FAULTS:
        of_fault = []
        for climb_km in arguments.climbs:
            drawn = drawn_flights(fault, 1e3 * climb_km, arguments.flights, arguments.seed)
            rows = [outcome_of(flight) for flight in drawn]
            print_row(f"{fault}, {climb_km:g} km", rows)
            of_fault += rows
            bad = [row for row in rows if row.is_wrong or (row.flagged and not row.told)]
            for row in bad if arguments.errors else []:
                codes = ", ".join(row.codes)
                print(f"    {row.air}: {row.error:+.2f} +- {row.sigma:.2f} %, {row.basis}, {codes}")
        print_row(f"{fault}, all", of_fault)


if __name__ == "__main__":
    main()
