"""Soundings as files have them: real ones against lines read by eye, and what may be wrong."""

import math
import re
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.io import netcdf_file

from tests.atmosphere.flights import DATA, SHARED_SOUNDINGS
from tests.atmosphere.values import HYDROSTATIC_K_PER_M, metres, saturated
from tests.helpers import ns, refused, with_code
from unbend.atmosphere.soundings import FORMATS, parse_sounding
from unbend.errors import InputError
from unbend.messages import Kind, Ledger
from unbend.simulate.true_air import saturation_pressure_pa
from unbend.tables.soundings import LARGEST_BYTES, read_sounding

EXCERPTS = DATA / "sounding_files"
"""Some levels of each of the real files, in the files' own form."""

FOLDERS = [pytest.param(EXCERPTS, id="excerpt")]
if SHARED_SOUNDINGS.is_dir():
    FOLDERS.append(pytest.param(SHARED_SOUNDINGS, id="whole"))


@pytest.fixture(params=FOLDERS)
def files(request):
    """Folders of soundings as they are distributed."""
    return request.param


def counts(ledger):
    return {entry.code: entry.count for entry in ledger}


def parsed(text, when="", degrees=45.0, parse=parse_sounding, **options):
    """A text as it is read at a latitude and time of the flight; and the counts of its messages."""
    ledger = Ledger()
    sounding = parse(
        text,
        ledger,
        time_ns=ns(when) if when else None,
        latitude_rad=math.radians(degrees),
        **options,
    )
    return sounding, counts(ledger)


def from_file(path, degrees=math.nan, when=""):
    return parsed(path, when, degrees, read_sounding)


@contextmanager
def input_refused(code, words=""):
    """A block that ends with this refusal, with these words."""
    with refused(code, InputError) as caught:
        yield caught
    assert words in caught.value.what


def check_levels(sounding, degrees, lines):
    """Lines of a file, read by eye: pressure [hPa], height [m'], temperature and dew point [C]."""
    for line in lines.split(", "):
        hpa, geopotential_m, celsius, dew_point = map(float, line.split())
        pa = 100.0 * hpa
        row = np.argmin(np.abs(sounding.pressure_pa - pa))
        h_m = metres(geopotential_m, degrees)
        assert_allclose(sounding.pressure_pa[row], pa)
        assert sounding.h_m[row] == pytest.approx(h_m, abs=0.15)
        assert sounding.temperature_k[row] == pytest.approx(celsius + 273.15, abs=1e-4)
        assert sounding.vapour_pressure_pa[row] == saturated(dew_point)


@pytest.mark.parametrize(
    ("when", "levels"),
    [
        ("2010-06-01T01:00", "1009.80 12 0.0 0.0, 850 1383 -3.5 -4.3, 300 8939 -46.4 -62.3"),
        ("2010-06-01T12:00", "1008.40 12 -1.7 -1.7"),
    ],
)
def test_igra_by_time(files, when, levels):
    sounding, notes = from_file(files / "igra2_USM00070026_Barrow.txt", when=when)
    check_levels(sounding, 71.2889, levels)
    assert sounding.station == "USM00070026"
    assert_allclose(math.degrees(sounding.latitude_rad), 71.2889)
    assert_allclose(math.degrees(sounding.longitude_rad), -156.7833)
    assert notes["SOUNDING-CHOSEN"] == 2
    # The file is cut off behind its third header.
    assert notes["SOUNDING-CUT-OFF"] == 1
    # Wind levels without pressure: the archive's level type 30.
    assert notes["SOUNDING-MISSING"] >= (90 if files == SHARED_SOUNDINGS else 2)


def test_igra_derived(files):
    path = files / "igra2_derived_USM00070026_Barrow.txt"
    ledger = Ledger()
    sounding = read_sounding(
        path,
        ledger,
        time_ns=ns("2014-09-10T12:00"),
        latitude_rad=math.radians(71.29),
    )
    (row,) = np.flatnonzero(sounding.pressure_pa == 94071.0)
    assert_allclose(sounding.temperature_k[row], 269.7)
    assert_allclose(sounding.vapour_pressure_pa[row], 463.6)
    assert sounding.h_m[row] == pytest.approx(metres(652.0, 71.29), abs=0.1)
    assert counts(ledger)["SOUNDING-CUT-OFF"] == 1
    assert ledger.has_losses


@pytest.mark.parametrize(
    ("name", "degrees", "time", "levels"),
    [
        (
            "wyoming_csv_BOI_20101209_12Z.csv",
            43.56,
            "2010-12-09T11:06",
            "850 1509 3.8 1.2, 500 5600 -20.9 -59.1",
        ),
        (
            "metpy_20110522_OUN_12Z.txt",
            35.18,
            "2011-05-22T12:00",
            "850 1454 22.0 6.0",
        ),
    ],
)
def test_wyoming(files, name, degrees, time, levels):
    sounding, _ = from_file(files / name, degrees)
    assert sounding.time_ns == ns(time)
    check_levels(sounding, degrees, levels)


def test_wyoming_without_a_place_and_with_a_missing_height(files):
    sounding, notes = from_file(files / "wyoming_csv_82244_20120101_00Z.csv", -2.43)
    assert math.isnan(sounding.longitude_rad)
    assert notes == {"SOUNDING-HEIGHTS": 1}
    # 1002.0 hPa, 2 hPa below 74 m: 17.6 m by hand, with Tv of 305.2 K.
    lowest_m = 74.0 - 29.27 * 305.2 * math.log(1.002)
    assert sounding.h_m[0] == pytest.approx(metres(lowest_m, -2.43), abs=0.3)
    check_levels(sounding, -2.43, "850 1505 18.8 16.8")


