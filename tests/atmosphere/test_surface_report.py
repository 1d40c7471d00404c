"""Surface reports: METARs decoded by hand beside, and numbers that no ground has."""

import math

import pytest
from numpy.testing import assert_allclose

from tests.atmosphere.adjusting import codes
from tests.atmosphere.values import saturated
from tests.helpers import ns, refused, with_code
from unbend.atmosphere.surface_report import (
    parse_metar,
    station_pressure,
    surface_report,
)
from unbend.errors import InputError
from unbend.messages import Ledger

WIND = "221150Z 24011KT CAVOK"
NAN = math.nan


def parsed(text, h_m=0.0, when=""):
    ledger = Ledger()
    flight_ns = ns(when) if when else None
    return parse_metar(text, h_m, ledger, where="mission.yaml", flight_ns=flight_ns), ledger


def quiet(text, h_m=0.0, when=""):
    """A report of which nothing is to be told."""
    report, ledger = parsed(text, h_m, when)
    assert codes(ledger) == []
    return report


def smithsonian_pa(altimeter_hpa, h_m):
    """The pressure of a station as weather services have it."""
    return 100.0 * (altimeter_hpa**0.190263 - 8.417286e-5 * h_m) ** (1.0 / 0.190263)


@pytest.mark.parametrize(
    ("qnh_hpa", "h", "pa", "within"),
    [
        # US 1976, table I; ICAO's is the same air.
        (1013.25, 0.0, 101_325.0, 2e-6),
        (1013.25, 1000.0, 89_874.6, 2e-6),
        (1013.25, 5000.0, 54_019.9, 2e-6),
        # Denver, A3000.
        (1015.92, 1656.0, smithsonian_pa(1015.92, 1656.0), 5e-5),
    ],
)
def test_station_pressure_is_that_of_the_tables(qnh_hpa, h, pa, within):
    assert_allclose(station_pressure(100.0 * qnh_hpa, h), pa, rtol=within)


def test_tenths_of_the_remarks_and_inches():
    text = "METAR KOUN 221153Z 14011KT 10SM FEW250 13/M02 A3011 RMK AO2 SLP190 T01281017"
    report = quiet(text, 357.0, "2023-05-22T12:30")
    assert_allclose(report.temperature_k, 273.15 + 12.8)
    assert report.vapour_pressure_pa == saturated(-1.7)
    rounded_down_hpa = 30.115 * 33.86389
    assert_allclose(report.pressure_pa, smithsonian_pa(rounded_down_hpa, 357.0), rtol=5e-5)
    assert report.time_ns == ns("2023-05-22T11:53")
    assert report.origin == "METAR KOUN"
    assert report.sigma_temperature_k == 0.3


def test_whole_degrees_below_zero_and_hectopascals():
    report = quiet("EDDF 221150Z AUTO 24011KT 9999 SCT040 M05/M10 Q0998=")
    assert_allclose(report.temperature_k, 268.15)
    assert report.vapour_pressure_pa == saturated(-10.0)
    assert_allclose(report.pressure_pa, 99850.0)  # 998 is rounded down
    assert report.time_ns is None
    assert report.sigma_temperature_k == 0.5


@pytest.mark.parametrize(
    ("flight", "time"),
    [
        ("2024-03-01T01:00", "2024-02-29T23:50"),
        ("2024-02-29T22:00", "2024-02-29T23:50"),
        ("2024-04-28T23:00", "2024-04-29T23:50"),
    ],
)
def test_the_nearest_day_of_that_number(flight, time):
    report = quiet("METAR EDDF 292350Z 24011KT CAVOK 12/08 Q1013", 111.0, flight)
    assert report.time_ns == ns(time)


@pytest.mark.parametrize(
    ("groups", "missing", "celsius", "dew_point", "hpa"),
    [
        ("XX/11 Q1013", ["temperature"], NAN, NAN, 1000.23),
        ("///// Q1013", ["temperature", "dew point"], NAN, NAN, 1000.23),
        ("12/// Q1013", ["dew point"], 12.0, NAN, 1000.23),
        ("12/08 Q////", ["altimeter setting"], 12.0, 8.0, NAN),
        ("12/// Q////", ["dew point", "altimeter setting"], 12.0, NAN, NAN),
    ],
)
def test_what_cannot_be_read_is_unknown_and_told(groups, missing, celsius, dew_point, hpa):
    """Without a temperature the dew point gives no relative humidity: it is not kept either."""
    report, ledger = parsed(f"METAR EDDF {WIND} {groups}", 111.0)
    (entry,) = ledger
    assert entry.code == "METAR-MISSING"
    assert all(word in entry.what for word in missing)
    assert report.temperature_k == pytest.approx(celsius + 273.15, nan_ok=True)
    assert report.vapour_pressure_pa == saturated(dew_point)
    assert report.pressure_pa == pytest.approx(100.0 * hpa, abs=2.0, nan_ok=True)


