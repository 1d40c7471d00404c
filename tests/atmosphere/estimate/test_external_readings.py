"""Age and distance of soundings and reports: what they cost, and what is left out and said."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import climatology
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.estimate.candidates import candidates
from unbend.atmosphere.estimate.external_readings import (
    UNPLACED_M,
    TimeAndPlace,
    distance_notes,
    hours_and_metres,
    humidity_growth,
    reason_uninformative,
    sounding_departures,
    surface_readings,
)
from unbend.atmosphere.estimate.readings import collect_readings
from unbend.atmosphere.estimate.sensors import SensorSettings
from unbend.atmosphere.estimate.state import Layout, joint_covariance
from unbend.atmosphere.soundings import ColumnErrors, Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Kind, Ledger

HOUR = 3_600 * 10**9
US1976 = standard_atmosphere("us1976")


def place(north: float, east: float) -> tuple[float, float]:
    return math.radians(north), math.radians(east)


@pytest.mark.parametrize(
    ("here", "there", "km"),
    [
        ((0.0, 0.0), (90.0, 0.0), 10_002.0),  # the quarter meridian of WGS 84
        ((40.64, -73.78), (51.47, -0.45), 5_555.0),  # New York to London, by WGS 84 geodesic
        ((0.0, 179.5), (0.0, -179.5), 111.3),  # across the date line
        ((47.4, 8.0), (47.4, 8.0), 0.0),
    ],
)
def test_distances(here, there, km):
    assert TimeAndPlace(0, *place(*here)).metres_from(*place(*there)) == pytest.approx(
        1e3 * km, rel=5e-3, abs=1.0
    )


def test_what_is_not_known_is_not_near():
    nowhere = TimeAndPlace(0)
    assert math.isnan(nowhere.metres_from(*place(47.0, 8.0)))
    assert math.isnan(nowhere.hours_from(None))
    here = TimeAndPlace(0, *place(47.0, 8.0))
    assert math.isnan(here.metres_from(math.radians(57.0), math.nan))


@pytest.mark.parametrize(("north", "km"), [(47.0, 100.0), (57.0, 1112.0)])
def test_a_column_without_a_longitude_is_not_at_the_flight(ascents, north, km):
    """Its latitude alone tells how far it is at least."""
    column = balloon_of(ascents["2023"], latitude_rad=math.radians(north), longitude_rad=math.nan)
    _, metres = hours_and_metres(column, TimeAndPlace(0, *place(47.0, 8.0)))
    assert metres == pytest.approx(1e3 * km, rel=5e-3)


def test_a_distance_counts_twice_across_a_coast(ascents):
    """A knot's variance grows with the distance, and more across a coast or a ridge."""
    truth = ascents["2023"]
    near = balloon_of(truth, latitude_rad=truth.latitude, longitude_rad=0.0)
    here = TimeAndPlace(near.time_ns, truth.latitude, 0.0)
    air = background_of(truth)

    def variance(km: float, *, across: bool = False) -> np.ndarray:
        north = truth.latitude + 1e3 * km / 6.371e6
        balloon = replace(near, latitude_rad=north, across=across)
        return np.diag(sounding_departures([balloon], air, here)[0].covariance(air))

    own = 1.2**2 + 1e-4  # the error of a balloon, and what keeps the covariance regular
    assert variance(0.0) == pytest.approx(own)
    assert np.all(variance(100.0) > own + 0.2)
    assert variance(100.0, across=True) == pytest.approx(variance(200.0), rel=1e-6)


def test_two_soundings_share_their_error(ascents):
    """Of the same air: two of them on one side of the flight say hardly more than one."""
    truth = ascents["2023"]
    at = {"longitude_rad": 0.0}
    here = TimeAndPlace(truth.start_ns, truth.latitude, 0.0)
    air = background_of(truth)
    hours = (-12, -11, 12)
    balloons = [
        balloon_of(truth, time_ns=truth.start_ns + h * HOUR, latitude_rad=truth.latitude, **at)
        for h in hours
    ]
    departures = sounding_departures(balloons, air, here)
    assert [d.apart.hours for d in departures] == [12.0, 11.0, 12.0]
    between = [departures[0].beside[d.name].hours for d in departures[1:]]
    assert between == [1.0, 24.0]
    size = departures[0].knot.size
    layout = Layout(np.array([0.0, 3000.0]), np.array([0.0, 15e3]), 0.0, (), departures)
    joint = joint_covariance(air, layout.knot, departures)
    sigma = np.sqrt(np.diag(joint))
    correlation = (joint / np.outer(sigma, sigma))[2 : 2 + size, 2 + size :]
    row = size // 4  # some 3 km up
    assert correlation[row, row] > 0.6
    assert abs(correlation[row, size + row]) < 0.4


