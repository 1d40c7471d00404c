"""Age and distance of soundings and reports: what they cost, and what is left out and said."""

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.atmosphere import flights
from tests.atmosphere.adjusting import (
    DESERT,
    HOUR_NS,
    NO_SENSORS,
    adjust,
    balloon_beside,
    balloon_of,
    codes,
    drawn_flight,
    expected_air,
    extreme,
    flown,
    real_airs,
    rms,
    with_readings,
)
from tests.helpers import with_code
from unbend.atmosphere.climatology import climatology
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
from unbend.atmosphere.estimate.state import joint_covariance
from unbend.atmosphere.soundings import ColumnErrors, Sounding
from unbend.atmosphere.surface_report import SurfaceReport
from unbend.messages import Kind

YEARS_H = 12 * 365 * 24
EARTH_KM = 6371.0


HERE = TimeAndPlace(0, *np.radians([47.0, 8.0]))


@pytest.fixture(scope="module")
def norman():
    """Norman, Oklahoma, in May 2023."""
    return real_airs()[2]


def over(truth):
    return TimeAndPlace(truth.start_ns, truth.latitude, 0.0)


@pytest.fixture(scope="module")
def desert_balloon():
    return balloon_of(extreme(DESERT))


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
    flight = TimeAndPlace(0, *np.radians(here))
    metres = flight.metres_from(*np.radians(there))
    assert metres == pytest.approx(1e3 * km, rel=5e-3, abs=1.0)


def test_what_is_not_known_is_not_near():
    nowhere = TimeAndPlace(0)
    assert math.isnan(nowhere.metres_from(0.8, 0.1))
    assert math.isnan(nowhere.hours_from(None))
    assert math.isnan(HERE.metres_from(1.0, math.nan))


@pytest.mark.parametrize(
    ("north", "km"),
    [
        (47.0, 100.0),
        (57.0, 1112.0),
    ],
)
def test_a_column_without_a_longitude_is_not_at_the_flight(desert_balloon, north, km):
    """Its latitude alone tells how far it is at least."""
    column = replace(desert_balloon, latitude_rad=math.radians(north))
    _, metres = hours_and_metres(column, HERE)
    assert_allclose(metres, 1e3 * km, rtol=5e-3)


def test_a_distance_counts_twice_across_a_coast(norman):
    """A knot's variance grows with the distance, and more across a coast or a ridge."""
    air = expected_air(norman)

    def variance(km, *, across=False):
        balloon = balloon_beside(
            norman,
            latitude_rad=norman.latitude + km / EARTH_KM,
            across=across,
        )
        (departure,) = sounding_departures([balloon], air, over(norman))
        return np.diag(departure.covariance(air))

    of_balloon = 1.2**2 + 1e-4  # its error, and what keeps the covariance regular
    assert_allclose(variance(0.0), of_balloon)
    assert np.all(variance(100.0) > of_balloon + 0.2)
    assert variance(100.0, across=True) == pytest.approx(variance(200.0))


def test_two_soundings_share_their_error(norman):
    """Of the same air: two of them on one side of the flight say hardly more than one."""
    air = expected_air(norman)
    balloons = []
    for hours in (-12, -11, 12):
        time_ns = norman.start_ns + hours * HOUR_NS
        balloons.append(balloon_beside(norman, time_ns=time_ns))

    departures = sounding_departures(balloons, air, over(norman))

    assert [departure.from_flight.hours for departure in departures] == [12.0, 11.0, 12.0]
    first, second, third = departures
    assert first.from_other_soundings[second.name].hours == 1.0
    assert first.from_other_soundings[third.name].hours == 24.0
    joint = joint_covariance(air, np.array([0.0, 3000.0]), departures)
    size = first.knot.size
    row = 2 + size // 4  # some 3 km up, behind two knots of the air
    rows = [row, row + size, row + 2 * size]
    part = joint[np.ix_(rows, rows)]
    sigma = np.sqrt(np.diag(part))
    correlation = part / np.outer(sigma, sigma)
    assert correlation[0, 1] > 0.6
    assert abs(correlation[0, 2]) < 0.4