def test_arm_netcdf(files):
    sounding, _ = from_file(files / "sgpsondewnpnC1.b1.20190101.053200.cdf")
    assert sounding.h_m[0] == pytest.approx(metres(314.8, 36.61), abs=0.01)
    assert sounding.h_m[-1] == pytest.approx(metres(24_569.5, 36.61), abs=0.5)
    assert sounding.pressure_pa[0] == pytest.approx(98699.0, abs=1.0)
    assert sounding.temperature_k[0] == pytest.approx(269.85, abs=1e-3)
    assert sounding.vapour_pressure_pa[0] == saturated(-7.27)
    assert sounding.time_ns == ns("2019-01-01T05:32")
    assert sounding.h_m.size > (4000 if files == SHARED_SOUNDINGS else 50)


# What follows is made here: an isothermal-lapse air whose pressures come from its own formula.

HEIGHTS = np.arange(0.0, 6000.0, 500.0)
LEVELS = HEIGHTS.size
ZEROS = np.zeros(LEVELS)


def standard_hpa(h):
    return 1013.25 * (1.0 - 0.0065 * np.asarray(h) / 288.15) ** 5.25588


def lapsing(lowest):
    """Temperatures or dew points of the levels, in the unit of the lowest."""
    return lowest - 0.0065 * HEIGHTS


PRESSURES = standard_hpa(HEIGHTS)
CLEAN = pd.DataFrame(
    {
        "geopotential_m": HEIGHTS,
        "pressure_hpa": PRESSURES,
        "temperature_c": lapsing(15.0),
        "dew_point_c": lapsing(5.0),
    }
)
NO_HEIGHTS = {"geopotential_m": None}
NO_DEW_POINT = {"dew_point_c": None}
EXCHANGED = {"temperature_c": lapsing(5.0), "dew_point_c": lapsing(15.0)}


def air(**columns):
    """Levels every 500 geopotential metres; columns replaced, or left out where None."""
    return CLEAN.assign(**columns).dropna(axis="columns", how="all")


def text_of(levels):
    return levels.to_csv(index=False, float_format="%.8g").rstrip()


CLEAN_TEXT = text_of(CLEAN)


def with_columns(names, fields, text=CLEAN_TEXT):
    """A table with more columns, the same in each row."""
    head, *rows = text.splitlines()
    return "\n".join([f"{head},{names}", *(f"{row},{fields}" for row in rows)])


def read(levels, **options):
    return parsed(text_of(levels), **options)


def changed(name, row, value):
    levels = CLEAN.copy()
    levels.loc[row, name] = value
    return levels


def parsed_with_messages(levels):
    ledger = Ledger()
    sounding = parse_sounding(text_of(levels), ledger, latitude_rad=0.8)
    return sounding, ledger


@pytest.fixture(scope="module")
def clean():
    sounding, notes = read(CLEAN)
    assert notes == {}
    return sounding


def test_a_clean_csv_needs_no_repair(clean):
    assert_allclose(clean.pressure_pa, 100.0 * PRESSURES)
    assert clean.temperature_k[0] == 288.15
    assert clean.h_m[-1] == pytest.approx(metres(5500.0, 45.0), abs=0.1)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_csv_with_decimal_commas_is_the_same(clean, separator):
    sounding, _ = parsed(CLEAN_TEXT.replace(",", separator).replace(".", ","))
    assert sounding.pressure_pa == pytest.approx(clean.pressure_pa, rel=1e-9)
    assert sounding.temperature_k == pytest.approx(clean.temperature_k, rel=1e-9)


def test_geometric_heights_stay():
    sounding, notes = read(air(**NO_HEIGHTS, h_m=HEIGHTS))
    assert sounding.h_m == pytest.approx(HEIGHTS, abs=1e-6)
    assert notes == {}


def test_pascals_and_kelvins_say_the_same(clean):
    levels = air(
        pressure_hpa=None,
        temperature_c=None,
        pressure_pa=100.0 * PRESSURES,
        temperature_k=lapsing(288.15),
    )
    sounding, _ = read(levels)
    assert sounding.pressure_pa == pytest.approx(clean.pressure_pa)
    assert sounding.temperature_k == pytest.approx(clean.temperature_k)
    assert sounding.vapour_pressure_pa == pytest.approx(clean.vapour_pressure_pa)


SATURATED_PA = saturation_pressure_pa(lapsing(288.15))


@pytest.mark.parametrize(
    ("column", "values", "vapour_pa"),
    [
        ("dew_point_k", lapsing(278.15), saturation_pressure_pa(lapsing(278.15))),
        ("relative_humidity", ZEROS + 0.4, 0.4 * SATURATED_PA),
        ("relative_humidity_percent", ZEROS + 40.0, 0.4 * SATURATED_PA),
        ("vapour_pressure_pa", ZEROS + 100.0, ZEROS + 100.0),
        ("vapour_pressure_hpa", ZEROS + 1.0, ZEROS + 100.0),
        ("wind_m_s", ZEROS, ZEROS + np.nan),
    ],
)
def test_humidities_in_their_units(column, values, vapour_pa):
    sounding, _ = read(air(**NO_DEW_POINT, **{column: values}))
    assert sounding.vapour_pressure_pa == pytest.approx(vapour_pa, rel=0.01, nan_ok=True)