@pytest.mark.parametrize("across", [False, True])
def test_a_station_far_away_is_less_certain(flights, ascents, across):
    truth = ascents["2023"]
    report = replace(station(truth), sigma_temperature_k=0.0)
    here = TimeAndPlace(report.time_ns, truth.latitude, 0.0)

    def variances(distance_m: float) -> list[float]:
        of = replace(report, distance_m=distance_m, across=across)
        return [float(r.sigma[0]) ** 2 for r in surface_readings(of, background_of(truth), here)]

    grown = np.subtract(variances(3e4), variances(0.0))
    # Stations of one hour, 340 km apart in North America, differ by 4.8 K at the ground.
    of_30_km = 4.8**2 * 30.0 / 340.0
    assert grown[0] == pytest.approx((2.0 if across else 1.0) * of_30_km, rel=0.6)
    assert grown[1] == pytest.approx((1.5e-8 * 3e4) ** 2, rel=1e-6)
    assert grown[2] > 0.0


@pytest.mark.parametrize("hours", [2.0, 6.0, 18.0])
def test_an_old_humidity_weighs_what_it_is_worth(hours):
    """Air that forgets: truth and reading drawn with the correlation, and combined as we do."""
    rho = math.exp(-hours / 18.0)
    rng = np.random.default_rng(4)
    now = rng.normal(0.0, 0.3, 200_000)
    then = rho * now + math.sqrt(1.0 - rho**2) * rng.normal(0.0, 0.3, now.size)
    growth = humidity_growth(hours, 0.0)
    gain = 1.0 / (1.0 + growth)
    claimed = 0.3 * math.sqrt(1.0 - gain)
    assert np.std(gain * then - now) == pytest.approx(claimed, rel=0.12)


@pytest.mark.parametrize(
    ("hours", "east", "left_out"),
    [
        (0.0, 8.0, False),
        (150.0, 8.0, False),
        (240.0, 8.0, True),
        (0.0, 30.0, False),
        (0.0, 34.0, True),
        (150.0, 24.0, True),
    ],
)
def test_what_is_too_far_says_nothing(flights, hours, east, left_out):
    flight = TimeAndPlace(0, *place(47.0, 8.0))
    balloon = replace(
        balloon_of(flights.Truth(flights.extremes()[1])),
        time_ns=int(hours * HOUR),
        latitude_rad=place(47.0, east)[0],
        longitude_rad=place(47.0, east)[1],
    )
    assert (reason_uninformative(balloon, flight) is not None) is left_out
    if left_out:
        assert ("hours" in reason_uninformative(balloon, flight)) is (hours > 100.0)
        assert ("km" in reason_uninformative(balloon, flight)) is (east > 20.0)


@pytest.mark.parametrize("where", [(), place(47.0, 8.0), place(-80.0, -170.0)])
@pytest.mark.parametrize("hours", [0.0, 2.0, 100.0, 180.0])
def test_a_report_has_no_distance(where, hours):
    """It has no position: a station near the flight is meant, and its age alone counts."""
    flight = TimeAndPlace(10**18, *where)
    report = SurfaceReport(300.0, 95_000.0, 285.0, 900.0, 10**18 - int(hours * HOUR))
    assert hours_and_metres(report, flight) == (pytest.approx(hours, abs=1e-9), 0.0)
    assert reason_uninformative(report, flight) is None


def test_a_report_falls_silent_with_its_age_alone():
    """After 192 hours."""
    for hours, silent in ((191.9, False), (192.1, True)):
        report = SurfaceReport(300.0, 95_000.0, 285.0, 900.0, -int(hours * HOUR))
        told = reason_uninformative(report, TimeAndPlace(0))
        assert (told is not None) is silent
        assert not silent or "km" not in told