@pytest.mark.parametrize(
    ("across", "times"),
    [
        (False, 1.0),
        (True, 2.0),
    ],
)
def test_a_station_far_away_is_less_certain(norman, across, times):
    report = replace(station(norman), sigma_temperature_k=0.0, across=across)
    air = expected_air(norman)

    def variances(distance_m):
        far = replace(report, distance_m=distance_m)
        readings = surface_readings(far, air, over(norman))
        return np.array([reading.sigma.item() ** 2 for reading in readings])

    temperature, pressure, humidity = variances(3e4) - variances(0.0)
    # Stations of one hour, 340 km apart in North America, differ by 4.8 K at the ground.
    of_30_km = 4.8**2 * 30.0 / 340.0
    assert_allclose(temperature, times * of_30_km, rtol=0.6)
    assert_allclose(pressure, (1.5e-8 * 3e4) ** 2)
    assert humidity > 0.0


@pytest.mark.parametrize("hours", [2.0, 6.0, 18.0])
def test_an_old_humidity_weighs_what_it_is_worth(hours):
    """Air that forgets: truth and reading drawn with the correlation, and combined as we do."""
    rho = math.exp(-hours / 18.0)
    now, news = np.random.default_rng(4).normal(0.0, 0.3, (2, 20_000))
    then = rho * now + math.sqrt(1.0 - rho**2) * news
    gain = 1.0 / (1.0 + humidity_growth(hours, 0.0))
    claimed = 0.3 * math.sqrt(1.0 - gain)
    assert_allclose(np.std(gain * then - now), claimed, rtol=0.12)


@pytest.mark.parametrize(
    ("hours", "east", "words"),
    [
        (0, 8.0, []),
        (150, 8.0, []),
        (240, 8.0, ["hours"]),
        (0, 30.0, []),
        (0, 34.0, ["km"]),
        (150, 24.0, ["hours", "km"]),
    ],
)
def test_what_is_too_far_says_nothing(desert_balloon, hours, east, words):
    balloon = replace(
        desert_balloon,
        time_ns=hours * HOUR_NS,
        latitude_rad=HERE.latitude_rad,
        longitude_rad=math.radians(east),
    )
    reason = reason_uninformative(balloon, HERE)
    assert (reason is not None) == bool(words)
    assert [word for word in ("hours", "km") if word in (reason or "")] == words


REPORT = SurfaceReport(300.0, 95_000.0, 285.0, 900.0)


@pytest.mark.parametrize(
    "place",
    [
        (),
        (0.8, 0.1),
        (-1.4, -3.0),
    ],
)
@pytest.mark.parametrize(
    ("hours", "silent"),
    [
        (0.0, False),
        (191.9, False),
        (192.1, True),
    ],
)
def test_a_report_falls_silent_with_its_age_alone(place, hours, silent):
    """It has no position: a station near the flight is meant."""
    flight = TimeAndPlace(10**18, *place)
    report = replace(REPORT, time_ns=10**18 - int(hours * HOUR_NS))
    assert hours_and_metres(report, flight) == (pytest.approx(hours, abs=1e-9), 0.0)
    reason = reason_uninformative(report, flight)
    assert (reason is not None) is silent
    assert "km" not in (reason or "")


def test_what_is_not_known_of_a_source_is_taken_as_far(desert_balloon):
    unknown = replace(desert_balloon, time_ns=None)
    assert hours_and_metres(unknown, HERE) == (6.0, UNPLACED_M)
    assert hours_and_metres(REPORT, TimeAndPlace(0)) == (3.0, 0.0)


def adjusted(truth, samples=NO_SENSORS, **more):
    background = climatology(latitude_rad=truth.latitude, month=6.0)
    return adjust(
        truth,
        samples,
        background=background,
        longitude_rad=0.0,
        **more,
    )


def with_sounding(truth, hours_ago=0, **change):
    """By a sounding of the same air alone."""
    return adjusted(truth, soundings=[aged(truth, hours_ago, **change)])


def aged(truth, hours, **change):
    return balloon_of(truth, time_ns=truth.start_ns - hours * HOUR_NS, **change)


def test_the_age_of_a_sounding_counts_without_any_sensor(norman):
    sigmas = []
    for hours in (0, 24, 96):
        made = with_sounding(norman, hours)
        sigmas.append(made.sigma(3000.0))
        assert made.basis == "sounding"
        assert "72357" in made.reason
        assert "measured" in made.profile.layers.source
    sigmas.append(adjusted(norman).sigma(3000.0))
    for fresher, older in pairwise(sigmas):
        assert older > 1.05 * fresher, sigmas