@pytest.mark.parametrize(
    "order",
    [
        range(LEVELS)[::-1],
        [3, 0, 1, 2, *range(4, LEVELS)],
    ],
)
def test_unsorted_levels_are_sorted(clean, order):
    sounding, notes = read(CLEAN.loc[order])
    assert set(notes) == {"SOUNDING-UNSORTED"}
    assert np.array_equal(sounding.h_m, clean.h_m)
    assert np.array_equal(sounding.temperature_k, clean.temperature_k)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"pressure_hpa": None, "pressure_pa": PRESSURES}, "hPa where Pa is stated"),
        ({"pressure_hpa": 100.0 * PRESSURES}, "Pa where hPa is stated"),
        ({"temperature_c": lapsing(288.15)}, "Kelvin where Celsius is stated"),
        ({"temperature_c": None, "temperature_k": lapsing(15.0)}, "Celsius where Kelvin"),
        ({"temperature_c": 32.0 + 1.8 * lapsing(38.0)}, "Fahrenheit"),
        ({"dew_point_c": lapsing(278.15)}, "dew point"),
        (NO_DEW_POINT | {"relative_humidity": ZEROS + 55.0}, "fraction of one"),
        (NO_DEW_POINT | {"relative_humidity_percent": ZEROS + 0.55}, "fraction of one"),
        (NO_DEW_POINT | {"vapour_pressure_hpa": ZEROS + 850.0}, "vapour pressure"),
        ({"dew_point_c": 4.0 + 0.002 * HEIGHTS}, "depressions"),
        # In frost depressions are above all temperatures.
        (
            {"temperature_c": lapsing(-5.0), "dew_point_c": 2.0 + 0.002 * HEIGHTS},
            "depressions",
        ),
        (EXCHANGED, "temperature and dew point seem exchanged"),
        # Moist air: 1.5 K are less than half as much vapour again.
        (
            {"temperature_c": lapsing(13.5), "dew_point_c": lapsing(15.0)},
            "above the temperature in 100 % of the levels",
        ),
        # As warm as that only depressions are never negative.
        (
            {"temperature_c": lapsing(-5.0), "dew_point_c": 40.0 - 0.0065 * HEIGHTS},
            "temperature and dew point seem exchanged",
        ),
    ],
)
def test_wrong_units_are_refused(columns, words):
    with input_refused("SOUNDING-UNITS", words) as caught:
        read(air(**columns))
    assert caught.value.where


@pytest.mark.parametrize(
    "dew_point_c",
    [
        lapsing(15.9),  # rounding, and sensors in cloud
        np.where(HEIGHTS < 3000.0, lapsing(17.0), lapsing(10.0)),  # half of the levels
    ],
)
def test_dew_points_a_little_above_temperatures_are_kept(dew_point_c):
    _, notes = read(air(dew_point_c=dew_point_c))
    assert "SOUNDING-HUMIDITY-OVER" in notes


@pytest.mark.parametrize(
    "columns",
    [
        {"geopotential_m": HEIGHTS / 0.3048},
        {"temperature_c": 32.0 + 1.8 * lapsing(15.0)},  # 59 F looks like a hot day
        {"geopotential_m": HEIGHTS[::-1]},
    ],
    ids=["feet", "Fahrenheit", "falling"],
)
def test_heights_that_contradict_the_air_are_refused(columns):
    with input_refused("SOUNDING-INCONSISTENT"):
        read(air(**columns))


@pytest.mark.parametrize(
    ("warmer_k", "lower_hpa"), [(1.0, 0.0), (0.0, 0.5)], ids=["same pressure", "same height"]
)
def test_duplicate_levels_are_averaged(warmer_k, lower_hpa):
    levels = CLEAN.loc[[*range(4), *range(3, LEVELS)]].reset_index(drop=True)
    levels.loc[4, "temperature_c"] += warmer_k
    levels.loc[4, "pressure_hpa"] -= lower_hpa
    sounding, notes = read(levels)
    assert notes["SOUNDING-DUPLICATE"] == 1
    assert_allclose(sounding.temperature_k[3], 288.15 - 9.75 + 0.5 * warmer_k)
    mean_pa = 100.0 * (standard_hpa(1500.0) - 0.5 * lower_hpa)
    assert_allclose(sounding.pressure_pa[3], mean_pa)


@pytest.mark.parametrize(
    ("percent", "counted"),
    [
        ({1: 104.0, 5: 101.0}, {"SOUNDING-HUMIDITY-OVER": 2}),
        ({1: -3.0, 5: 101.0}, {"SOUNDING-HUMIDITY-OVER": 1, "SOUNDING-HUMIDITY-NEGATIVE": 1}),
    ],
)
def test_humidity_that_no_air_has_is_clipped_or_unknown(percent, counted):
    humidity = np.full(LEVELS, 60.0)
    for row, value in percent.items():
        humidity[row] = value
    expected_pa = np.select(
        [humidity < 0.0, humidity > 100.0],
        [np.nan, SATURATED_PA],
        0.6 * SATURATED_PA,
    )
    sounding, notes = read(air(**NO_DEW_POINT, relative_humidity_percent=humidity))
    assert notes == counted
    assert sounding.vapour_pressure_pa == pytest.approx(expected_pa, rel=0.01, nan_ok=True)