def test_unknown_groups_are_said_and_cost_nothing():
    report, ledger = parsed("METAR EDDF 221150Z 24011KT XYZZY CAVOK 12/08 Q1013")
    assert_allclose(report.temperature_k, 285.15)
    (entry,) = ledger
    assert entry.code == "METAR-GROUPS"
    assert "XYZZY" in entry.what


def test_dew_point_above_temperature_is_saturated():
    """By a degree: each may be rounded another way."""
    report, ledger = parsed(f"METAR EDDF {WIND} 12/13 Q1013")
    assert codes(ledger) == ["METAR-DEW-POINT"]
    assert report.vapour_pressure_pa == saturated(12.0)


@pytest.mark.parametrize(
    ("groups", "exchanged"),
    [
        ("10/17 Q1021", "17/10"),
        ("12/14 Q1013", "14/12"),
        ("M10/M05 Q1013", "M05/M10"),
        ("M01/01 Q1013", "01/M01"),
        ("13/15 A3011 RMK T01280147", "15/13"),
    ],
)
def test_a_dew_point_far_above_the_temperature_is_refused(groups, exchanged):
    with refused(
        "METAR-DEW-POINT",
        InputError,
        what="perhaps the two are exchanged",
        remedy=f"{exchanged} if they are exchanged",
        where=groups[:5],
    ):
        parsed(f"METAR EDDF {WIND} {groups}")


def test_a_whole_dew_point_beside_tenths_is_rounded_not_wrong():
    report = quiet("KOUN 121153Z 13/13 A3011 RMK T0128")
    assert report.vapour_pressure_pa == saturated(12.8)


def test_numbers_of_a_mission_file():
    report = surface_report(
        250.0, temperature_k=293.15, pressure_pa=98_400.0, relative_humidity=0.5
    )
    assert report.vapour_pressure_pa == saturated(20.0, share=0.5)
    assert report.h_m == 250.0
    assert report.pressure_pa == 98_400.0
    assert report.temperature_k == 293.15
    without = surface_report(250.0, pressure_pa=98_400.0)
    assert math.isnan(without.temperature_k)
    assert math.isnan(without.vapour_pressure_pa)


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"temperature_k": 68.0 + 273.15}, "SURFACE-TEMPERATURE"),  # 68 F taken for Celsius
        ({"temperature_k": 20.0}, "SURFACE-TEMPERATURE"),  # Celsius taken for Kelvin
        ({"pressure_pa": 984.0}, "SURFACE-PRESSURE"),
        ({"pressure_pa": 101_325.0, "h_m": 1600.0}, "SURFACE-PRESSURE"),  # QNH
        ({"temperature_k": 293.15, "relative_humidity": 55.0}, "SURFACE-HUMIDITY"),
        ({"temperature_k": 293.15, "h_m": 29_000.0}, "SURFACE-HEIGHT"),
        ({"temperature_k": 293.15, "h_m": math.nan}, "SURFACE-HEIGHT"),
        ({}, "SURFACE-EMPTY"),
    ],
)
def test_numbers_that_no_ground_has(values, code):
    with refused(code, InputError):
        surface_report(**({"h_m": 250.0} | values))


@pytest.mark.parametrize(
    ("text", "words"),
    {
        "": "",
        "the weather is fine": "",
        "METAR EDDF 221150Z NIL=": "",
        "METAR EDDF 321150Z 24011KT CAVOK 12/08 Q1013": "",
        "LOWW 122450Z 33009KT CAVOK 06/02 Q1026": "",
        "LOWW 121160Z 33009KT CAVOK 06/02 Q1026": "",
        "LOWW 1150Z 33009KT CAVOK 06/02 Q1026": "1150Z is not a day",
        "TAF LOWW 121115Z 1212/1318 33009KT CAVOK TX14/1214Z Q1026": "forecast",
        "LOWW 121150Z 06/02 Q1026\nTAF LOWW 1212/1318 33009KT CAVOK": "forecast",
        "LOWW 121100Z 1212/1318 33009KT CAVOK QNH2992INS": "forecast",
        "AAXX 12121 11035 42565 83309 10058 20022 39996 40260": "SYNOP",
        "March 12, 2015 LOWW 121150Z 33009KT CAVOK 06/02 Q1026": "is not a date",
        "2015-13-12 LOWW 121150Z 33009KT CAVOK 06/02 Q1026": "is not a date",
        "33009KT 06/02 Q1026": "no station",
        # Of several reports none is guessed; any of their groups tells them.
        "LOWW 121150Z CAVOK 06/02 Q1026= LOWI 121150Z CAVOK 04/02 Q0996=": "2 reports",
        "METAR LOWW 121150Z 06/02 Q1026\nMETAR LOWW 121220Z 07/02 Q1026": "2 reports",
        "LOWW 121150Z CAVOK 06/02 Q1026= LOWI CAVOK 04/02 Q0996=": "2 reports",
        "LOWW CAVOK 06/02 Q1026 LOWI CAVOK 04/02 Q0996": "2 reports",
        "EDDF 121150Z SCT040 12/08 Q1013 EDDM Q1012": "2 reports",
        "LOWW 121150Z NIL= LOWI 121150Z 04/02 Q0996": "2 reports",
        "KOUN 121150Z 13/M02 A3011 RMK T01281017 KTIK T01171017": "2 reports",
    }.items(),
)
def test_what_is_no_report_is_refused_by_its_kind(text, words):
    with refused("METAR-PARSE", InputError, what=words, where="mission.yaml"):
        parsed(text, 200.0, "2015-03-12T12:00")