def test_what_is_not_known_of_a_sounding_is_taken_as_far(flights):
    unknown = replace(balloon_of(flights.Truth(flights.extremes()[1])), time_ns=None)
    assert hours_and_metres(unknown, TimeAndPlace(0, *place(47.0, 8.0))) == (6.0, UNPLACED_M)
    report = SurfaceReport(300.0, 95_000.0, 285.0, 900.0)
    assert hours_and_metres(report, TimeAndPlace(0)) == (3.0, 0.0)


def balloon_of(truth, **change) -> Sounding:
    pick = slice(0, None, 200)
    columns = {
        "h_m": truth.h[pick],
        "pressure_pa": truth.p[pick],
        "temperature_k": truth.t[pick],
        "vapour_pressure_pa": truth.e[pick],
        "time_ns": truth.start_ns,
        "station": "72357",
    }
    return Sounding(**(columns | change))


def background_of(truth):
    ground = float(truth.h[0])
    return climatology(latitude_rad=truth.latitude, month=5.5, ground_h_m=ground)


@pytest.fixture(scope="module")
def ascents(flights):
    """Barrow twice, 12 hours apart; Norman of 2023 and of 2011."""
    found = [flights.Truth(balloon) for balloon in flights.balloons()]
    return {"barrow": found[4], "barrow later": found[5], "2023": found[2], "2011": found[3]}


def adjusted(truth, samples=None, **more):
    ledger = Ledger()
    background = climatology(latitude_rad=truth.latitude, month=6.0)
    made = build_adjusted_profile(
        samples or AirSamples(),
        US1976,
        truth.latitude,
        ledger,
        background=background,
        **({"time_ns": truth.start_ns, "longitude_rad": 0.0} | more),
    )
    return made, ledger


def sigma_of_r(made, truth, climb=3000.0):
    return made.covariance.relative_sigma(truth.h[0] + climb, truth.h[0])


def codes(ledger, kind=None):
    return [entry.code for entry in ledger if kind is None or entry.kind is kind]


def test_the_age_of_a_sounding_counts_without_any_sensor(ascents):
    truth = ascents["2023"]
    sigmas = []
    for hours in (0, 24, 96):
        balloon = balloon_of(truth, time_ns=truth.start_ns - hours * HOUR)
        sigmas.append(sigma_of_r(adjusted(truth, soundings=[balloon])[0], truth))
    without, _ = adjusted(truth)
    sigmas.append(sigma_of_r(without, truth))
    for fresher, older in pairwise(sigmas):
        assert older > 1.05 * fresher, sigmas
    years = balloon_of(truth, time_ns=truth.start_ns - 12 * 365 * 24 * HOUR)
    made, ledger = adjusted(truth, soundings=[years])
    assert made.basis == "climatology"
    assert "AIR-SOURCE-FAR" in codes(ledger, Kind.LOSS)
    h = truth.h[:6000:100]
    assert made.profile.temperature(h) == pytest.approx(without.profile.temperature(h), abs=1e-6)
    (told,) = [use for use in made.sources if use.source.startswith("sounding 72357")]
    assert "the climatology is as accurate" in told.why_not


def test_a_sounding_of_another_day_is_no_worse_than_none(ascents):
    """12 years apart, over the same town in the same week of May."""
    truth = ascents["2011"]
    other = ascents["2023"]
    balloon = balloon_of(other, time_ns=truth.start_ns - 12 * 365 * 24 * HOUR)
    with_it = adjusted(truth, soundings=[balloon])[0]
    without = adjusted(truth)[0]
    assert truth.error(with_it.profile, 3000.0) == pytest.approx(
        truth.error(without.profile, 3000.0), abs=1e-9
    )


@pytest.mark.parametrize("backwards", [False, True])
def test_a_sounding_of_the_other_half_of_the_day(ascents, backwards):
    """Real air that was measured twice: errors stay inside the sigmas."""
    names = ["barrow", "barrow later"]
    truth, other = (ascents[name] for name in (names if backwards else names[::-1]))
    balloon = balloon_of(other, time_ns=truth.start_ns - 12 * HOUR)
    made, _ = adjusted(truth, soundings=[balloon])
    for climb in (1000.0, 3000.0, 6000.0):
        assert abs(truth.error(made.profile, climb)) < 2.0 * sigma_of_r(made, truth, climb)
    h = truth.h[100:8000:50]
    z = (made.profile.temperature(h) - truth.t[100:8000:50]) / made.covariance.sigma_temperature(h)
    assert 0.3 < math.sqrt(np.mean(z**2)) < 1.3