def test_the_distance_of_a_sounding_counts(norman):
    def sigma(km):
        north = norman.latitude + km / EARTH_KM
        return with_sounding(norman, latitude_rad=north).sigma(3000.0)

    assert sigma(500.0) > 1.15 * sigma(0.0)
    assert sigma(1200.0) > 1.05 * sigma(500.0)


@pytest.mark.parametrize("kind", ["soundings", "surface"])
def test_a_source_of_years_ago_is_left_out(norman, kind):
    of_kind = {"soundings": aged, "surface": station}
    source = of_kind[kind](norman, YEARS_H)
    made = adjusted(norman, **{kind: [source]})
    assert made.basis == "climatology"
    assert made.losses == ["AIR-SOURCE-FAR"]
    assert "the climatology is as accurate" in made.why_not(source.name)
    h = norman.h[:6000:100]
    without = adjusted(norman).profile.temperature(h)
    assert made.profile.temperature(h) == pytest.approx(without, abs=1e-6)


@pytest.mark.parametrize(
    ("flown", "other"),
    [
        (4, 5),
        (5, 4),
    ],
)
def test_a_sounding_of_the_other_half_of_the_day(flown, other):
    """Air over Barrow that was measured twice: errors stay inside the sigmas."""
    truth = real_airs()[flown]
    balloon = balloon_of(real_airs()[other], time_ns=truth.start_ns - 12 * HOUR_NS)
    made = adjusted(truth, soundings=[balloon])
    for climb in (1000.0, 3000.0, 6000.0):
        assert made.departure(climb) < 2.0
    levels = slice(100, 8000, 50)
    h = truth.h[levels]
    off = made.profile.temperature(h) - truth.t[levels]
    assert 0.3 < rms(off / made.covariance.sigma_temperature(h)) < 1.3


def test_an_old_sounding_does_not_spoil_a_fresh_one(norman):
    def sigma(*balloons):
        return adjusted(norman, soundings=balloons).sigma(3000.0)

    fresh = aged(norman, hours=1)
    both = sigma(fresh, aged(norman, hours=72))
    assert 0.85 < both / sigma(fresh) <= 1.0
    # ... nor counts as much as it would if it were fresh too.
    assert sigma(fresh, replace(fresh, station="72358")) < 0.97 * both


def station(truth, hours=0, dp=0.0, dt=0.0):
    return SurfaceReport(
        truth.ground_m,
        truth.p0 + dp,
        truth.t[0] + dt,
        truth.e[0],
        truth.start_ns - hours * HOUR_NS,
        "mission file",
    )


@pytest.mark.parametrize(
    ("hours", "is_metar", "expected"),
    [
        (None, False, ["SURFACE-UNDATED"]),
        (-4, False, ["SURFACE-FAR-IN-TIME"]),
        (4, True, ["METAR-FAR-IN-TIME"]),
        (-2, False, []),
    ],
)
def test_a_report_without_a_time_or_of_another_is_told(norman, hours, is_metar, expected):
    report = replace(station(norman, hours or 0), is_metar=is_metar)
    if hours is None:
        report = replace(report, time_ns=None)
    assert codes(distance_notes([], [report], over(norman))) == expected


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"time_ns": None}, ["SOUNDING-UNDATED"]),
        ({"time_ns": 0}, []),  # of 1970: not used, as another message says
        ({"latitude_rad": math.nan}, ["SOUNDING-UNPLACED"]),
        ({"longitude_rad": 0.25}, ["SOUNDING-FAR-AWAY"]),
        ({"longitude_rad": 0.22}, []),
    ],
)
def test_a_sounding_without_a_time_or_place_is_told(norman, change, expected):
    flight = replace(over(norman), longitude_rad=0.2)
    balloon = balloon_beside(norman, **{"longitude_rad": 0.2} | change)
    assert codes(distance_notes([balloon], [], flight)) == expected


