"""Surface reports: METARs decoded by hand beside, and numbers that no ground has."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unbend.atmosphere.surface_report import parse_metar, station_pressure, surface_report
from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.simulate.true_air import saturation_pressure_pa


def ns(text: str) -> int:
    return int(np.datetime64(text, "ns").astype(np.int64))


def saturated(celsius: float) -> float:
    return float(saturation_pressure_pa(np.array(celsius + 273.15)))


def test_station_pressure_is_that_of_the_tables():
    # US 1976, table I: 1000 m' 898.746 hPa, 5000 m' 540.199 hPa; ICAO's is the same air.
    for h, hpa in ((0.0, 1013.25), (1000.0, 898.746), (5000.0, 540.199)):
        assert station_pressure(101325.0, h) == pytest.approx(hpa * 100.0, rel=2e-6)
    # The Smithsonian formula as weather services have it, in hPa: Denver at 1656 m, A3000.
    denver = (1015.92**0.190263 - 8.417286e-5 * 1656.0) ** (1.0 / 0.190263)
    assert station_pressure(101_592.0, 1656.0) == pytest.approx(denver * 100.0, rel=5e-5)


def test_tenths_of_the_remarks_and_inches():
    report = parse_metar(
        "METAR KOUN 221153Z 14011KT 10SM FEW250 13/M02 A3011 RMK AO2 SLP190 T01281017",
        357.0,
        Ledger(),
        flight_ns=ns("2023-05-22T12:30"),
    )
    assert report.temperature_k == pytest.approx(273.15 + 12.8)
    assert report.vapour_pressure_pa == pytest.approx(saturated(-1.7), rel=0.01)
    qnh = 30.115 * 33.86389  # rounded down to 30.11
    hpa = (qnh**0.190263 - 8.417286e-5 * 357.0) ** (1.0 / 0.190263)
    assert report.pressure_pa == pytest.approx(hpa * 100.0, rel=5e-5)
    assert report.time_ns == ns("2023-05-22T11:53")
    assert report.origin == "METAR KOUN"
    assert report.sigma_temperature_k == 0.3


def test_whole_degrees_below_zero_and_hectopascals():
    report = parse_metar("EDDF 221150Z AUTO 24011KT 9999 SCT040 M05/M10 Q0998=", 0.0, Ledger())
    assert report.temperature_k == pytest.approx(268.15)
    assert report.vapour_pressure_pa == pytest.approx(saturated(-10.0), rel=0.01)
    assert report.pressure_pa == pytest.approx(99850.0)  # 998 is rounded down
    assert report.time_ns is None
    assert report.sigma_temperature_k == 0.5


@pytest.mark.parametrize(
    ("flight", "report"),
    [
        ("2024-03-01T01:00", "2024-02-29T23:50"),
        ("2024-02-29T22:00", "2024-02-29T23:50"),
        ("2024-04-28T23:00", "2024-04-29T23:50"),
    ],
)
def test_the_nearest_day_of_that_number(flight, report):
    text = "METAR EDDF 292350Z 24011KT CAVOK 12/08 Q1013"
    ledger = Ledger()
    assert parse_metar(text, 111.0, ledger, flight_ns=ns(flight)).time_ns == ns(report)
    assert list(ledger) == []


def test_what_is_missing_is_unknown():
    report = parse_metar("METAR EDDF 221150Z 24011KT CAVOK 12/// Q////", 111.0, Ledger())
    assert report.temperature_k == pytest.approx(285.15)
    assert math.isnan(report.pressure_pa)
    assert math.isnan(report.vapour_pressure_pa)
    report = parse_metar("METAR EDDF 221150Z 24011KT CAVOK ///// Q1013", 111.0, Ledger())
    assert math.isnan(report.temperature_k)
    assert math.isnan(report.vapour_pressure_pa)
    assert report.pressure_pa == pytest.approx(100_023.0, abs=2.0)


@pytest.mark.parametrize(
    ("groups", "missing"),
    [
        ("XX/11 Q1017", ["temperature"]),
        ("///// Q1017", ["temperature", "dew point"]),
        ("12/// Q1017", ["dew point"]),
        ("12/08 Q////", ["altimeter setting"]),
        ("12/08 Q1017", []),
    ],
)
def test_what_cannot_be_read_is_told(groups, missing):
    ledger = Ledger()
    report = parse_metar(f"METAR EDDF 221150Z 24011KT CAVOK {groups}", 111.0, ledger)
    said = [entry.what for entry in ledger if entry.code == "METAR-MISSING"]
    assert len(said) == bool(missing)
    assert all(word in said[0] for word in missing)
    # Without a temperature the dew point gives no relative humidity: it is not kept either.
    known = not {"temperature", "dew point"} & set(missing)
    assert math.isfinite(report.vapour_pressure_pa) is known


def test_unknown_groups_are_said_and_cost_nothing():
    ledger = Ledger()
    report = parse_metar("METAR EDDF 221150Z 24011KT XYZZY CAVOK 12/08 Q1013", 111.0, ledger)
    assert report.temperature_k == pytest.approx(285.15)
    assert [entry.code for entry in ledger] == ["METAR-GROUPS"]
    assert "XYZZY" in next(iter(ledger)).what


def test_dew_point_above_temperature_is_saturated():
    ledger = Ledger()
    report = parse_metar("METAR EDDF 221150Z 24011KT CAVOK 12/15 Q1013", 111.0, ledger)
    assert [entry.code for entry in ledger] == ["METAR-DEW-POINT"]
    assert report.vapour_pressure_pa == pytest.approx(saturated(12.0), rel=0.01)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "METAR-PARSE"),
        ("the weather is fine", "METAR-PARSE"),
        ("METAR EDDF 221150Z NIL=", "METAR-PARSE"),
        ("METAR EDDF 321150Z 24011KT CAVOK 12/08 Q1013", "METAR-PARSE"),
        ("METAR EDDF 221150Z 24011KT CAVOK 12/08 Q0113", "METAR-RANGE"),
        ("METAR KXYZ 221150Z 24011KT CAVOK 77/08 A2992", "METAR-RANGE"),
    ],
)
def test_no_report(text, code):
    with pytest.raises(InputError) as caught:
        parse_metar(text, 111.0, Ledger(), where="mission.yaml, atmosphere.metar")
    assert caught.value.code == code
    assert "mission.yaml" in caught.value.where
    assert caught.value.remedy


def test_numbers_of_a_mission_file():
    report = surface_report(
        250.0, temperature_k=293.15, pressure_pa=98_400.0, relative_humidity=0.5
    )
    assert report.vapour_pressure_pa == pytest.approx(0.5 * saturated(20.0), rel=0.01)
    assert (report.h_m, report.pressure_pa, report.temperature_k) == (250.0, 98_400.0, 293.15)
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
    with pytest.raises(InputError) as caught:
        surface_report(**({"h_m": 250.0} | values))
    assert caught.value.code == code
    assert caught.value.remedy


@pytest.mark.parametrize(
    "text",
    [
        "LOWW 121150Z 33009KT CAVOK 06/02 Q1026= LOWI 121150Z 33009KT CAVOK 04/02 Q0996=",
        "METAR LOWW 121150Z 33009KT 06/02 Q1026\nMETAR LOWW 121220Z 33009KT 07/02 Q1026",
    ],
)
def test_of_several_reports_none_is_guessed(text):
    with pytest.raises(InputError) as caught:
        parse_metar(text, 200.0, Ledger())
    assert caught.value.code == "METAR-PARSE"
    assert "2 reports" in caught.value.what


@pytest.mark.parametrize(
    "text",
    [
        "LOWW 121150Z CAVOK 06/02 Q1026= LOWI CAVOK 04/02 Q0996=",  # the second without a time
        "LOWW CAVOK 06/02 Q1026 LOWI CAVOK 04/02 Q0996",  # both
        "EDDF 121150Z SCT040 12/08 Q1013 EDDM Q1012",
        "LOWW 121150Z NIL= LOWI 121150Z 04/02 Q0996",
        "KOUN 121150Z 13/M02 A3011 RMK T01281017 KTIK T01171017",
    ],
)
def test_several_reports_are_told_by_any_of_their_groups(text):
    with pytest.raises(InputError) as caught:
        parse_metar(text, 200.0, Ledger())
    assert "2 reports" in caught.value.what


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("KOUN 121153Z M01/M03 A3011 RMK T01281017", "-1 C in the body and 12.8 C"),
        ("KOUN 121153Z 13/M02 A3011 RMK T11281017", "13 C in the body and -12.8 C"),
        ("KOUN 121153Z 13/02 A3011 RMK T01281017", "2 C in the body and -1.7 C"),
        ("RJTT 121200Z 06/02 Q1026 NOSIG RMK A2930", "1026 hPa in the body and 992 hPa"),
        ("RJTT 121200Z 06/02 Q1026 A2930", "1026 hPa in the body and 992 hPa"),
        ("2015/03/15 11:50\nLOWW 121150Z 06/02 Q1026", "12 in the body and 2015-03-15"),
    ],
)
def test_groups_that_contradict_each_other_are_refused(text, words):
    with pytest.raises(InputError) as caught:
        parse_metar(text, 200.0, Ledger(), flight_ns=ns("2015-03-12T12:00"))
    assert caught.value.code == "METAR-CONTRADICTION"
    assert words in caught.value.what


@pytest.mark.parametrize(
    ("text", "celsius", "qnh_hpa", "station"),
    [
        ("METAR COR LOWW 121150Z 33009KT CAVOK 06/02 Q1026=", 6.0, 1026.5, "LOWW"),
        ("METAR LOWW 121150Z CCA 33009KT CAVOK M06/M08 Q1026", -6.0, 1026.5, "LOWW"),
        ("LOWW 121150Z AUTO 33009KT //// // ////// -06/-08 Q1026", -6.0, 1026.5, "LOWW"),
        ("metar loww 121150z 33009kt cavok m06/m08 q1026", -6.0, 1026.5, "LOWW"),
        ("SAOS31 LOWM 121150 METAR LOWW 121150Z 33009KT 06/02 Q1026=", 6.0, 1026.5, "LOWW"),
        ("ADDS text: LOWW 121150 33009KT 06/02 Q1026", 6.0, 1026.5, "LOWW"),
        ("RJTT 121150Z 06/02 Q1026 NOSIG RMK 1CU030 A3030", 6.0, 1026.5, "RJTT"),
        ("KOUN 121150Z 06/02 A3030 Q1026", 6.0, 30.305 * 33.86389, "KOUN"),
        ("KOUN 121150Z 06/02 QNH3030INS", 6.0, 30.305 * 33.86389, "KOUN"),
        ("LOWW 121150Z 06/02 QNH1026HPA", 6.0, 1026.5, "LOWW"),
        ("LOWW 121150Z 06/02 Q1026 BECMG FM1230 08/01 Q1016", 6.0, 1026.5, "LOWW"),
        ("KOUN 121150Z 00/M02 A3030 RMK T10041017", -0.4, 30.305 * 33.86389, "KOUN"),
    ],
)
def test_forms_of_reports(text, celsius, qnh_hpa, station):
    report = parse_metar(text, 0.0, Ledger(), flight_ns=ns("2015-03-12T12:30"))
    assert report.temperature_k == pytest.approx(celsius + 273.15)
    assert report.pressure_pa == pytest.approx(100.0 * qnh_hpa, rel=1e-7)
    assert report.origin == f"METAR {station}"
    assert report.time_ns == ns("2015-03-12T11:50")


def test_a_whole_dew_point_beside_tenths_is_rounded_not_wrong():
    ledger = Ledger()
    report = parse_metar("KOUN 121153Z 13/13 A3011 RMK T0128", 0.0, ledger)
    assert list(ledger) == []
    assert report.vapour_pressure_pa == pytest.approx(saturated(12.8), rel=0.01)


@pytest.mark.parametrize(
    ("before", "time"),
    [
        ("2014/03/12 11:50\n", "2014-03-12T11:50"),  # as servers write it, a year before the flight
        ("201403121150 METAR ", "2014-03-12T11:50"),
        ("12.03.2014 ", "2014-03-12T11:50"),
        ("2015-03-11 23:59 ", "2015-03-12T11:50"),  # of a server of another day
        ("", "2015-03-12T11:50"),
    ],
)
def test_a_date_before_a_report_is_its_date(before, time):
    text = f"{before}LOWW 121150Z 33009KT 06/02 Q1026"
    report = parse_metar(text, 200.0, Ledger(), flight_ns=ns("2015-03-20T12:00"))
    assert report.time_ns == ns(time)
    alone = parse_metar(text, 200.0, Ledger())
    assert alone.time_ns == (ns(time) if before else None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("TAF LOWW 121115Z 1212/1318 33009KT CAVOK TX14/1214Z Q1026", "forecast"),
        ("LOWW 121150Z 06/02 Q1026\nTAF LOWW 1212/1318 33009KT CAVOK", "forecast"),
        ("AAXX 12121 11035 42565 83309 10058 20022 39996 40260", "SYNOP"),
        ("LOWW 1150Z 33009KT CAVOK 06/02 Q1026", "1150Z is not a day"),
        ("March 12, 2015 LOWW 121150Z 33009KT CAVOK 06/02 Q1026", "is not a date"),
        ("2015-13-12 LOWW 121150Z 33009KT CAVOK 06/02 Q1026", "is not a date"),
        ("33009KT 06/02 Q1026", "no station"),
    ],
)
def test_what_is_no_report_is_refused_by_its_kind(text, words):
    with pytest.raises(InputError) as caught:
        parse_metar(text, 200.0, Ledger(), flight_ns=ns("2015-03-12T12:00"))
    assert caught.value.code == "METAR-PARSE"
    assert words in caught.value.what


@pytest.mark.parametrize("stamp", ["321150Z", "122450Z", "121160Z"])
def test_a_time_that_is_none_is_refused(stamp):
    with pytest.raises(InputError) as caught:
        parse_metar(f"LOWW {stamp} 33009KT CAVOK 06/02 Q1026", 200.0, Ledger())
    assert caught.value.code == "METAR-PARSE"
