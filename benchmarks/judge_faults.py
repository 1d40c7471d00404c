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
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.contradictions import examine
from unbend.flight.stations import Stations, empty_stations, flag_height_misfits
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
class Plan:
    """A flight to draw: its air, the height that it climbs [m], and the draws."""

    truth: flights.Truth
    climb_m: float
    rng: np.random.Generator

    def usual_sensors(self) -> flights.Sensors:
        """Beside the heights of a survey receiver or not."""
        if self.rng.random() < 0.5:
            return flights.surveyed(self.rng)
        return flights.drawn(self.rng)


@dataclass(frozen=True)
class Flight:
    """A drawn flight: its air, what its sensors read, and the height that it climbs [m]."""

    truth: flights.Truth
    samples: AirSamples
    climb_m: float

    def reading(self, sensor: str, values: np.ndarray) -> Flight:
        """The same flight with other readings of a sensor."""
        readings = replace(getattr(self.samples, sensor), value=values)
        samples = replace(self.samples, **{sensor: readings})
        return replace(self, samples=samples)


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
    plan: Plan,
    *,
    sensors: flights.Sensors | None = None,
    descent: bool | None = None,
    thermometer: bool | None = None,
    cruise_s: float = CRUISE_S,
) -> Flight:
    """A flight with usual sensors; what is not stated is drawn.

    It climbs at 2 to 5 m/s, half of the flights come down again, and a quarter has no thermometer.
    """
    drawn_sensors = flights.drawn(plan.rng)
    rate = plan.rng.uniform(2.0, 5.0)
    comes_down = bool(plan.rng.random() < 0.5)
    has_thermometer = bool(plan.rng.random() < 0.75)
    if descent is not None:
        comes_down = descent
    if thermometer is not None:
        has_thermometer = thermometer
    samples = flights.fly(
        plan.truth,
        plan.climb_m,
        sensors or drawn_sensors,
        plan.rng,
        thermometer=has_thermometer,
        humidity="none",
        rate=rate,
        cruise_s=cruise_s,
        descent=comes_down,
    )
    return Flight(plan.truth, samples, plan.climb_m)


def surveyed(plan: Plan) -> Flight:
    """Usual sensors with the heights of a survey receiver."""
    return fly_as_drawn(plan, sensors=flights.surveyed(plan.rng))


def in_a_bay(plan: Plan) -> Flight:
    """A thermometer partly in the outside air: T = 294 K - f (294 K - T_out), f of 0.2 to 0.7."""
    flight = fly_as_drawn(plan, thermometer=True)
    outside_k = flight.samples.temperature.value
    share = plan.rng.uniform(0.2, 0.7)
    return flight.reading("temperature", 294.0 - share * (294.0 - outside_k))


def in_another_bay(plan: Plan) -> Flight:
    """The same with a bay of 283 to 308 K, and f of 0.05 to 0.95."""
    flight = fly_as_drawn(plan, thermometer=True)
    outside_k = flight.samples.temperature.value
    share = plan.rng.uniform(0.05, 0.95)
    bay_k = plan.rng.uniform(283.0, 308.0)
    return flight.reading("temperature", bay_k - share * (bay_k - outside_k))


def warm_in_the_climb(plan: Plan) -> Flight:
    """A thermometer that reads 1 to 3 K more in the climb only: engine, sun."""
    flight = fly_as_drawn(plan, thermometer=True, descent=True)
    sensor = flight.samples.temperature
    seconds = (sensor.time_ns - sensor.time_ns[0]) * 1e-9
    rises = np.gradient(sensor.h_m, seconds) > 0.0
    rising_share = np.convolve(rises, np.full(61, 1.0 / 61.0), mode="same")
    in_climb = rising_share > 0.75
    warmer_k = plan.rng.uniform(1.0, 3.0) * in_climb
    return flight.reading("temperature", sensor.value + warmer_k)


def coarse_barometer(plan: Plan) -> Flight:
    """A barometer that reads whole hectopascals."""
    flight = fly_as_drawn(plan, sensors=plan.usual_sensors())
    hectopascals = flight.samples.pressure.value / 100.0
    return flight.reading("pressure", 100.0 * np.round(hectopascals))


def coarse_thermometer(plan: Plan) -> Flight:
    """A thermometer that reads whole degrees."""
    flight = fly_as_drawn(plan, thermometer=True)
    kelvin = flight.samples.temperature.value
    return flight.reading("temperature", np.round(kelvin - 0.15) + 0.15)


def leaking(plan: Plan) -> Flight:
    """A static pressure that loses 3 to 7 % of its change."""
    sensors = flights.drawn(plan.rng)
    sensors = replace(sensors, pressure_scale=plan.rng.uniform(0.03, 0.07))
    return fly_as_drawn(plan, sensors=sensors)


def long_and_level(plan: Plan) -> Flight:
    """Three hours level after the climb, in which the weather changes, sooner or later; the log
    ends up there."""
    sensors = replace(plan.usual_sensors(), pressure_ramp_pa=0.0)
    flight = fly_as_drawn(plan, sensors=sensors, descent=False, cruise_s=LONG_CRUISE_S)
    sensor = flight.samples.pressure
    hours = (sensor.time_ns - sensor.time_ns[0]) / 3.6e12
    memory_h = plan.rng.uniform(0.5, 6.0)
    passed = -np.expm1(-hours / memory_h)
    change = plan.rng.normal(0.0, WEATHER_PA_PER_3H) * passed / passed[-1]
    steps = plan.rng.normal(0.0, 1.0 / 60.0, hours.size)
    change += WEATHER_PA_PER_ROOT_H * np.cumsum(steps)
    return flight.reading("pressure", sensor.value * (1.0 + change / 1e5))