@pytest.mark.parametrize(
    ("hours", "expected"),
    [
        (6, []),
        (7, ["SOUNDING-FAR-IN-TIME"]),
        (-191, ["SOUNDING-FAR-IN-TIME"]),
        (193, []),  # not used, as another message says
    ],
)
def test_a_sounding_of_another_hour_is_told_once(norman, hours, expected):
    balloon = aged(norman, hours, latitude_rad=norman.latitude, longitude_rad=0.2)
    flight = replace(over(norman), longitude_rad=0.2)
    assert codes(distance_notes([balloon], [], flight)) == expected


def test_messages_of_far_sources_name_the_doubt_of_a_stated_date(norman):
    doubted = replace(over(norman), longitude_rad=0.2, doubt="; or the date is wrong")
    balloon = aged(norman, 24, latitude_rad=norman.latitude, longitude_rad=0.2)
    report = station(norman, 24)
    metar = replace(report, is_metar=True)
    notes = list(distance_notes([balloon], [report, metar], doubted))
    assert len(notes) == 3
    old = aged(norman, YEARS_H)
    made = adjusted(norman, soundings=[old], doubt_of_time=doubted.doubt)
    notes += [entry for entry in made.ledger if entry.code == "AIR-SOURCE-FAR"]
    assert len(notes) == 4
    for note in notes:
        assert note.what.endswith("; or the date is wrong")


# Stations on the ground


def off_in_sigmas(made):
    """The largest departure of ln p below 3 km."""
    levels = slice(0, 3000, 100)
    h = made.truth.h[levels]
    off = np.log(made.profile.pressure(h) / made.truth.p[levels])
    return np.abs(off / made.covariance.sigma_log_pressure(h)).max()


@pytest.mark.parametrize(
    ("hours", "dp", "dt"),
    [
        (192, 3000.0, 8.0),
        (24, 1200.0, 0.0),
    ],
)
@pytest.mark.parametrize("barometer", [True, False])
def test_weather_of_another_day_does_not_outvote_the_flight(norman, hours, dp, dt, barometer):
    samples = flown(norman, 3000.0, barometer=barometer, descent=True)
    made = adjusted(norman, samples, surface=[station(norman, hours, dp, dt)])
    assert made.basis == "thermometer"
    assert "AIR-IMPLAUSIBLE" not in made.codes()
    assert off_in_sigmas(made) < 2.0
    assert made.departure(3000.0) < 2.0


@pytest.mark.parametrize(
    ("hours", "rounded_k", "sigma_k", "sigma_p"),
    [
        (0, 0.5, (1.3, 1.7), (5e-4, 9e-4)),
        # The prior of 6 K with 1.6 K, and 3 K of six hours somewhere in the day; 3 hPa of them.
        (6, 0.5, (2.2, 3.7), (2.5e-3, 3.5e-3)),
        (0, 3.0, (2.7, 6.0), (5e-4, 9e-4)),
    ],
)
def test_a_station_is_worth_its_kelvin_and_half_a_hectopascal(
    norman, hours, rounded_k, sigma_k, sigma_p
):
    """Alone it fixes T and p where it stands, to what it differs from the free air by."""
    report = replace(station(norman, hours), sigma_temperature_k=rounded_k)
    covariance = adjusted(norman, surface=[report]).covariance
    ground = norman.h[:1]
    assert sigma_k[0] < covariance.sigma_temperature(ground) < sigma_k[1]
    assert sigma_p[0] < covariance.sigma_log_pressure(ground) < sigma_p[1]


def test_qnh_taken_for_the_pressure_of_the_station(norman):
    qnh_less_station_pa = norman.p0 * (math.exp(norman.ground_m / 8200.0) - 1.0)
    samples = flown(norman, 3000.0, descent=True)
    made = adjusted(norman, samples, surface=[station(norman, dp=qnh_less_station_pa)])
    assert off_in_sigmas(made) < 2.0
    message = made.entry("AIR-CONTRADICTED", Kind.FINDING)
    assert "(pressure)" in message.what
    assert "robust weights reduce its influence" in message.what
    assert made.departure(3000.0) < 2.0