def test_a_dew_point_over_the_temperature_is_saturation():
    sounding, notes = read(changed("dew_point_c", 2, 14.0))
    assert notes == {"SOUNDING-HUMIDITY-OVER": 1}
    assert_allclose(sounding.vapour_pressure_pa[2], SATURATED_PA[2], rtol=0.01)


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("temperature_c", 1e308, "SOUNDING-MISSING"),
        ("temperature_c", -9999.0, "SOUNDING-MISSING"),
        ("temperature_c", -99.0, "SOUNDING-MISSING"),
        ("temperature_c", -99.9, "SOUNDING-MISSING"),
        ("temperature_c", -99.99, "SOUNDING-MISSING"),
        ("temperature_c", 500.0, "SOUNDING-RANGE"),
        ("temperature_c", -273.0, "SOUNDING-RANGE"),
        ("pressure_hpa", math.nan, "SOUNDING-MISSING"),
        ("pressure_hpa", 95_000.0, "SOUNDING-RANGE"),
        ("geopotential_m", 300.0, "SOUNDING-ORDER"),
        ("geopotential_m", 5200.0, "SOUNDING-ORDER"),
        ("geopotential_m", 1e6, "SOUNDING-ORDER"),
    ],
)
def test_one_wild_number_takes_one_level_with_it(clean, name, value, code):
    """Of twelve levels one is rubbish: it is counted, and the others stay as they are."""
    sounding, (entry,) = parsed_with_messages(changed(name, 3, value))
    assert entry.code == code
    assert entry.count == 1
    assert (entry.kind is Kind.LOSS) is (code == "SOUNDING-RANGE")
    expected = np.delete(clean.temperature_k, 3)
    assert sounding.temperature_k == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "value", "values"),
    [
        ("temperature_c", 500.0, {"hpa": PRESSURES[3], "kelvin": 773.15}),
        ("geopotential_m", 5200.0, {"height_m": 5200.0, "hpa": PRESSURES[3]}),
        ("dew_point_c", 400.0, {"first": 673.15}),
        ("temperature_c", math.nan, {"total": 12}),
    ],
)
def test_what_is_wrong_is_told_in_the_unit_of_its_text(name, value, values):
    _, (entry,) = parsed_with_messages(changed(name, 3, value))
    assert entry.values == pytest.approx(values)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("geopotential_m", 1e300, {"SOUNDING-HEIGHTS": 1}),
        ("dew_point_c", 400.0, {"SOUNDING-HUMIDITY-RANGE": 1}),
        ("dew_point_c", 99_999.0, {}),
        ("dew_point_c", -99.0, {}),
        ("dew_point_c", -99.9, {}),
        ("dew_point_c", -99.99, {}),
    ],
)
def test_a_wild_height_or_dew_point_takes_no_level_with_it(clean, name, value, expected):
    sounding, notes = read(changed(name, 3, value))
    assert notes == expected
    assert sounding.h_m == pytest.approx(clean.h_m, abs=0.5)
    assert np.isnan(sounding.vapour_pressure_pa[3]) == (name == "dew_point_c")


def in_balance(h, celsius):
    """Levels in balance with a temperature: pressures by trapezoids of 1/T over a metre."""
    fine = np.arange(0.0, h[-1] + 1.0)
    t = np.interp(fine, h, celsius) + 273.15
    steps = HYDROSTATIC_K_PER_M / (0.5 * (t[1:] + t[:-1]))
    fall = np.cumsum([0.0, *steps])
    hpa = np.interp(h, fine, 1010.0 * np.exp(-fall))
    return pd.DataFrame({"geopotential_m": h, "pressure_hpa": hpa, "temperature_c": celsius})


@pytest.mark.parametrize(
    ("celsius", "text"),
    [
        # 13 K/km over 300 m by day.
        ("33.0 32.8 29.0 25.1 21.5 14.0 7.0", ""),
        # Above a desert, 3 K in the first 20 m: n grows with height.
        ("35.0 32.0 29.5 27.0 24.0 17.0 10.0", ""),
        # 9.76 K/km are 2.9 K from the ground to 300 m: 44.3 - 29.6 - 2.9 = 11.8.
        ("44.3 32.5 29.6 26.7 22.8 16.0 9.0", ""),
        ("44.8 32.5 29.6 26.7 22.8 16.0 9.0", r"from 0 to \d+ m .* by 12\.\d K more"),
        ("22.0 21.8 19.0 16.1 12.2 2.0 -7.7", ""),
        ("22.0 21.8 19.0 16.1 12.2 0.2 -9.5", r"from 1000 to \d+ m .* by 2\.\d K more"),
    ],
)
def test_steep_layers_are_kept_and_told_where_no_sonde_measures_them(celsius, text):
    h = np.array([0.0, 20.0, 300.0, 600.0, 1000.0, 2000.0, 3000.0])
    t = np.array(celsius.split(), float)
    sounding, ledger = parsed_with_messages(in_balance(h, t))
    assert_allclose(sounding.temperature_k, t + 273.15)
    entries = with_code(ledger, "SOUNDING-SUPERADIABATIC")
    assert len(entries) == bool(text)
    for entry in entries:
        assert re.search(text, entry.what)


@pytest.mark.parametrize(
    ("base", "share", "told"),
    [(0.0, 0.035, False), (0.0, 0.045, True), (600.0, 0.005, False), (600.0, 0.008, True)],
)
def test_an_index_that_rises_more_than_over_hot_ground_is_told(base, share, told):
    """n - 1 is proportional to p/T; over 20 m p falls by 0.0341632 K/m times 20 m over T."""
    h = np.array([0.0, 20.0, 600.0, 620.0, 1000.0, 2000.0, 3000.0])
    celsius = 20.0 - 0.0065 * h
    kelvin_above = celsius[h == base + 20.0][0] + 273.15
    pressure_ratio = math.exp(20.0 * HYDROSTATIC_K_PER_M / kelvin_above)
    celsius[h == base] = kelvin_above * (1.0 + share) * pressure_ratio - 273.15
    _, notes = read(in_balance(h, celsius))
    assert ("SOUNDING-INDEX-RISES" in notes) is told