FAULTS: dict[str, Callable[[Plan], Flight]] = {
    "right": fly_as_drawn,
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
    message, _, instance = name.partition("[")
    source = Source(message, instance.rstrip("]"))
    return Channel(name, time_ns, columns, source, roles=roles)


def receiver_of(flight: Flight) -> Channel:
    """The receiver's channel of a flight to the east at 30 m/s."""
    pressure = flight.samples.pressure
    latitude = flight.truth.latitude
    seconds = (pressure.time_ns - pressure.time_ns[0]) * 1e-9
    east_rad = 30.0 * seconds / METRES_PER_RAD
    return channel_of(
        "GPS[0]",
        pressure.time_ns,
        ("height", "position"),
        lat_rad=np.full(seconds.size, latitude),
        lon_rad=flight.truth.longitude + east_rad / np.cos(latitude),
        h_msl_m=pressure.h_m,
        v_north_m_s=np.zeros(seconds.size),
        v_east_m_s=np.full(seconds.size, 30.0),
        v_down_m_s=-np.gradient(pressure.h_m, seconds),
    )


def without_drifts(flight: Flight, ledger: Ledger) -> AirSamples:
    """The samples without the pressures that the evidence of the log speaks against."""
    pressure = flight.samples.pressure
    receiver = receiver_of(flight)
    barometer = channel_of(
        "BARO[0]",
        pressure.time_ns,
        ("pressure",),
        pressure_pa=pressure.value,
    )
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


def exposures_of(flight: Flight) -> Stations:
    """Exposures while the flight is at its height, with the pressures that were logged there."""
    pressure = flight.samples.pressure
    level = np.flatnonzero(pressure.h_m > pressure.h_m.max() - 30.0)
    numbers = np.linspace(0, level.size - 1, EXPOSURES).round()
    rows = level[numbers.astype(int)]
    images = np.array([f"image_{i}" for i in range(EXPOSURES)], object)
    cameras = np.full(EXPOSURES, "camera", object)
    empty = empty_stations(images, cameras, "ok")
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
    camera_m = ground_m + flight.climb_m
    levels = CameraHeights([camera_m] * 3, ground_m)
    air = profiles_in_time(adjustment, exposures, levels, None, ledger)
    flagged = 0
    if adjustment.is_measured:
        errors = adjustment.barometer_errors
        judged = flag_height_misfits(exposures, air.series, errors)
        exposures = ledger.take(judged)
        flagged = int(np.count_nonzero(~exposures.ok))
    number = air.series.profile_number[EXPOSURES // 2]
    middle = air.series.timed_profiles[number]
    sigma = middle.covariance.relative_sigma(camera_m, ground_m)
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


def print_row(label: str, rows: list[Outcome]):
    """One line of the table: of flights that are not told, errors and sigmas."""
    quiet = [(row.error, row.sigma) for row in rows if not row.told]
    error, sigma = np.array(quiet or [(np.nan, np.nan)]).T
    wrong = sum(row.is_wrong for row in rows)
    lost = sum(row.flagged > 0 for row in rows)
    told = sum(row.told for row in rows)
    ratio = error / sigma
    worst = np.abs(ratio).max()
    print(
        f"{label:<18}{len(rows):>5}{rms(error):>8.2f}{np.median(sigma):>8.2f}"
        f"{rms(ratio):>9.2f}{worst:>8.1f}{wrong:>7}{told:>6}{lost:>6}",
        flush=True,
    )


def print_wrong(rows: list[Outcome]):
    """Flights that are wrong, or have flagged exposures, although nothing tells it."""
    for row in rows:
        if row.is_wrong or (row.flagged and not row.told):
            codes = ", ".join(row.codes)
            print(f"    {row.air}: {row.error:+.2f} +- {row.sigma:.2f} %, {row.basis}, {codes}")


def drawn_flights(fault: str, climb_m: float, count: int, seed: int) -> Iterator[Flight]:
    """Flights with a fault, in turn through each air."""
    balloons = (*flights.balloons(), *flights.extremes())
    airs = [flights.Truth(balloon) for balloon in balloons]
    fault_number = sorted(FAULTS).index(fault)
    for i in range(count):
        rng = np.random.default_rng([seed, fault_number, round(climb_m), i])
        plan = Plan(airs[i % len(airs)], climb_m, rng)
        yield FAULTS[fault](plan)


def main():
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
        rows_of_fault = []
        for climb_km in arguments.climbs:
            drawn = drawn_flights(fault, 1e3 * climb_km, arguments.flights, arguments.seed)
            rows = [outcome_of(flight) for flight in drawn]
            rows_of_fault += rows
            print_row(f"{fault}, {climb_km:g} km", rows)
            if arguments.errors:
                print_wrong(rows)
        print_row(f"{fault}, all", rows_of_fault)


if __name__ == "__main__":
    main()