def test_a_column_brings_errors_of_its_own(norman):
    """Where they are 4 K, the climatology has a share; their length is that of the covariance."""
    sigma_of_levels = np.where(norman.h[::200] < 3000.0, 1.0, 4.0)
    correlations = []
    for length in (200.0, 20_000.0):
        column = balloon_beside(
            norman,
            kind="model",
            errors=ColumnErrors(sigma_of_levels, 0.15, temperature_length_m=length),
        )
        made = adjusted(norman, soundings=[column])
        assert made.basis == "model"
        low, high = made.covariance.sigma_temperature([1000.0, 7000.0])
        assert_allclose(low, 1.0, rtol=0.25)
        assert 1.6 < high < 4.0
        edge = made.profile.layers.edge
        rows = np.abs(edge - [[1000.0], [2000.0]]).argmin(axis=1)
        (first, both), (_, second) = made.covariance.matrix[np.ix_(rows, rows)]
        correlations.append(both / math.sqrt(first * second))
    short, long = correlations
    assert short < 0.3
    assert long > short + 0.1


# Balloons that are wrong


def test_a_balloon_higher_than_the_climatology(norman):
    h = np.arange(400.0, 34_000.0, 200.0)
    t = np.maximum(288.15 - 0.0065 * h, 216.65)
    thickness_m = np.diff(h, prepend=0.0)
    p = 101_325.0 * np.exp(-np.cumsum(thickness_m * 0.0341632 / t))
    balloon = Sounding(
        h,
        p,
        t,
        np.ones(h.size),
        norman.start_ns,
        "high",
    )
    air = expected_air(norman)
    readings = collect_readings(
        NO_SENSORS,
        air,
        SensorSettings(),
        soundings=[balloon],
    )
    assert readings.high < air.profile.layers.edge[-1]

    made = adjusted(norman, soundings=[balloon])

    assert made.basis == "sounding"
    assert made.losses == []
    high = [15_000.0, 25_000.0, 29_500.0]
    expected_k = np.interp(high, h, t)
    assert made.profile.temperature(high) == pytest.approx(expected_k, abs=2.5)


@pytest.mark.parametrize(
    ("above", "per_km"),
    [
        (4000.0, 15.0),
        (3500.0, -10.0),
    ],
)
def test_a_bad_balloon_does_not_cost_the_flight(norman, above, per_km):
    """One that goes wrong smoothly, far above the flight: what jumps is outvoted anyway."""
    samples = flown(norman, 3000.0, descent=True)
    good = balloon_of(norman, station="good")
    wrong_k = per_km * np.maximum(good.h_m - above, 0.0) / 1e3
    bad = replace(warmed(good, wrong_k), station="bad")

    made = adjusted(norman, samples, soundings=[bad])

    assert made.basis == "thermometer"
    assert made.reason.endswith(f"without {bad.name}")
    assert made.error(3000.0) == adjusted(norman, samples).error(3000.0)
    lost = made.entry("AIR-SOURCE-REFUSED", Kind.LOSS)
    assert lost.where == bad.name
    assert "no air fits" in made.why_not(bad.name)
    # A good one beside it stays.
    both = adjusted(norman, samples, soundings=[good, bad])
    refusals = with_code(both.ledger, "AIR-SOURCE-REFUSED")
    assert good.name not in [message.where for message in refusals]
    fits = {use.source: use.fit for use in both.made.sources}
    assert fits[good.name] is not None
    assert abs(both.error(3000.0)) < 0.005


def warmed(balloon, kelvin):
    return replace(balloon, temperature_k=balloon.temperature_k + kelvin)


@pytest.mark.parametrize(
    ("kelvin", "thermometer"),
    {
        -8.0: True,
        12.0: True,
        -15.0: False,
        15.0: False,
    }.items(),
)
def test_a_balloon_that_contradicts_the_flight_is_left_out(norman, kelvin, thermometer):
    """All its temperatures are wrong by so much, which a bias and a lost pressure would explain."""
    samples = drawn_flight(
        norman,
        3000.0,
        1,
        flights.surveyed,
        descent=True,
        thermometer=thermometer,
        humidity="none",
    )
    # Beside the flight: without a longitude it would be 100 km away, where air may be 2 K other.
    good = balloon_beside(norman)
    assert adjusted(norman, samples, soundings=[good]).losses == []
    wrong = warmed(good, kelvin)

    made = adjusted(norman, samples, soundings=[wrong])

    assert made.losses == ["AIR-SOURCE-REFUSED"]
    lost = made.entry("AIR-SOURCE-REFUSED")
    assert lost.where == wrong.name
    difference = float(re.search(r"are ([-+][\d.]+) K from those of the flight", lost.what)[1])
    assert difference == pytest.approx(kelvin, abs=2.5)
    assert made.error(3000.0) == adjusted(norman, samples).error(3000.0)
    assert "one of both is wrong" in made.why_not(wrong.name)