@pytest.mark.parametrize(("humidity", "within_m"), [({}, 9.0), (NO_DEW_POINT, 1.0)])
def test_heights_worked_out_from_the_station(humidity, within_m):
    """Moist: up to 9 m more than the dry air of the heights column; and 1 m of trapezoids."""
    sounding, notes = read(air(**NO_HEIGHTS, **humidity), station_h_m=0.0)
    assert notes == {"SOUNDING-HEIGHTS": LEVELS - 1}
    expected = [metres(h, 45.0) for h in HEIGHTS]
    assert sounding.h_m == pytest.approx(expected, abs=within_m)


def test_without_latitude_it_is_said():
    _, notes = read(CLEAN, degrees=math.nan)
    assert notes == {"SOUNDING-LATITUDE": 0}


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("", "SOUNDING-FORMAT", ""),
        ("lorem ipsum", "SOUNDING-FORMAT", "lorem ipsum"),
        ("h_m,pressure_hpa,pressure_hpa,temperature_c\n", "SOUNDING-COLUMN", "pressure_hpa"),
        ("h_m,pressure_hpa,temperature_c\n", "SOUNDING-EMPTY", ""),
        (CLEAN_TEXT + ",1,2\n", "SOUNDING-EMPTY", "its first row has 4 fields"),
        (text_of(CLEAN.head(4)), "SOUNDING-LEVELS", "4 levels"),
        (text_of(air(**NO_HEIGHTS)), "SOUNDING-HEIGHT", ""),
        (text_of(air(pressure_pa=100.0 * PRESSURES)), "SOUNDING-COLUMN", "pressure_pa"),
        ("pressure,temperature_c\n1000,15\n", "SOUNDING-COLUMN", "pressure"),
    ],
    ids=lambda value: value if str(value).startswith("SOUNDING") else "",
)
def test_no_sounding(text, code, words):
    with input_refused(code, words):
        parsed(text)


@pytest.mark.parametrize(
    ("format_name", "code", "remedy"),
    [
        ("grib", "SOUNDING-FORMAT", ", ".join(FORMATS)),
        ("wyoming_csv", "SOUNDING-COLUMN", ""),
        ("csv", "SOUNDING-COLUMN", "pressure_pa or pressure_hpa"),
    ],
)
def test_a_text_that_is_not_of_the_stated_format(format_name, code, remedy):
    with input_refused(code) as caught:
        parsed(text_of(air(pressure_hpa=None)), format_name=format_name)
    assert remedy in caught.value.remedy


@pytest.mark.parametrize("name", ["igra", "igra_derived"])
@pytest.mark.parametrize("text", [CLEAN_TEXT, "", "one line\n"])
def test_no_line_of_a_text_is_a_header_of_igra(name, text):
    with input_refused("SOUNDING-FORMAT") as caught:
        parsed(text, format_name=name, where="b.csv")
    assert "b.csv" in caught.value.where


# Times and places of a plain CSV


def dated(time):
    return parsed(with_columns("time_utc", time))


@pytest.mark.parametrize(
    "text", ["2025-06-12T09:00:00Z", "2025-06-12T11:00:00+02:00", "2025-06-12 09:00"]
)
def test_times_of_a_csv(text):
    sounding, notes = dated(text)
    assert sounding.time_ns == ns("2025-06-12T09:00")
    assert "2025-06-12T09:00" in sounding.name
    assert notes == {}


@pytest.mark.parametrize("text", ["", "NaN"])
def test_a_time_that_is_not_stated_is_unknown(text):
    sounding, notes = dated(text)
    assert sounding.time_ns is None
    assert sounding.name == "sounding"
    assert notes == {}


@pytest.mark.parametrize(
    "text",
    [
        "12.06.2025 09:00",
        "3025-06-12T09:00:00Z",
        "0001-01-01",
        "noon",
        "2025-06-12",  # a date without its hour
        "20250612",
        "2025-W24-4",
    ],
)
def test_a_time_that_is_stated_and_cannot_be_read_is_refused(text):
    with input_refused("SOUNDING-TIME", text):
        dated(text)


def at_place(north, east):
    """A plain CSV with a place in its columns, as it is read."""
    text = with_columns("latitude_deg,longitude_deg", f'"{north}","{east}"')
    sounding, _ = parsed(text)
    return sounding


@pytest.mark.parametrize(
    ("east", "degrees"),
    {
        "16.35": 16.35,
        "-70.5": -70.5,
        "289.5": -70.5,
        "180": 180.0,
        "359.99": -0.01,
        "16,35": 16.35,
    }.items(),
)
def test_longitudes_of_either_kind(east, degrees):
    assert_allclose(math.degrees(at_place("48.2", east).longitude_rad), degrees)


@pytest.mark.parametrize(
    ("north", "east"), [("", ""), ("-9999", "-9999"), ("-99.99", "-99.99"), ("", "8.3")]
)
def test_a_place_that_is_not_stated_is_unknown(north, east):
    assert math.isnan(at_place(north, east).longitude_rad)


@pytest.mark.parametrize(
    ("north", "east"),
    {"48 14": "16 21", "48.2": "361", "98.2": "16.35", "48.2N": "16.35E"}.items(),
)
def test_a_place_that_is_stated_and_cannot_be_read_is_refused(north, east):
    with input_refused("SOUNDING-PLACE"):
        at_place(north, east)


# Several ascents in one table


def rows_of(*, warmer_k=0.0, identity=""):
    """Ten levels of an ascent; pressure, temperature and what says which ascent it is."""
    return [
        f"{950.0 - 45.0 * level},{15.0 - 2.5 * level + warmer_k}{identity}" for level in range(10)
    ]


def table_of(rows, columns=""):
    return "\n".join([f"pressure_hpa,temperature_c{columns}", *rows])