def test_an_old_sounding_does_not_spoil_a_fresh_one(ascents):
    truth = ascents["2023"]
    fresh, old = (balloon_of(truth, time_ns=truth.start_ns - age * HOUR) for age in (1, 72))
    alone, both = (adjusted(truth, soundings=s)[0] for s in ([fresh], [fresh, old]))
    assert 0.85 < sigma_of_r(both, truth) / sigma_of_r(alone, truth) <= 1.0
    # ... nor counts as much as it would if it were fresh too.
    twice = adjusted(truth, soundings=[fresh, replace(fresh, station="72358")])[0]
    assert sigma_of_r(twice, truth) < 0.97 * sigma_of_r(both, truth)


def test_the_place_of_a_sounding_counts(ascents):
    """Barrow's air is nothing to Oklahoma's; 500 km away it is something."""
    truth = ascents["2023"]
    arctic = balloon_of(
        ascents["barrow"],
        time_ns=truth.start_ns,
        latitude_rad=math.radians(71.29),
        longitude_rad=math.radians(-156.78),
    )
    made, ledger = adjusted(truth, soundings=[arctic], longitude_rad=math.radians(-97.44))
    assert made.basis == "climatology"
    assert "AIR-SOURCE-FAR" in codes(ledger, Kind.LOSS)
    sigmas = []
    for north in (0.0, 500.0, 1200.0):
        balloon = balloon_of(
            truth, latitude_rad=truth.latitude + north / 6371.0, longitude_rad=math.nan
        )
        sigmas.append(sigma_of_r(adjusted(truth, soundings=[balloon])[0], truth))
    assert sigmas[1] > 1.15 * sigmas[0]
    assert sigmas[2] > 1.05 * sigmas[1]


def test_what_has_no_time_or_place_is_told(flights):
    truth = flights.Truth(flights.extremes()[1])
    placed = {"latitude_rad": truth.latitude, "longitude_rad": 0.2}
    flight = TimeAndPlace(truth.start_ns, truth.latitude, 0.2)
    report = SurfaceReport(100.0, 1e5, 290.0, math.nan, origin="mission file")
    for change, given, expected in (
        (placed, report, ["SURFACE-UNDATED"]),
        (placed, replace(report, time_ns=truth.start_ns + 4 * HOUR), ["SURFACE-FAR-IN-TIME"]),
        (
            placed,
            replace(report, time_ns=truth.start_ns - 4 * HOUR, is_metar=True),
            ["METAR-FAR-IN-TIME"],
        ),
        (placed, replace(report, time_ns=truth.start_ns + 2 * HOUR), []),
        (placed | {"time_ns": None}, None, ["SOUNDING-UNDATED"]),
        ({}, None, ["SOUNDING-UNPLACED"]),
        (placed | {"longitude_rad": 0.25}, None, ["SOUNDING-FAR-AWAY"]),
        (placed | {"longitude_rad": 0.22}, None, []),
    ):
        ledger = Ledger()
        surface = [given] if given else []
        ledger.extend(distance_notes([balloon_of(truth, **change)], surface, flight))
        assert codes(ledger) == expected


# Stations on the ground


def station(truth, hours=0.0, dp=0.0, dt=0.0, **change) -> SurfaceReport:
    report = SurfaceReport(
        float(truth.h[0]),
        float(truth.p[0] + dp),
        float(truth.t[0] + dt),
        float(truth.e[0]),
        truth.start_ns - int(hours * HOUR),
        "mission file",
    )
    return replace(report, **change)


@pytest.mark.parametrize(("hours", "dp", "dt"), [(192.0, 3000.0, 8.0), (24.0, 1200.0, 0.0)])
@pytest.mark.parametrize("barometer", [True, False])
def test_weather_of_another_day_does_not_outvote_the_flight(
    flights, ascents, hours, dp, dt, barometer
):
    truth = ascents["2023"]
    samples = flights.fly(
        truth,
        3000.0,
        flights.REALISTIC,
        np.random.default_rng(1),
        barometer=barometer,
        descent=True,
    )
    made, ledger = adjusted(truth, samples, surface=[station(truth, hours, dp, dt)])
    assert made.basis == "thermometer"
    assert "AIR-IMPLAUSIBLE" not in codes(ledger)
    h = truth.h[:3000:100]
    off = np.log(made.profile.pressure(h) / truth.p[:3000:100])
    assert np.all(np.abs(off) < 2.0 * made.covariance.sigma_log_pressure(h))
    assert abs(truth.error(made.profile, 3000.0)) < 2.0 * sigma_of_r(made, truth)


