"""How true the sigmas of the air are: public ascents as truth, each source of the air by itself.

    python benchmarks/judge_air.py [--half 0|1] [--every N] [FOLDER]

Prints for each source and group the RMS of error over stated sigma of R at 45 degrees, and the
share beyond 3 sigma, for cameras 1, 3, 6 and 10 km above the ground; and the error that is left by
day without any source, beside that of US 1976. ``--half`` judges by one half of the ascents: put
what `fit_air.py --half` makes of the other into the package first. ``--every`` takes one flight in
N.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ascents import CLIMBS_M, FOLDER, Ascent, read_ascents

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.air_variation import solar_hour
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Ledger

HOUR_NS = 3600 * 10**9
DAY_HOURS = (8.0, 20.0)  # local time when photographs are taken [h]
NEAR_KM = 1000.0  # the nearest station of the same hour is not taken from farther away
US1976 = standard_atmosphere("us1976")


@dataclass(frozen=True)
class Judgement:
    """A source and a group, with error of R and its stated sigma at each climb [%]."""

    source: str
    group: str
    error: tuple[float, ...]
    sigma: tuple[float, ...]
    codes: tuple[str, ...]


def sounding_of(ascent: Ascent) -> Sounding:
    """An ascent as a mission would read it."""
    return Sounding(
        ascent.h_m,
        ascent.pressure_pa,
        ascent.temperature_k,
        ascent.vapour_pressure_pa,
        ascent.time_ns,
        ascent.name,
        ascent.latitude_rad,
        ascent.longitude_rad,
    )


def metar_of(ascent: Ascent) -> SurfaceReport:
    """What a METAR says of the lowest level: whole degrees, whole hPa."""
    kelvin = round(ascent.temperature_k[0] - 273.15) + 273.15
    return SurfaceReport(
        float(ascent.h_m[0]),
        round(ascent.pressure_pa[0], -2),
        kelvin,
        float(ascent.vapour_pressure_pa[0]),
        ascent.time_ns,
        is_metar=True,
    )


def background_of(ascent: Ascent):
    """The climatology of a flight at the place and time of an ascent, as a mission has it."""
    return climatology(
        latitude_rad=ascent.latitude_rad,
        month=month_of(ascent.time_ns),
        ground_h_m=float(ascent.h_m[0]),
        longitude_rad=ascent.longitude_rad,
        hour=solar_hour(ascent.time_ns, ascent.longitude_rad),
    )


def judged(truth: Ascent, source: str, soundings=(), surface=()) -> Judgement:
    """What a source says of the air of an ascent."""
    ledger = Ledger()
    adjusted = build_adjusted_profile(
        AirSamples(),
        US1976,
        truth.latitude_rad,
        ledger,
        background=background_of(truth),
        soundings=soundings,
        surface=surface,
        time_ns=truth.time_ns,
        longitude_rad=truth.longitude_rad,
    )
    errors = []
    sigmas = []
    ground = float(truth.h_m[0])
    for climb in CLIMBS_M:
        error = np.nan
        if truth.reaches(climb):
            error = truth.error(adjusted.profile, climb)
        sigma = adjusted.covariance.relative_sigma(ground + climb, ground)
        errors.append(100.0 * error)
        sigmas.append(100.0 * sigma)
    codes = tuple(entry.code for entry in ledger)
    return Judgement(source, truth.group, tuple(errors), tuple(sigmas), codes)


def flights_and_sources(
    ascents: list[Ascent], *, every: int, half: int | None
) -> Iterator[tuple[Ascent, str, list[Sounding], list[SurfaceReport]]]:
    """Each judged ascent with what would be known of its air."""
    flights = [ascent for ascent in ascents if half in (None, ascent.half)]
    for truth in flights[::every]:
        yield truth, "climatology", [], []
        yield truth, "METAR", [], [metar_of(truth)]
        at_hours = soundings_of_place(truth, ascents)
        if -12 in at_hours:
            yield truth, "sounding, 12 h old", [at_hours[-12]], []
        if -24 in at_hours:
            yield truth, "sounding, 24 h old", [at_hours[-24]], []
        if -12 in at_hours and 12 in at_hours:
            yield truth, "soundings, 12 h before and after", [at_hours[-12], at_hours[12]], []
        neighbours = []
        for ascent in ascents:
            if ascent.time_ns == truth.time_ns and 1.0 < ascent.km_from(truth) < NEAR_KM:
                neighbours.append(ascent)
        if neighbours:
            nearest = min(neighbours, key=truth.km_from)
            yield truth, "nearest sounding of the hour", [sounding_of(nearest)], []


def soundings_of_place(truth: Ascent, ascents: list[Ascent]) -> dict[int, Sounding]:
    """Soundings at the place of an ascent, by the hours after it."""
    at_hours = {}
    for ascent in ascents:
        if ascent.km_from(truth) >= 1.0:
            continue
        later_h = (ascent.time_ns - truth.time_ns) / HOUR_NS
        for hours in (-12, -24, 12):
            if abs(later_h - hours) < 1.5:
                at_hours[hours] = sounding_of(ascent)
    return at_hours


def print_sigmas(rows: list[Judgement]):
    """RMS of error over sigma and the share beyond 3, of all and of each group."""
    heights = "".join(f"{climb / 1e3:>16g} km" for climb in CLIMBS_M)
    print(f"{'error/sigma: RMS (beyond 3, rms error %)':<58}{'n':>5}{heights}")
    for source in dict.fromkeys(row.source for row in rows):
        of_source = [row for row in rows if row.source == source]
        print_group(f"{source}: all", of_source)
        for group in dict.fromkeys(row.group for row in of_source):
            of_group = [row for row in of_source if row.group == group]
            print_group(f"{source}: {group}", of_group)
        codes: Counter[str] = Counter()
        for row in of_source:
            codes.update(set(row.codes))
        print("      " + ", ".join(f"{code} {count}" for code, count in sorted(codes.items())))


def print_group(label: str, rows: list[Judgement]):
    """RMS of error over sigma, the share beyond 3, and RMS of the error [%], by climb."""
    error = np.array([row.error for row in rows])
    ratio = error / np.array([row.sigma for row in rows])
    cells = ""
    for error_of_climb, ratio_of_climb in zip(error.T, ratio.T, strict=True):
        known = np.isfinite(ratio_of_climb)
        z = ratio_of_climb[known]
        rms_of_z = np.sqrt(np.mean(z**2))
        beyond = 100 * np.mean(np.abs(z) > 3)
        rms_of_error = np.sqrt(np.mean(error_of_climb[known] ** 2))
        cells += f"  {rms_of_z:5.2f} ({beyond:3.0f} %,{rms_of_error:4.1f})"
    print(f"{label:<58}{len(rows):>5}{cells}")


def print_by_day(ascents: list[Ascent]):
    """What the climatology leaves by day, beside US 1976: RMS and mean of the error of R [%]."""
    by_day = [a for a in ascents if DAY_HOURS[0] <= a.solar_hour <= DAY_HOURS[1]]
    print(f"climatology by day, error of R: RMS (mean) [%]; US 1976; {len(by_day)} ascents")
    airs = [background_of(ascent).profile for ascent in by_day]
    for climb in (500.0, 1000.0, 1500.0, 3000.0, 6000.0, 10_000.0):
        ours = []
        standard = []
        for ascent, air in zip(by_day, airs, strict=True):
            if ascent.reaches(climb):
                ours.append(ascent.error(air, climb))
                standard.append(ascent.error(US1976, climb))
        print(f"{climb / 1e3:>6g} km  {rms_and_mean(ours)}   {rms_and_mean(standard)}")


def rms_and_mean(errors: list[float]) -> str:
    percent = 100.0 * np.array(errors)
    rms = np.sqrt(np.mean(percent**2))
    return f"{rms:5.1f} ({percent.mean():+5.1f})"


def main():
    """Read the ascents, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    parser.add_argument("--half", type=int, choices=(0, 1), help="judge by this half only")
    parser.add_argument("--every", type=int, default=1, help="one flight in so many")
    arguments = parser.parse_args()
    ascents = read_ascents(arguments.folder)
    print_by_day(ascents)
    cases = flights_and_sources(ascents, every=arguments.every, half=arguments.half)
    print_sigmas([judged(*case) for case in cases])


if __name__ == "__main__":
    main()