def at_station(text, when=""):
    return parsed(text, when, station_h_m=540.0)


@pytest.mark.parametrize("hours", [2, 5])
@pytest.mark.parametrize("interleaved", [False, True])
def test_of_two_ascents_in_one_table_the_nearest_in_time(hours, interleaved):
    early = rows_of(identity=",2025-06-12T06:00:00Z")
    late = rows_of(warmer_k=5.0, identity=f",2025-06-12T{6 + hours:02d}:00:00Z")
    rows = np.ravel([early, late], order="F" if interleaved else "C")
    text = table_of(rows, ",time_utc")
    for hour, celsius in (("05", 15.0), ("13", 20.0)):
        sounding, notes = at_station(text, f"2025-06-12T{hour}:00")
        assert_allclose(sounding.temperature_k[0], celsius + 273.15)
        assert sounding.h_m.size == 10
        assert notes["SOUNDING-CHOSEN"] == 2
    with input_refused("SOUNDING-CHOICE", "2 soundings, and no time"):
        at_station(text)


@pytest.mark.parametrize("levels", [4, 6])
def test_an_ascent_that_ended_early_is_not_mixed_with_another(levels):
    early = rows_of(identity=",2025-06-12T11:00:00Z")[:levels]
    late = rows_of(warmer_k=5.0, identity=",2025-06-12T12:00:00Z")
    text = table_of([*early, *late], ",time_utc")
    sounding, notes = at_station(text, "2025-06-12T13:00")
    assert_allclose(sounding.temperature_k[0], 20.0 + 273.15)
    assert notes["SOUNDING-CHOSEN"] == 2


@pytest.mark.parametrize(
    ("columns", "first", "second"),
    [
        (",station", ",11035", ",11520"),
        (",ascent,time_utc", ",a,2025-06-12T06:00Z", ",b,2025-06-12T06:00Z"),
        (",lat,lon", ",48.2,16.4", ",50.0,14.4"),
        ("", "", ""),
    ],
)
def test_two_ascents_of_one_time_in_one_table_are_refused(columns, first, second):
    rows = rows_of(identity=first) + rows_of(warmer_k=5.0, identity=second)
    with input_refused("SOUNDING-CHOICE"):
        at_station(table_of(rows, columns), "2025-06-12T05:00")


def test_rows_too_long_apart_are_refused():
    """Each level has its own time: no column parts the ascents, but none takes 13 hours."""
    rows = [f"{row},2025-06-12T{k + 5:02d}:00:00Z" for k, row in enumerate(rows_of())]
    with input_refused("SOUNDING-CHOICE", "up to 9.0 hours apart"):
        at_station(table_of(rows, ",time_utc"))


def test_up_and_down_again_is_one_flight():
    """As a drone flies: its levels are put in order. Each may have its own time and place."""
    up = rows_of()
    rows = [f"{row},48.{number:02d},16.4" for number, row in enumerate(up + up[::-1])]
    sounding, notes = at_station(table_of(rows, ",lat,lon"))
    assert sounding.h_m.size == 10
    assert set(notes) >= {"SOUNDING-UNSORTED", "SOUNDING-DUPLICATE"}
    assert_allclose(math.degrees(sounding.latitude_rad), 48.0)


def test_minutes_in_which_a_drone_turns_are_of_one_ascent():
    """In the first minutes up to the eighth level, in the last ones to the tenth and down again."""
    up = rows_of()
    first = [f"{row},2025-06-12T11:00:00Z" for row in up[:8]]
    last = [f"{row},2025-06-12T11:10:00Z" for row in [*up[7:], *up[:3:-1]]]
    sounding, notes = at_station(table_of([*first, *last], ",time_utc"), "2025-06-12T13:00")
    assert sounding.h_m.size == 10
    assert "SOUNDING-CHOSEN" not in notes


@pytest.mark.parametrize(
    ("column", "field"),
    {
        "time": "2025-06-12T06:00:00Z",
        "datetime": "2025-06-12 06:00",
        "date": "20250612",
        "valid": "06/12/2025 06:00",
    }.items(),
)
def test_a_time_in_a_column_of_another_name_is_not_unknown(column, field):
    with input_refused("SOUNDING-TIME") as caught:
        parsed(with_columns(column, field))
    assert "time_utc" in caught.value.remedy


@pytest.mark.parametrize(
    ("column", "field"), [("time_s", "120"), ("time", "120.5"), ("wind", "12")]
)
def test_numbers_of_another_column_are_no_time(column, field):
    _, notes = parsed(with_columns(column, field))
    assert notes == {"SOUNDING-COLUMNS-UNUSED": 1}


# The list of the University of Wyoming

WYOMING_PAGE = """<HTML><H2>72357 OUN Norman Observations at 12Z 22 May 2011</H2><PRE>
-----------------------------------------------------------------------------
   PRES   HGHT   TEMP   DWPT   RELH   MIXR   DRCT   SKNT   THTA   THTE   THTV
    hPa     m      C      C      %    g/kg    deg   knot     K      K      K
-----------------------------------------------------------------------------
 1000.0     47
  966.0    345   22.2   21.0     93  16.54    180      6  298.3  346.4  301.3
  925.0    720   20.4   20.4    100  16.63    200     31  300.1  349.0  303.1
  896.0    995   18.8          100  15.51    206     35  301.2  347.1  304.0
  850.0   1454   22.0    6.0     35   6.92    220     32  309.2  331.4  310.5
  700.0   3096    7.6   -9.4     29   2.63    245     49  310.9  320.0  311.4
  500.0   5820  -10.7  -30.7     18   0.56    250     50  319.9  322.2  320.1
</PRE><H3>Station information and sounding indices</H3><PRE>
                         Station identifier: OUN
                             Station number: 72357
                           Observation time: 110522/1200
                           Station latitude: 35.18
                          Station longitude: -97.44
</PRE></HTML>"""