def test_a_station_is_worth_its_kelvin_and_half_a_hectopascal(ascents):
    """Alone it fixes T and p where it stands, to what it differs from the free air by."""
    truth = ascents["2023"]
    made, _ = adjusted(truth, surface=[station(truth)])
    ground = truth.h[:1]
    assert 1.3 < made.covariance.sigma_temperature(ground).item() < 1.7
    assert 5e-4 < made.covariance.sigma_log_pressure(ground).item() < 9e-4
    aged, _ = adjusted(truth, surface=[station(truth, 6.0)])
    # The prior of 6 K with 1.6 K, and 3 K of six hours somewhere in the day; 3 hPa of them.
    assert 2.2 < aged.covariance.sigma_temperature(ground).item() < 3.7
    assert 2.5e-3 < aged.covariance.sigma_log_pressure(ground).item() < 3.5e-3
    rounded, _ = adjusted(truth, surface=[station(truth, sigma_temperature_k=3.0)])
    assert rounded.covariance.sigma_temperature(ground).item() > 2.7


def test_qnh_taken_for_the_pressure_of_the_station(flights, ascents):
    truth = ascents["2023"]
    rng = np.random.default_rng(1)
    samples = flights.fly(truth, 3000.0, flights.REALISTIC, rng, descent=True)
    qnh = float(truth.p[0] * (np.exp(truth.h[0] / 8200.0) - 1.0))
    made, ledger = adjusted(truth, samples, surface=[station(truth, dp=qnh)])
    h = truth.h[:3000:100]
    off = np.log(made.profile.pressure(h) / truth.p[:3000:100])
    assert np.all(np.abs(off) < 2.0 * made.covariance.sigma_log_pressure(h))
    (told,) = [e for e in ledger if e.code == "AIR-CONTRADICTED"]
    assert told.kind is Kind.FINDING
    assert "(pressure)" in told.what
    assert "robust weights reduce its influence" in told.what
    assert abs(truth.error(made.profile, 3000.0)) < 2.0 * sigma_of_r(made, truth)


def test_a_station_of_years_ago_is_left_out(ascents):
    truth = ascents["2023"]
    made, ledger = adjusted(truth, surface=[station(truth, 24.0 * 365.0)])
    assert made.basis == "climatology"
    assert "AIR-SOURCE-FAR" in codes(ledger, Kind.LOSS)


def test_a_column_brings_errors_of_its_own(ascents):
    """Where they are 4 K, the climatology has a share; their length is that of the covariance."""
    truth = ascents["2023"]
    own = np.where(truth.h[::200] < 3000.0, 1.0, 4.0)
    at = np.array([1000.0, 7000.0])
    between = []
    for length in (200.0, 20_000.0):
        errors = ColumnErrors(own, 0.15, temperature_length_m=length)
        here = {"latitude_rad": truth.latitude, "longitude_rad": 0.0}
        column = balloon_of(truth, station="own", kind="model", errors=errors, **here)
        made, _ = adjusted(truth, soundings=[column])
        assert made.basis == "model"
        sigma = made.covariance.sigma_temperature(at)
        assert sigma[0] == pytest.approx(1.0, rel=0.25)
        assert 1.6 < sigma[1] < 4.0
        edge = made.profile.layers.edge
        rows = [int(np.argmin(np.abs(edge - h))) for h in (1000.0, 2000.0)]
        part = made.covariance.matrix[np.ix_(rows, rows)]
        between.append(part[0, 1] / np.sqrt(part[0, 0] * part[1, 1]))
    assert between[0] < 0.3
    assert between[1] > between[0] + 0.1


# Balloons that are wrong