@pytest.mark.parametrize(
    ("metres", "kelvin", "words"),
    [(-550.0, 0.0, "may be above the ground"), (0.0, -32.0, "climatology")],
)
def test_a_balloon_that_no_climate_has_is_left_out(norman, metres, kelvin, words):
    """Heights above ground, or air of another season; without any sensor of a flight."""
    good = balloon_of(norman)
    by_good = adjusted(norman, soundings=[good])
    assert by_good.losses == []
    assert by_good.basis == "sounding"
    wrong = replace(warmed(good, kelvin), h_m=good.h_m + metres)
    made = adjusted(norman, soundings=[wrong])
    assert made.losses == ["AIR-SOURCE-REFUSED"]
    assert words in made.entry("AIR-SOURCE-REFUSED").what
    assert made.basis == "climatology"


def test_sources_are_doubted_one_by_one_before_sensors_are(norman):
    samples = flown(norman, 3000.0, flights.Sensors())
    first = balloon_of(norman)
    second = balloon_of(norman, station="b")
    report = station(norman)

    choices = candidates(samples, [first, second], [report])

    everything = (first.name, second.name, report.name)
    left_out = [(), *((name,) for name in everything)]
    # Without a sensor and without a source there is nothing.
    expected = 3 * [*left_out, everything] + left_out
    assert [choice.external.left_out for choice in choices] == expected
    assert choices[1].external.names == (second.name, report.name)
    assert {choice.samples for choice in choices[:5]} == {samples}
    assert {choice.samples.temperature for choice in choices[5:10]} == {None}
    assert {choice.samples.pressure for choice in choices[10:15]} == {None}
    assert {choice.basis for choice in choices[5:10]} == {"barometer"}
    assert {choice.basis for choice in choices[15:]} == {"sounding"}
    assert len(candidates(samples, [first] * 6, [])) == 3 * 2 + 1
    (by_report,) = candidates(NO_SENSORS, [], [report])
    assert by_report.basis == "surface"


def test_the_reason_after_estimates_that_could_not_stand(norman):
    bad = warmed(balloon_of(norman), 60.0)
    samples = flown(norman, 3000.0, barometer=False)
    wild = with_readings(samples, 1.25 * samples.temperature.value)
    made = adjusted(norman, wild, soundings=[bad])
    assert made.basis == "climatology"
    why = made.entry("AIR-STANDARD").what
    assert "no estimate passed its checks" in why
    assert "are needed" not in why
    with_it = made.why_not("thermometer thermometer")
    assert "no estimate with it passed its checks" in with_it
    assert "from the climatology of place and season" in made.why_not(bad.name)


def level_of_pressure(*sources, **more):
    """Where the ledger says that the level of the pressure comes from."""
    made = adjusted(*sources, **more)
    what = made.entry("AIR-NO-BAROMETER").what
    return what.removeprefix("no static pressure outside: the level of the pressure is taken from ")


def test_the_source_of_the_level_of_the_pressure_is_named(norman):
    near = replace(station(norman), origin="METAR KOUN", distance_m=9_400.0)
    without_pressure = replace(near, pressure_pa=np.nan, origin="METAR KTIK")
    balloon = replace(balloon_of(norman), latitude_rad=norman.latitude, longitude_rad=0.002)

    by_report = level_of_pressure(norman, surface=[near, without_pressure])
    by_both = level_of_pressure(norman, soundings=[balloon], surface=[near])
    by_neither = level_of_pressure(norman, surface=[without_pressure])

    report = "surface report METAR KOUN (9 km from the flight)"
    # At 35.2 degrees of latitude 0.002 rad of longitude are 10 km.
    assert by_report == report
    assert by_both == f"{balloon.name} (10 km from the flight) and {report}"
    assert by_neither.startswith("the climatology ")