def test_wyoming_page_with_blank_fields():
    sounding, notes = parsed(WYOMING_PAGE)
    assert sounding.station == "OUN"
    assert sounding.time_ns == ns("2011-05-22T12:00")
    assert_allclose(math.degrees(sounding.latitude_rad), 35.18)
    assert notes == {"SOUNDING-MISSING": 1}
    # Without a dew point the relative humidity is taken: at 896 hPa 100 % of 18.8 C.
    check_levels(sounding, 35.18, "850 1454 22.0 6.0, 896 995 18.8 18.8")
    assert sounding.h_m.size == 6


def wyoming_of(heading, station="", levels=8):
    """A list of the University of Wyoming under a heading, with lines on its station after it."""
    rule = "-" * 77
    titles = "   PRES   HGHT   TEMP   DWPT   RELH\n    hPa     m      C      C      %"
    lines = [rule, titles, rule]
    for h in range(200, 200 + 500 * levels, 500):
        celsius = 15.0 - 0.0065 * h
        lines.append(f"{standard_hpa(h):7.1f}{h:7d}{celsius:7.1f}{celsius - 10.0:7.1f}{50:7d}")
    table = "\n".join(lines)
    return f"<H1>{heading}</H1>\n<PRE>\n{table}\n</PRE>\n{station}\n"


NEW_HEADING = "Observations for Station 11035 at 12 UTC 12 Mar 2015"
OLD_HEADING = "11035 Wien Observations at 12Z 12 Mar 2015"


@pytest.mark.parametrize(
    ("heading", "station", "time"),
    [
        (NEW_HEADING, "", "2015-03-12T12:00"),
        ("Observations for Station 11035 at 12:00 UTC 12 Mar 2015", "", "2015-03-12T12:00"),
        ("Observations for Station 11035 at 1130 UTC 12 March 2015", "", "2015-03-12T11:30"),
        ("OBSERVATIONS FOR STATION 11035 AT 06Z 12 MAR 2015", "", "2015-03-12T06:00"),
        ("Sounding of 11035, 12 UTC 12 Mar 2015", "", "2015-03-12T12:00"),
        (OLD_HEADING, "Observation time: 150312/1137", "2015-03-12T11:37"),
        # Two digits of the year: the archive begins in 1973.
        ("", "Observation time: 730101/1200", "1973-01-01T12:00"),
        ("", "Observation time: 991231/1200", "1999-12-31T12:00"),
    ],
)
def test_forms_of_times_of_a_page(heading, station, time):
    sounding, _ = parsed(wyoming_of(heading, station))
    assert sounding.time_ns == ns(time)


@pytest.mark.parametrize(
    ("heading", "station", "words"),
    [
        ("Observations for Station 11035 at noon", "", "noon"),
        ("11035 Wien Observations at 12Z 12 Mrz 2015", "", "12 Mrz 2015"),
        ("11035 2015031212", "", "20150312"),
        ("Wien, 12 UTC March 12, 2015", "", "March 12, 2015"),
        ("", "Observation time: 150312/12", "150312/12"),
        ("", "Observation time: 151312/1200", "2015-13-12"),
        ("", "Observation time: noon", "noon"),
        (OLD_HEADING, "Observation time: 140312/1200", "differ by"),
        (OLD_HEADING, "Observation time: 150312/0000", "differ by"),
    ],
)
def test_a_time_of_a_page_that_cannot_be_read_or_contradicts_is_refused(heading, station, words):
    with input_refused("SOUNDING-TIME", words):
        parsed(wyoming_of(heading, station))


@pytest.mark.parametrize(
    "place",
    [
        "<I>Latitude: 48.2333 Longitude: 16.35</I>",
        "Latitude = 48.2333, Longitude = 16.35",
        "Lat: 48.2333 Lon: 16.35",
    ],
)
def test_the_present_page_has_station_and_place_in_its_head(place):
    sounding, _ = parsed(wyoming_of(f"{NEW_HEADING}</H1>\n{place}\n<H1>"))
    assert sounding.station == "11035"
    assert_allclose(math.degrees(sounding.latitude_rad), 48.2333)
    assert_allclose(math.degrees(sounding.longitude_rad), 16.35)


@pytest.mark.parametrize(
    ("flight", "time", "levels"),
    [("2015-03-13T01", "2015-03-13T00:00", 9), ("2015-03-12T10", "2015-03-12T12:00", 8)],
)
def test_of_two_ascents_of_a_page_the_nearest_in_time(flight, time, levels):
    first = wyoming_of(OLD_HEADING, "Observation time: 150312/1200")
    second = wyoming_of("11035 Wien Observations at 00Z 13 Mar 2015", levels=9)
    sounding, _ = parsed(first + second, flight)
    assert sounding.time_ns == ns(time)
    assert sounding.h_m.size == levels


def test_of_two_stations_of_one_hour_none_is_guessed():
    vienna = wyoming_of(OLD_HEADING)
    prague = wyoming_of("11520 Praha Observations at 12Z 12 Mar 2015", levels=9)
    with input_refused("SOUNDING-CHOICE", "2 soundings of the file have the time"):
        parsed(vienna + prague, "2015-03-12T11:00")
    pasted_twice, _ = parsed(vienna + vienna, "2015-03-12T11:00")
    assert pasted_twice.h_m.size == 8


# The archive IGRA