def test_a_balloon_higher_than_the_climatology(ascents, flights):
    truth = ascents["2023"]
    h = np.arange(400.0, 34_000.0, 200.0)
    t = np.maximum(288.15 - 0.0065 * h, 216.65)
    p = 101_325.0 * np.exp(-np.cumsum(np.r_[400.0, np.diff(h)] * 0.0341632 / t))
    balloon = Sounding(h, p, t, np.full(h.size, 1.0), truth.start_ns, "high")
    background = climatology(latitude_rad=truth.latitude, month=6.0)
    assert (
        collect_readings(AirSamples(), background, SensorSettings(), soundings=[balloon]).high
        < background.profile.layers.edge[-1]
    )
    made, ledger = adjusted(truth, soundings=[balloon])
    assert made.basis == "sounding"
    assert codes(ledger, Kind.LOSS) == []
    high = np.array([15_000.0, 25_000.0, 29_500.0])
    assert made.profile.temperature(high) == pytest.approx(np.interp(high, h, t), abs=2.5)
    samples = flights.fly(truth, 3000.0, flights.REALISTIC, np.random.default_rng(1), descent=True)
    own = balloon_of(truth, h_m=truth.h[::200] * 1.0)
    grown = np.concatenate([own.h_m, np.arange(own.h_m[-1] + 500.0, 34_000.0, 500.0)])
    warm = np.concatenate([own.temperature_k, np.full(grown.size - own.h_m.size, 220.0)])
    thin = np.exp(-(grown[own.h_m.size :] - own.h_m[-1]) * 0.0341632 / 220.0)
    levels = Sounding(
        grown,
        np.concatenate([own.pressure_pa, own.pressure_pa[-1] * thin]),
        warm,
        np.concatenate([own.vapour_pressure_pa, 0.1 * np.ones(thin.size)]),
        truth.start_ns,
        "high",
    )
    beside, ledger = adjusted(truth, samples, soundings=[levels])
    assert beside.basis == "thermometer"
    assert codes(ledger, Kind.LOSS) == []
    assert abs(truth.error(beside.profile, 3000.0)) < 0.01
    assert sigma_of_r(beside, truth) < 0.006


@pytest.mark.parametrize(("above", "per_km"), [(4000.0, 15.0), (3500.0, -10.0)])
def test_a_bad_balloon_does_not_cost_the_flight(flights, ascents, above, per_km):
    """One that goes wrong smoothly, far above the flight: what jumps is outvoted anyway."""
    truth = ascents["2023"]
    samples = flights.fly(truth, 3000.0, flights.REALISTIC, np.random.default_rng(1), descent=True)
    alone, _ = adjusted(truth, samples)
    good = balloon_of(truth, station="good")
    bad = balloon_of(truth, station="bad")
    wrong = np.maximum(bad.h_m - above, 0.0) / 1e3
    bad = replace(bad, temperature_k=bad.temperature_k + per_km * wrong)
    made, ledger = adjusted(truth, samples, soundings=[bad])
    assert made.basis == "thermometer"
    assert made.reason.endswith(f"without {bad.name}")
    assert truth.error(made.profile, 3000.0) == truth.error(alone.profile, 3000.0)
    (lost,) = [entry for entry in ledger if entry.code == "AIR-SOURCE-REFUSED"]
    assert lost.kind is Kind.LOSS
    assert lost.where == bad.name
    uses = {use.source: use.why_not for use in made.sources}
    assert "no air fits" in uses[bad.name]
    # A good one beside it stays.
    both, ledger = adjusted(truth, samples, soundings=[good, bad])
    assert good.name not in [e.where for e in ledger if e.code == "AIR-SOURCE-REFUSED"]
    assert any(use.source == good.name and use.fit is not None for use in both.sources)
    assert abs(truth.error(both.profile, 3000.0)) < 0.005


