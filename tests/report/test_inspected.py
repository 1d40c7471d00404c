"""The text of `unbend inspect` of weather files, in which every number differs."""

import io

import pytest
import yaml
from rich.console import Console

from tests.helpers import one_line
from unbend.report.inspected_weather import print_metars, print_model, print_sounding

from .text_tables import lines_of

MODEL = yaml.safe_load("""
format: netCDF
grid: 3 x 5 nodes
times_utc: ["2025-06-12T06:00:00", "2025-06-12T07:00:00", "2025-06-12T09:00:00"]
lead_h: [1.0, 2.0, 4.0]
levels: [1000.0, 925.0, 850.0]
level_kind: pressure
members: [m01, m02, m07]
latitude_deg: {from: 46.0, to: 47.5, count: 7, step: 0.25}
longitude_deg: {from: 8.0, to: 11.0, count: 13, step: 0.125}
variables:
  - {name: t, units: K, levels: 3, long_name: temperature}
  - {name: q, units: kg/kg, levels: 1, long_name: humidity}
""")


def printed_lines(printer, contents):
    """The lines that are printed, each with one blank between its words."""
    file = io.StringIO()
    printer(Console(file=file, width=400), contents, "era5.nc")
    return [one_line(line) for line in file.getvalue().splitlines() if line.strip()]


def test_what_is_printed_of_a_weather_model():
    assert printed_lines(print_model, MODEL) == lines_of("""
        era5.nc: weather model, netCDF
        grid 3 x 5 nodes
        time 3 times, 2025-06-12 06:00:00 to 2025-06-12 09:00:00 UTC; 4 h since the forecast began
        levels 3 pressure levels, 1000 to 850 hPa: 1000, 925, 850
        latitude 46° to 47.5°, 7 nodes every 0.25°
        longitude 8° to 11°, 13 nodes every 0.125°
        members 3, m01 to m07
        variable unit levels name
        t K 3 temperature
        q kg/kg 1 humidity
    """)


@pytest.mark.parametrize(("number", "are_listed"), [(40, True), (41, False)])
def test_up_to_forty_levels_are_listed(number, are_listed):
    levels = [float(level) for level in range(1, number + 1)]
    lines = printed_lines(print_model, MODEL | {"levels": levels, "level_kind": "model"})
    (line,) = (line for line in lines if line.startswith("levels"))
    begin = f"levels {number} model levels, 1 to {number}"
    assert line.startswith(begin)
    assert (line != begin) == are_listed


def test_what_is_printed_of_a_sounding():
    sounding = yaml.safe_load("""
    format: igra
    first_utc: "2025-06-12T00:00:00"
    last_utc: "2025-06-12T12:00:00"
    latitude_deg: 48.2486
    longitude_deg: 16.3564
    levels: 57
    levels_in_file: 63
    ascents: 2
    station: "11035"
    heights: geopotential
    h_m: [200.0, 31000.0]
    pressure_hpa: [990.5, 8.0]
    temperature_c: [-61.5, 21.0]
    humidity: the dew point
    vapour_pressure_hpa: [0.01, 14.5]
    columns: {pressure: PRES}
    notes: [the wind is not read]
    """)
    lines = printed_lines(print_sounding, sounding)
    assert lines[:-1] == lines_of("""
        era5.nc: sounding, read as igra
        ascents 2; below is the first
        station 11035
        time 2025-06-12 00:00:00 to 2025-06-12 12:00:00 UTC
        place 48.249°, 16.356°
        levels 57 of 63 levels used; heights in the file are geopotential
        height 200 to 31000 m above sea level
        pressure 990.5 to 8 hPa
        temperature -61.5 to 21 °C
        humidity 0.01 to 14.5 hPa of vapour, from the dew point
        pressure from column PRES
        note the wind is not read
    """)
    assert lines[-1] == "mission file atmosphere: {soundings: [{path: era5.nc}]}"

    sounding["longitude_deg"] = None
    lines = printed_lines(print_sounding, sounding)
    assert "place 48.249°, longitude not stated" in lines


def test_what_is_printed_of_metars():
    report = yaml.safe_load("""
    text: LSZH 141020Z 24008KT CAVOK 18/07 Q1016 XYZ Q////
    station: LSZH
    date: "2026-05-14"
    stamp: 1020Z
    temperature_c: 18.04
    dew_point_c: 7.26
    qnh_hpa: 1016.5
    notes: [XYZ, Q////]
    """)
    unknown = report | {"date": None, "temperature_c": None, "qnh_hpa": None, "notes": []}
    lines = printed_lines(print_metars, [report, unknown])
    assert lines[0] == "era5.nc: 2 METARs"
    assert "LSZH 2026-05-14 1020Z 18.0 7.3 1016.5 XYZ; Q////" in lines
    assert "LSZH 1020Z 7.3" in lines