@pytest.mark.parametrize("groups", ["12/08 Q0113", "77/08 A2992"])
def test_values_that_no_air_has_are_refused(groups):
    with refused("METAR-RANGE", InputError):
        parsed(f"METAR KXYZ {WIND} {groups}")


@pytest.mark.parametrize(
    ("text", "words"),
    {
        "KOUN 121153Z M01/M03 A3011 RMK T01281017": "-1 C in the body and 12.8 C",
        "KOUN 121153Z 13/M02 A3011 RMK T11281017": "13 C in the body and -12.8 C",
        "KOUN 121153Z 13/02 A3011 RMK T01281017": "2 C in the body and -1.7 C",
        "RJTT 121200Z 06/02 Q1026 NOSIG RMK A2930": "1026 hPa in the body and 992 hPa",
        "RJTT 121200Z 06/02 Q1026 A2930": "1026 hPa in the body and 992 hPa",
        "2015/03/15 11:50\nLOWW 121150Z 06/02 Q1026": "12 in the body and 2015-03-15",
    }.items(),
)
def test_groups_that_contradict_each_other_are_refused(text, words):
    with refused("METAR-CONTRADICTION", InputError, what=words):
        parsed(text, 200.0, "2015-03-12T12:00")


QNH_1026 = 1026.5
A3030 = 30.305 * 33.86389


@pytest.mark.parametrize(
    ("text", "celsius", "qnh_hpa"),
    [
        ("METAR COR LOWW 121150Z 33009KT CAVOK 06/02 Q1026=", 6.0, QNH_1026),
        ("METAR LOWW 121150Z CCA 33009KT CAVOK M06/M08 Q1026", -6.0, QNH_1026),
        ("LOWW 121150Z AUTO 33009KT //// // ////// -06/-08 Q1026", -6.0, QNH_1026),
        ("metar loww 121150z 33009kt cavok m06/m08 q1026", -6.0, QNH_1026),
        ("SAOS31 LOWM 121150 METAR LOWW 121150Z 33009KT 06/02 Q1026=", 6.0, QNH_1026),
        ("ADDS text: LOWW 121150 33009KT 06/02 Q1026", 6.0, QNH_1026),
        ("LOWW 121150Z 06/02 Q1026 NOSIG RMK 1CU030 A3030", 6.0, QNH_1026),
        ("LOWW 121150Z 06/02 A3030 Q1026", 6.0, A3030),
        ("LOWW 121150Z 06/02 QNH3030INS", 6.0, A3030),
        ("LOWW 121150Z 06/02 QNH1026HPA", 6.0, QNH_1026),
        ("LOWW 121150Z 06/02 Q1026 BECMG FM1230 08/01 Q1016", 6.0, QNH_1026),
        ("LOWW 121150Z 00/M02 A3030 RMK T10041017", -0.4, A3030),
    ],
)
def test_forms_of_reports(text, celsius, qnh_hpa):
    report, notes = parsed(text, when="2015-03-12T12:30")
    assert not with_code(notes, "METAR-GROUPS")
    assert_allclose(report.temperature_k, celsius + 273.15)
    assert_allclose(report.pressure_pa, 100.0 * qnh_hpa)
    assert report.origin == "METAR LOWW"
    assert report.time_ns == ns("2015-03-12T11:50")


@pytest.mark.parametrize(
    ("before", "time"),
    {
        "2014/03/12 11:50\n": "2014-03-12T11:50",  # as servers write it, a year before the flight
        "201403121150 METAR ": "2014-03-12T11:50",
        "12.03.2014 ": "2014-03-12T11:50",
        "2015-03-11 23:59 ": "2015-03-12T11:50",  # of a server of another day
    }.items(),
)
@pytest.mark.parametrize("flight", ["", "2015-03-20T12:00"])
def test_a_date_before_a_report_is_its_date(before, time, flight):
    report, _ = parsed(f"{before}LOWW 121150Z 33009KT 06/02 Q1026", when=flight)
    assert report.time_ns == ns(time)