@pytest.mark.parametrize(
    ("kelvin", "thermometer"), [(-8.0, True), (12.0, True), (-15.0, False), (15.0, False)]
)
def test_a_balloon_that_contradicts_the_flight_is_left_out(flights, ascents, kelvin, thermometer):
    """All its temperatures are wrong by so much, which a bias and a lost pressure would explain."""
    truth = ascents["2023"]
    rng = np.random.default_rng(1)
    how = {"descent": True, "thermometer": thermometer, "humidity": "none"}
    samples = flights.fly(truth, 3000.0, flights.surveyed(rng), rng, **how)
    alone, _ = adjusted(truth, samples)
    # Beside the flight: without a longitude it would be 100 km away, where air may be 2 K other.
    good = balloon_of(truth, latitude_rad=truth.latitude, longitude_rad=0.0)
    _, ledger = adjusted(truth, samples, soundings=[good])
    assert codes(ledger, Kind.LOSS) == []
    wrong = replace(good, temperature_k=good.temperature_k + kelvin)
    made, ledger = adjusted(truth, samples, soundings=[wrong])
    (lost,) = [entry for entry in ledger if entry.kind is Kind.LOSS]
    assert (lost.code, lost.where) == ("AIR-SOURCE-REFUSED", wrong.name)
    difference = float(re.search(r"are ([-+][\d.]+) K from those of the flight", lost.what)[1])
    assert difference == pytest.approx(kelvin, abs=2.5)
    assert truth.error(made.profile, 3000.0) == truth.error(alone.profile, 3000.0)
    (use,) = [use for use in made.sources if use.source == wrong.name]
    assert "one of both is wrong" in use.why_not


@pytest.mark.parametrize(
    ("metres", "kelvin", "what"),
    [(0.0, 0.0, None), (-550.0, 0.0, "may be above the ground"), (0.0, -32.0, "climatology")],
)
def test_a_balloon_that_no_climate_has_is_left_out(ascents, metres, kelvin, what):
    """Heights above ground, or air of another season; without any sensor of a flight."""
    truth = ascents["2023"]
    good = balloon_of(truth)
    wrong = replace(good, h_m=good.h_m + metres, temperature_k=good.temperature_k + kelvin)
    made, ledger = adjusted(truth, soundings=[wrong])
    lost = [entry for entry in ledger if entry.kind is Kind.LOSS]
    assert [entry.code for entry in lost] == ([] if what is None else ["AIR-SOURCE-REFUSED"])
    assert made.basis == ("sounding" if what is None else "climatology")
    assert what is None or what in lost[0].what


def test_sources_are_doubted_one_by_one_before_sensors_are(flights, ascents):
    truth = ascents["2023"]
    samples = flights.fly(truth, 3000.0, flights.Sensors(), np.random.default_rng(1))
    one = balloon_of(truth)
    other = balloon_of(truth, station="b")
    report = station(truth)
    found = candidates(samples, [one, other], [report])
    left_out = [(), (one.name,), (other.name,), (report.name,)]
    everything = (one.name, other.name, report.name)
    assert [b.external.left_out for b in found[:5]] == [*left_out, everything]
    assert all(b.samples is samples for b in found[:5])
    assert found[1].external.names == (other.name, report.name)
    assert all(b.basis == "barometer" and b.samples.temperature is None for b in found[5:10])
    assert all(b.samples.pressure is None for b in found[10:15])
    assert [
        b.external.left_out for b in found[15:]
    ] == left_out  # no sensor, and no source: nothing
    assert [b.basis for b in found[15:]] == ["sounding"] * 4
    assert len(candidates(samples, [one] * 6, [])) == 3 * 2 + 1
    assert [b.basis for b in candidates(AirSamples(), [], [report])] == ["surface"]


def test_the_reason_after_estimates_that_could_not_stand(flights, ascents):
    truth = ascents["2023"]
    bad = balloon_of(truth)
    bad = replace(bad, temperature_k=bad.temperature_k + 60.0)
    samples = flights.fly(
        truth, 3000.0, flights.REALISTIC, np.random.default_rng(1), barometer=False
    )
    wild = replace(samples.temperature, value=samples.temperature.value * 1.25)
    made, ledger = adjusted(truth, replace(samples, temperature=wild), soundings=[bad])
    assert made.basis == "climatology"
    (why,) = [entry.what for entry in ledger if entry.code == "AIR-STANDARD"]
    assert "no estimate passed its checks" in why
    assert "are needed" not in why
    uses = {use.source: use.why_not for use in made.sources}
    assert "no estimate with it passed its checks" in uses["thermometer thermometer"]
    assert "from the climatology of place and season" in uses[bad.name]
    short = flights.fly(truth, 250.0, flights.REALISTIC, np.random.default_rng(1), barometer=False)
    made, ledger = adjusted(truth, short)
    (why,) = [entry.what for entry in ledger if entry.code == "AIR-STANDARD"]
    assert "are needed" in why
    uses = {use.source: use.why_not for use in made.sources}
    assert "of height are too few" in uses["thermometer thermometer"]