def igra(date, hour, release, announced=6):
    """Six levels under a header of the archive."""
    lines = [
        f"#USM00070026 {date} {hour} {release} {announced:4d} ncdc6301 ncdc6301  712889 -1567833"
    ]
    for h in HEIGHTS[:6]:
        pascals = 100 * round(float(standard_hpa(h)))
        tenths = 150.0 - 0.065 * h
        lines.append(f"20 -9999 {pascals:6d} {h:5.0f}B{tenths:5.0f}B-9999    20 -9999 -9999 ")
    return "\n".join([*lines, ""])


NOON = igra("2010 06 01", "12", "9999")
THREE_ASCENTS = igra("2010 06 01", "00", "2303") + NOON + igra("2010 06 02", "99", "1805")


@pytest.mark.parametrize(
    ("when", "released"),
    [
        ("2010-06-01T02:00", "2010-05-31T23:03"),
        ("2010-06-01T10:00", "2010-06-01T12:00"),
        ("2010-06-02T17:00", "2010-06-02T18:05"),
    ],
)
def test_igra_choice_and_release(when, released):
    sounding, _ = parsed(THREE_ASCENTS, when)
    assert sounding.time_ns == ns(released)


UNDATED = igra("2010 06 01", "99", "9999")


@pytest.mark.parametrize(
    ("text", "when", "code", "place"),
    [
        (THREE_ASCENTS, "", "SOUNDING-CHOICE", ""),
        (UNDATED + UNDATED, "2010-06-01", "SOUNDING-CHOICE", ""),
        (NOON + "#garbage\n", "", "SOUNDING-FORMAT", "line 8"),
        (NOON.splitlines()[0], "", "SOUNDING-EMPTY", ""),
        (igra("2010 13 01", "12", "1137"), "", "SOUNDING-TIME", "line 1"),
    ],
    ids=["no time", "undated", "no header", "a header alone", "no date"],
)
def test_what_no_file_of_the_archive_has_is_refused(text, when, code, place):
    with input_refused(code) as caught:
        parsed(text, when)
    assert place in caught.value.where


def test_igra_cut_off():
    ledger = Ledger()
    text = igra("2010 06 01", "12", "9999", announced=40)
    parse_sounding(text, ledger, time_ns=ns("2010-06-03T12:00"))
    assert counts(ledger) == {"SOUNDING-TRUNCATED": 34}
    assert ledger.has_losses


# Files


def sonde_file(folder, columns, base_time=None):
    """A netCDF file with the names of ARM."""
    path = folder / "sonde.cdf"
    with netcdf_file(path, "w") as file:
        file.createDimension("time", LEVELS)
        for name, column in columns.items():
            file.createVariable(name, "f4", ("time",))[:] = column
        if base_time is not None:
            file.createVariable("base_time", "i4", ())[...] = base_time
            file.createVariable("time_offset", "f8", ("time",))[:] = -9999.0
    return path


SONDE = {
    "pres": PRESSURES,
    "tdry": lapsing(15.0),
    "alt": HEIGHTS,
    "dp": lapsing(5.0),
    "rh": ZEROS + 50.0,
}


def test_fill_values_of_netcdf(tmp_path):
    filled = {
        "tdry": np.where(HEIGHTS == 1000.0, -9999.0, SONDE["tdry"]),
        "dp": np.where(HEIGHTS == 2000.0, -9999.0, SONDE["dp"]),
    }
    sounding, notes = from_file(sonde_file(tmp_path, SONDE | filled), 45.0)
    assert notes == {"SOUNDING-MISSING": 1}
    assert sounding.time_ns is None
    assert sounding.name == "sounding sonde.cdf"
    # The relative humidity stands in where the dew point is missing: 50 % of 2.0 C.
    assert sounding.vapour_pressure_pa[3] == saturated(2.0, share=0.5)


def test_a_netcdf_without_a_variable_is_refused(tmp_path):
    with input_refused("SOUNDING-NETCDF", "no variable tdry"):
        from_file(sonde_file(tmp_path, {"pres": PRESSURES}))


@pytest.mark.parametrize("flight", ["2019-01-01T08:00", "2025-06-12T09"])
def test_a_netcdf_has_its_own_time(tmp_path, flight):
    path = sonde_file(tmp_path, SONDE, base_time=1_546_320_720)
    sounding, _ = from_file(path, 45.0, flight)
    assert sounding.time_ns == ns("2019-01-01T05:32")


def test_a_byte_order_mark_is_no_name_of_a_column(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(CLEAN_TEXT, encoding="utf-8-sig")
    sounding, _ = from_file(path, 45.0)
    assert sounding.h_m.size == LEVELS


@pytest.mark.parametrize(
    ("name", "data", "code"),
    [
        ("latin.csv", b"h_m,pressure_hpa\n\xb0", "SOUNDING-UNREADABLE"),
        ("netcdf4.nc", b"\x89HDF\r\n\x1a\n", "SOUNDING-NETCDF"),
        ("short.cdf", b"CDF\x01\x00\x00", "SOUNDING-NETCDF"),
        ("empty.cdf", b"CDF\x01" + bytes(28), "SOUNDING-NETCDF"),
    ],
)
def test_files_that_are_no_sounding(tmp_path, name, data, code):
    path = tmp_path / name
    path.write_bytes(data)
    with input_refused(code):
        from_file(path)


def test_a_file_that_is_absent_or_too_large(tmp_path):
    path = tmp_path / "s.csv"
    with input_refused("SOUNDING-UNREADABLE"):
        from_file(path)
    with path.open("wb") as file:
        file.truncate(LARGEST_BYTES + 1)
    with input_refused("SOUNDING-SIZE"):
        from_file(path)
