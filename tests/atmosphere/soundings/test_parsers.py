"""Soundings as files have them: real ones against lines read by eye, and what may be wrong."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from unbend.atmosphere.soundings import FORMATS, Sounding, parse_sounding
from unbend.errors import InputError
from unbend.messages import Kind, Ledger
from unbend.simulate.true_air import normal_gravity, saturation_pressure_pa
from unbend.tables import soundings as from_disk
from unbend.tables.soundings import read_sounding

SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "soundings"
EXCERPTS = Path(__file__).resolve().parents[2] / "data" / "sounding_files"
"""Some levels of each of the real files, in the files' own form."""

FOLDERS = (EXCERPTS, SHARED) if SHARED.is_dir() else (EXCERPTS,)


@pytest.fixture(params=FOLDERS, ids=lambda folder: "whole" if folder == SHARED else "excerpt")
def files(request: pytest.FixtureRequest) -> Path:
    """Folders of soundings as they are distributed."""
    return Path(request.param)


def ns(text: str) -> int:
    return int(np.datetime64(text, "ns").astype(np.int64))


def counts(ledger: Ledger) -> dict[str, int]:
    return {entry.code: entry.count for entry in ledger}


def metres(geopotential: float, degrees: float) -> float:
    """Height of a geopotential height [m'], by WGS84 normal gravity and Newton's iteration."""
    latitude = math.radians(degrees)
    h = geopotential
    for _ in range(5):
        work = (
            h
            / 6.0
            * sum(w * normal_gravity(latitude, x * h) for w, x in ((1, 0), (4, 0.5), (1, 1)))
        )
        h += (geopotential * 9.80665 - work) / normal_gravity(latitude, h)
    return h


def check_level(s: Sounding, degrees: float, hpa, geopotential, celsius, dew) -> None:
    """A line of the file, read by eye: pressure, height, temperature, dew point."""
    i = int(np.argmin(np.abs(s.pressure_pa - hpa * 100.0)))
    assert s.pressure_pa[i] == pytest.approx(hpa * 100.0, rel=1e-6)
    assert s.h_m[i] == pytest.approx(metres(geopotential, degrees), abs=0.15)
    assert s.temperature_k[i] == pytest.approx(celsius + 273.15, abs=1e-4)
    expected = float(saturation_pressure_pa(np.array(dew + 273.15)))
    # Sonntag over water against Davis with Ciddor's enhancement, 0.5 % of vapour pressure.
    assert s.vapour_pressure_pa[i] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("when", "first"),
    [
        ("2010-06-01T01:00", (1009.80, 12.0, 0.0, 0.0)),
        ("2010-06-01T12:00", (1008.40, 12.0, -1.7, -1.7)),
    ],
)
def test_igra_by_time(files, when, first):
    ledger = Ledger()
    s = read_sounding(files / "igra2_USM00070026_Barrow.txt", ledger, time_ns=ns(when))
    check_level(s, 71.2889, *first)
    assert s.station == "USM00070026"
    assert math.degrees(s.latitude_rad) == pytest.approx(71.2889)
    assert math.degrees(s.longitude_rad) == pytest.approx(-156.7833)
    assert counts(ledger)["SOUNDING-CHOSEN"] == 2
    # The file is cut off behind its third header.
    assert counts(ledger)["SOUNDING-CUT-OFF"] == 1
    # Wind levels without pressure: the archive's level type 30.
    assert counts(ledger)["SOUNDING-MISSING"] >= (90 if files == SHARED else 2)


def test_igra_levels_and_release(files):
    path = files / "igra2_USM00070026_Barrow.txt"
    s = read_sounding(path, Ledger(), time_ns=ns("2010-06-01T00:00"))
    check_level(s, 71.2889, 850.0, 1383.0, -3.5, -4.3)
    check_level(s, 71.2889, 300.0, 8939.0, -46.4, -62.3)
    # Released at 2303 for the sounding of 00 UTC: the evening before.
    assert s.time_ns == ns("2010-05-31T23:03")
    geopotential = np.array([12.0, 90.0, 309.0, 500.0])
    assert s.h_m[:4] == pytest.approx([metres(h, 71.2889) for h in geopotential], abs=0.01)


def test_igra_derived(files):
    path = files / "igra2_derived_USM00070026_Barrow.txt"
    ledger = Ledger()
    s = read_sounding(
        path, ledger, time_ns=ns("2014-09-10T12:00"), latitude_rad=math.radians(71.29)
    )
    i = int(np.flatnonzero(s.pressure_pa == 94071.0)[0])
    assert s.temperature_k[i] == pytest.approx(269.7)
    assert s.vapour_pressure_pa[i] == pytest.approx(463.6)
    assert s.h_m[i] == pytest.approx(metres(652.0, 71.29), abs=0.1)
    assert counts(ledger)["SOUNDING-CUT-OFF"] == 1
    assert ledger.has_losses


def test_wyoming(files):
    s = read_sounding(files / "wyoming_csv_BOI_20101209_12Z.csv", Ledger())
    check_level(s, 43.56, 850.0, 1509.0, 3.8, 1.2)
    check_level(s, 43.56, 500.0, 5600.0, -20.9, -59.1)
    assert s.time_ns == ns("2010-12-09T11:06")
    s = read_sounding(files / "wyoming_csv_OUN_20230522_12Z.csv", Ledger())
    check_level(s, 35.18, 700.0, 3132.0, 4.6, -0.1)
    s = read_sounding(
        files / "metpy_20110522_OUN_12Z.txt", Ledger(), latitude_rad=math.radians(35.18)
    )
    check_level(s, 35.18, 850.0, 1454.0, 22.0, 6.0)
    assert s.time_ns == ns("2011-05-22T12:00")


def test_wyoming_without_a_place_and_with_a_missing_height(files):
    ledger = Ledger()
    s = read_sounding(
        files / "wyoming_csv_82244_20120101_00Z.csv", ledger, latitude_rad=math.radians(-2.43)
    )
    assert math.isnan(s.longitude_rad)
    assert counts(ledger) == {"SOUNDING-HEIGHTS": 1}
    # 1002.0 hPa, 2 hPa below 74 m: 17.6 m by hand, with Tv of 305.2 K.
    assert s.h_m[0] == pytest.approx(metres(74.0 - 29.27 * 305.2 * math.log(1.002), -2.43), abs=0.3)
    check_level(s, -2.43, 850.0, 1505.0, 18.8, 16.8)


def test_arm_netcdf(files):
    s = read_sounding(files / "sgpsondewnpnC1.b1.20190101.053200.cdf", Ledger())
    assert s.h_m[0] == pytest.approx(metres(314.8, 36.61), abs=0.01)
    assert s.h_m[-1] == pytest.approx(metres(24_569.5, 36.61), abs=0.5)
    assert s.pressure_pa[0] == pytest.approx(98699.0, abs=1.0)
    assert s.temperature_k[0] == pytest.approx(269.85, abs=1e-3)
    assert s.vapour_pressure_pa[0] == pytest.approx(
        float(saturation_pressure_pa(np.array(273.15 - 7.27))), rel=0.01
    )
    assert s.time_ns == ns("2019-01-01T05:32")
    assert s.h_m.size > (4000 if files == SHARED else 50)


# What follows is made here: an isothermal-lapse air whose pressures come from its own formula.

HEIGHTS = np.arange(0.0, 6000.0, 500.0)


def standard_hpa(h):
    return 1013.25 * (1.0 - 0.0065 * np.asarray(h) / 288.15) ** 5.25588


def air(**columns) -> dict[str, np.ndarray]:
    """Levels every 500 geopotential metres; columns replaced, or left out where None."""
    levels = {
        "geopotential_m": HEIGHTS,
        "pressure_hpa": standard_hpa(HEIGHTS),
        "temperature_c": 15.0 - 0.0065 * HEIGHTS,
        "dew_point_c": 5.0 - 0.0065 * HEIGHTS,
    } | columns
    return {name: np.asarray(column) for name, column in levels.items() if column is not None}


def text_of(levels: dict[str, np.ndarray], order=None) -> str:
    rows = np.column_stack(list(levels.values()))
    rows = rows if order is None else rows[order]
    lines = [",".join("" if math.isnan(v) else f"{v:.8g}" for v in row) for row in rows]
    return "\n".join([",".join(levels), *lines])


def read(levels: dict[str, np.ndarray], order=None, **options) -> tuple[Sounding, dict[str, int]]:
    ledger = Ledger()
    options = {"latitude_rad": math.radians(45.0)} | options
    sounding = parse_sounding(text_of(levels, order), ledger, **options)
    return sounding, counts(ledger)


def refusal(levels: dict[str, np.ndarray], **options) -> InputError:
    with pytest.raises(InputError) as caught:
        read(levels, **options)
    assert caught.value.where
    assert caught.value.remedy
    return caught.value


def changed(name: str, i: int, value: float) -> dict[str, np.ndarray]:
    column = air()[name].copy()
    column[i] = value
    return air(**{name: column})


def test_a_clean_csv_needs_no_repair():
    s, said = read(air())
    assert said == {}
    assert s.pressure_pa == pytest.approx(100.0 * standard_hpa(HEIGHTS), rel=1e-7)
    assert s.temperature_k[0] == 288.15
    assert s.h_m[-1] == pytest.approx(metres(5500.0, 45.0), abs=0.1)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_csv_with_decimal_commas_is_the_same(separator):
    text = text_of(air()).replace(",", separator).replace(".", ",")
    sounding = parse_sounding(text, Ledger(), latitude_rad=math.radians(45.0))
    plain, _ = read(air())
    assert sounding.pressure_pa == pytest.approx(plain.pressure_pa, rel=1e-9)
    assert sounding.temperature_k == pytest.approx(plain.temperature_k, rel=1e-9)


def test_a_csv_with_longer_rows_is_refused_by_name():
    text = text_of(air()) + ",1,2\n"
    with pytest.raises(InputError, match="SOUNDING-EMPTY") as caught:
        parse_sounding(text, Ledger(), latitude_rad=0.8)
    assert "its first row has 4 fields" in caught.value.what


def test_geometric_heights_stay():
    s, said = read(air(geopotential_m=None, h_m=HEIGHTS))
    assert s.h_m == pytest.approx(HEIGHTS, abs=1e-6)
    assert said == {}


def test_units_and_humidities_say_the_same():
    reference, _ = read(air())
    es = saturation_pressure_pa(reference.temperature_k)
    other, _ = read(
        air(
            pressure_hpa=None,
            temperature_c=None,
            dew_point_c=None,
            pressure_pa=reference.pressure_pa,
            temperature_k=reference.temperature_k,
            relative_humidity_percent=100.0 * reference.vapour_pressure_pa / es,
        )
    )
    assert other.temperature_k == pytest.approx(reference.temperature_k)
    assert other.vapour_pressure_pa == pytest.approx(reference.vapour_pressure_pa, rel=0.01)
    third, _ = read(air(dew_point_c=None, relative_humidity=reference.vapour_pressure_pa / es))
    assert third.vapour_pressure_pa == pytest.approx(other.vapour_pressure_pa)
    fourth, _ = read(air(dew_point_c=None, vapour_pressure_hpa=HEIGHTS * 0.0 + 1.0))
    assert fourth.vapour_pressure_pa == pytest.approx(100.0)


def test_without_humidity_it_is_unknown():
    s, said = read(air(dew_point_c=None))
    assert np.isnan(s.vapour_pressure_pa).all()
    assert said == {}


def test_missing_levels_are_left_out_and_counted():
    levels = air(pressure_hpa=np.where(HEIGHTS == 1000.0, np.nan, standard_hpa(HEIGHTS)))
    levels["temperature_c"] = np.where(HEIGHTS == 2000.0, -9999.0, levels["temperature_c"])
    levels["dew_point_c"] = np.where(HEIGHTS == 3000.0, 99999.0, levels["dew_point_c"])
    s, said = read(levels)
    assert said == {"SOUNDING-MISSING": 2}
    assert s.h_m.size == HEIGHTS.size - 2
    assert np.isnan(s.vapour_pressure_pa).sum() == 1


def test_unsorted_levels_are_sorted():
    reference, _ = read(air())
    for order in (np.arange(HEIGHTS.size)[::-1], [3, 0, 1, 2, *range(4, HEIGHTS.size)]):
        s, said = read(air(), order=order)
        assert set(said) == {"SOUNDING-UNSORTED"}
        assert np.array_equal(s.h_m, reference.h_m)
        assert np.array_equal(s.temperature_k, reference.temperature_k)


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        (air(pressure_hpa=None, pressure_pa=standard_hpa(HEIGHTS)), "hPa where Pa is stated"),
        (air(pressure_hpa=100.0 * standard_hpa(HEIGHTS)), "Pa where hPa is stated"),
        (air(temperature_c=288.15 - 0.0065 * HEIGHTS), "Kelvin where Celsius is stated"),
        (air(temperature_c=None, temperature_k=15.0 - 0.0065 * HEIGHTS), "Celsius where Kelvin"),
        (air(temperature_c=32.0 + 1.8 * (38.0 - 0.0065 * HEIGHTS)), "Fahrenheit"),
        (air(dew_point_c=278.15 - 0.0065 * HEIGHTS), "dew point"),
        (air(dew_point_c=None, relative_humidity=55.0 + 0.0 * HEIGHTS), "fraction of one"),
        (air(dew_point_c=None, relative_humidity_percent=0.55 + 0.0 * HEIGHTS), "fraction of one"),
        (air(dew_point_c=None, vapour_pressure_hpa=850.0 + 0.0 * HEIGHTS), "vapour pressure"),
        (air(dew_point_c=4.0 + 0.002 * HEIGHTS), "depressions"),
    ],
)
def test_wrong_units_are_refused(levels, words):
    error = refusal(levels)
    assert error.code == "SOUNDING-UNITS"
    assert words in error.what


@pytest.mark.parametrize(
    "levels",
    [
        air(geopotential_m=HEIGHTS / 0.3048),
        air(temperature_c=32.0 + 1.8 * (15.0 - 0.0065 * HEIGHTS)),  # 59 F looks like a hot day
        air(geopotential_m=HEIGHTS[::-1]),
    ],
)
def test_heights_that_contradict_the_air_are_refused(levels):
    assert refusal(levels).code == "SOUNDING-INCONSISTENT"


def test_duplicate_levels_are_averaged():
    h = np.insert(HEIGHTS, 4, HEIGHTS[3])
    t = 15.0 - 0.0065 * h
    t[4] += 1.0
    levels = {"geopotential_m": h, "pressure_hpa": standard_hpa(h), "temperature_c": t}
    s, said = read(levels)
    assert said["SOUNDING-DUPLICATE"] == 1
    assert s.temperature_k[3] == pytest.approx(288.15 - 0.0065 * 1500.0 + 0.5)
    # The same height at two pressures.
    p = standard_hpa(h)
    p[4] -= 0.5
    s, said = read(levels | {"pressure_hpa": p})
    assert said["SOUNDING-DUPLICATE"] == 1
    assert s.pressure_pa[3] == pytest.approx(100.0 * standard_hpa(1500.0) - 25.0)


def test_humidity_over_saturation_is_clipped():
    s, said = read(changed("dew_point_c", 2, 14.0))
    assert said == {"SOUNDING-HUMIDITY-OVER": 1}
    es = saturation_pressure_pa(s.temperature_k)
    assert s.vapour_pressure_pa[2] == pytest.approx(es[2], rel=0.01)
    wet = np.full(HEIGHTS.size, 60.0)
    wet[[1, 5]] = 104.0, 101.0
    s, said = read(air(dew_point_c=None, relative_humidity_percent=wet))
    assert said == {"SOUNDING-HUMIDITY-OVER": 2}
    assert (s.vapour_pressure_pa <= 1.01 * saturation_pressure_pa(s.temperature_k)).all()
    wet[1] = -3.0
    s, said = read(air(dew_point_c=None, relative_humidity_percent=wet))
    assert said == {"SOUNDING-HUMIDITY-OVER": 1, "SOUNDING-HUMIDITY-NEGATIVE": 1}
    assert np.isnan(s.vapour_pressure_pa[1])


@pytest.mark.parametrize("fill", [-99.0, -99.9, -99.99])
def test_fills_of_temperatures_are_no_air(fill):
    s, said = read(changed("temperature_c", 3, fill))
    assert said == {"SOUNDING-MISSING": 1}
    assert s.h_m.size == HEIGHTS.size - 1
    s, said = read(changed("dew_point_c", 3, fill))
    assert said == {}
    assert np.isnan(s.vapour_pressure_pa[3])


@pytest.mark.parametrize(("i", "height"), [(4, 800.0), (4, 5200.0)])
def test_pressure_that_does_not_fall_with_height(i, height):
    """One wrong height takes one level with it, not all that follow."""
    s, said = read(changed("geopotential_m", i, height))
    assert said == {"SOUNDING-ORDER": 1}
    assert s.h_m.size == HEIGHTS.size - 1


def test_impossible_values_are_a_loss():
    ledger = Ledger()
    parse_sounding(text_of(changed("temperature_c", 3, -273.0)), ledger, latitude_rad=0.8)
    assert [(entry.code, entry.kind) for entry in ledger] == [("SOUNDING-RANGE", Kind.LOSS)]


def with_temperature(h, celsius) -> dict[str, np.ndarray]:
    """Levels in balance with a temperature: pressures by trapezoids of 1/T over a metre."""
    fine = np.arange(0.0, h[-1] + 1.0)
    t = np.interp(fine, h, celsius) + 273.15
    fall = np.concatenate([[0.0], np.cumsum(0.0341632 / (0.5 * (t[1:] + t[:-1])))])
    return {
        "geopotential_m": h,
        "pressure_hpa": np.interp(h, fine, 1010.0 * np.exp(-fall)),
        "temperature_c": np.asarray(celsius),
    }


def test_layers_that_sondes_measure_are_no_matter():
    h = np.array([0.0, 20.0, 300.0, 600.0, 1000.0, 2000.0, 3000.0])
    # 13 K/km over 300 m by day; above a desert, 3 K in the first 20 m: n grows with height.
    _, said = read(with_temperature(h, [33.0, 32.8, 29.0, 25.1, 21.5, 14.0, 7.0]))
    assert said == {}
    s, said = read(with_temperature(h, [35.0, 32.0, 29.5, 27.0, 24.0, 17.0, 10.0]))
    assert said == {}
    assert s.temperature_k[:2] == pytest.approx([308.15, 305.15])


@pytest.mark.parametrize(
    ("celsius", "text"),
    [
        # 9.76 K/km are 2.9 K from the ground to 300 m: 44.3 - 29.6 - 2.9 = 11.8.
        ([44.3, 32.5, 29.6, 26.7, 22.8, 16.0, 9.0], None),
        ([44.8, 32.5, 29.6, 26.7, 22.8, 16.0, 9.0], r"from 0 to \d+ m .* by 12\.\d K more"),
        ([22.0, 21.8, 19.0, 16.1, 12.2, 2.0, -7.7], None),
        ([22.0, 21.8, 19.0, 16.1, 12.2, 0.2, -9.5], r"from 1000 to \d+ m .* by 2\.\d K more"),
    ],
)
def test_layers_that_no_sonde_measures_are_kept_and_told(celsius, text):
    h = np.array([0.0, 20.0, 300.0, 600.0, 1000.0, 2000.0, 3000.0])
    ledger = Ledger()
    s = parse_sounding(text_of(with_temperature(h, celsius)), ledger, latitude_rad=0.8)
    said = [entry.what for entry in ledger if entry.code == "SOUNDING-SUPERADIABATIC"]
    assert len(said) == (text is not None), said
    assert all(re.search(text, what) for what in said)
    assert s.temperature_k == pytest.approx(np.array(celsius) + 273.15)


@pytest.mark.parametrize(
    ("base", "share", "told"),
    [(0.0, 0.035, False), (0.0, 0.045, True), (600.0, 0.005, False), (600.0, 0.008, True)],
)
def test_an_index_that_rises_more_than_over_hot_ground_is_told(base, share, told):
    """n - 1 is proportional to p/T; over 20 m p falls by 0.0341632 K/m times 20 m over T."""
    h = np.array([0.0, 20.0, 600.0, 620.0, 1000.0, 2000.0, 3000.0])
    celsius = 20.0 - 0.0065 * h
    kelvin_above = celsius[h == base + 20.0][0] + 273.15
    celsius[h == base] = kelvin_above * (1.0 + share) * math.exp(0.683264 / kelvin_above) - 273.15
    _, said = read(with_temperature(h, celsius))
    assert ("SOUNDING-INDEX-RISES" in said) is told, said


def test_too_few_levels():
    error = refusal({name: column[:4] for name, column in air().items()})
    assert error.code == "SOUNDING-LEVELS"
    assert "4 levels" in error.what


def test_heights_worked_out_from_the_station():
    levels = air(geopotential_m=None)
    assert refusal(levels).code == "SOUNDING-HEIGHT"
    s, said = read(levels, station_h_m=0.0)
    assert said == {"SOUNDING-HEIGHTS": HEIGHTS.size - 1}
    # Moist: up to 9 m more than the dry air of the heights column; and 1 m of trapezoids.
    assert s.h_m == pytest.approx([metres(h, 45.0) for h in HEIGHTS], abs=9.0)
    dry, _ = read(air(geopotential_m=None, dew_point_c=None), station_h_m=0.0)
    assert dry.h_m == pytest.approx([metres(h, 45.0) for h in HEIGHTS], abs=1.0)


def test_without_latitude_it_is_said():
    _, said = read(air(), latitude_rad=math.nan)
    assert said == {"SOUNDING-LATITUDE": 0}


def test_columns():
    both = air(pressure_pa=100.0 * standard_hpa(HEIGHTS))
    assert refusal(both).code == "SOUNDING-COLUMN"
    without = {"pressure": standard_hpa(HEIGHTS), "temperature_c": HEIGHTS * 0.0}
    error = refusal(without)
    assert error.code == "SOUNDING-COLUMN"
    assert "pressure_pa or pressure_hpa" in error.remedy
    _, said = read(air(wind_m_s=HEIGHTS * 0.0))
    assert said == {"SOUNDING-COLUMNS-UNUSED": 1}


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "SOUNDING-FORMAT"),
        ("lorem ipsum", "SOUNDING-FORMAT"),
        ("h_m,pressure_hpa,pressure_hpa,temperature_c\n", "SOUNDING-COLUMN"),
        ("h_m,pressure_hpa,temperature_c\n", "SOUNDING-EMPTY"),
    ],
)
def test_no_sounding(text, code):
    with pytest.raises(InputError) as caught:
        parse_sounding(text, Ledger())
    assert caught.value.code == code


@pytest.mark.parametrize("name", ["igra", "igra_derived"])
def test_no_line_of_a_text_is_a_header_of_igra(name):
    for text in (text_of(air()), "", "one line\n"):
        with pytest.raises(InputError) as caught:
            parse_sounding(text, Ledger(), format_name=name, where="b.csv")
        assert caught.value.code in ("SOUNDING-FORMAT", "SOUNDING-EMPTY")
        assert "b.csv" in caught.value.where


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("temperature_c", 3, 1e308), {"SOUNDING-MISSING": 1}),
        (("temperature_c", 3, 500.0), {"SOUNDING-RANGE": 1}),
        (("pressure_hpa", 3, 95_000.0), {"SOUNDING-RANGE": 1, "SOUNDING-UNSORTED": None}),
        (("geopotential_m", 3, 1e300), {"SOUNDING-HEIGHTS": 1}),
        (("geopotential_m", 3, 1e6), {"SOUNDING-ORDER": 1}),
        (("dew_point_c", 3, 400.0), {"SOUNDING-HUMIDITY-RANGE": 1}),
    ],
)
def test_one_wild_number_is_no_matter_of_units(change, said):
    """Of twelve levels one is rubbish: it is counted, and the others stay as they are."""
    s, counted = read(changed(*change))
    assert {code: n for code, n in counted.items() if said.get(code, n) is not None} == {
        code: n for code, n in said.items() if n is not None
    }
    clean, _ = read(air())
    assert s.h_m.size >= HEIGHTS.size - 1
    kept = np.isin(np.round(clean.pressure_pa), np.round(s.pressure_pa))
    assert s.temperature_k == pytest.approx(clean.temperature_k[kept], abs=1e-9)


def dated(time: str) -> tuple[Sounding, dict[str, int]]:
    lines = text_of(air()).splitlines()
    rows = [f"{line},{time}" for line in lines[1:]]
    ledger = Ledger()
    text = "\n".join([f"{lines[0]},time_utc", *rows])
    return parse_sounding(text, ledger, latitude_rad=0.8), counts(ledger)


@pytest.mark.parametrize(
    ("text", "when", "said"),
    [
        ("2025-06-12T09:00:00Z", "2025-06-12T09:00", {}),
        ("2025-06-12T11:00:00+02:00", "2025-06-12T09:00", {}),
        ("2025-06-12 09:00", "2025-06-12T09:00", {}),
        ("", None, {}),
        ("NaN", None, {}),
    ],
)
def test_times_of_a_csv(text, when, said):
    s, counted = dated(text)
    assert s.time_ns == (None if when is None else ns(when))
    assert counted == said
    assert ("2025-06-12T09:00" in s.name) is (when is not None)


@pytest.mark.parametrize("text", ["12.06.2025 09:00", "3025-06-12T09:00:00Z", "0001-01-01", "noon"])
def test_a_time_that_is_stated_and_cannot_be_read_is_refused(text):
    with pytest.raises(InputError) as caught:
        dated(text)
    assert caught.value.code == "SOUNDING-TIME"
    assert text in caught.value.what


def at_place(north: str, east: str):
    """A plain CSV with a place in its columns, as it is read."""
    lines = text_of(air()).splitlines()
    rows = [f'{line},"{north}","{east}"' for line in lines[1:]]
    text = "\n".join([f"{lines[0]},latitude_deg,longitude_deg", *rows])
    return parse_sounding(text, Ledger(), latitude_rad=0.8)


@pytest.mark.parametrize(
    ("east", "degrees"),
    [("16.35", 16.35), ("-70.5", -70.5), ("289.5", -70.5), ("180", 180.0), ("359.99", -0.01)],
)
def test_longitudes_of_either_kind(east, degrees):
    assert math.degrees(at_place("48.2", east).longitude_rad) == pytest.approx(degrees)


@pytest.mark.parametrize(
    ("north", "east"), [("", ""), ("-9999", "-9999"), ("-99.99", "-99.99"), ("", "8.3")]
)
def test_a_place_that_is_not_stated_is_unknown(north, east):
    s = at_place(north, east)
    assert math.isnan(s.longitude_rad)


@pytest.mark.parametrize(
    ("north", "east"),
    [("48 14", "16 21"), ("48.2", "361"), ("98.2", "16.35"), ("48.2N", "16.35E")],
)
def test_a_place_that_is_stated_and_cannot_be_read_is_refused(north, east):
    with pytest.raises(InputError) as caught:
        at_place(north, east)
    assert caught.value.code == "SOUNDING-PLACE"


def test_a_place_with_decimal_commas_is_read():
    sounding = at_place("48,2333", "16,35")
    assert math.degrees(sounding.longitude_rad) == pytest.approx(16.35)


def test_format_by_name():
    with pytest.raises(InputError) as caught:
        parse_sounding(text_of(air()), Ledger(), format_name="grib")
    assert caught.value.code == "SOUNDING-FORMAT"
    assert all(name in caught.value.remedy for name in FORMATS)
    with pytest.raises(InputError) as caught:
        parse_sounding(text_of(air()), Ledger(), format_name="wyoming_csv")
    assert caught.value.code == "SOUNDING-COLUMN"


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
    ledger = Ledger()
    s = parse_sounding(WYOMING_PAGE, ledger)
    assert (s.station, s.time_ns) == ("OUN", ns("2011-05-22T12:00"))
    assert math.degrees(s.latitude_rad) == pytest.approx(35.18)
    assert counts(ledger) == {"SOUNDING-MISSING": 1}
    check_level(s, 35.18, 850.0, 1454.0, 22.0, 6.0)
    # Without a dew point the relative humidity stands for it: 100 % of 18.8 C.
    check_level(s, 35.18, 896.0, 995.0, 18.8, 18.8)
    assert s.h_m.size == 6


def igra(day: str, hour: str, release: str, levels: int = 6, announced: int | None = None) -> str:
    head = (
        f"#USM00070026 2010 06 {day} {hour} {release} {announced or levels:4d} ncdc6301 ncdc6301 "
        f" 712889 -1567833"
    )
    rows = [
        f"20 -9999 {100 * round(p):6d} {h:5.0f}B{t * 10:5.0f}B-9999    20 -9999 -9999 "
        for h, p, t in zip(
            HEIGHTS[:levels], standard_hpa(HEIGHTS), 15.0 - 0.0065 * HEIGHTS, strict=False
        )
    ]
    return "\n".join([head, *rows, ""])


def test_igra_choice_and_release():
    three = igra("01", "00", "2303") + igra("01", "12", "9999") + igra("02", "99", "1805")
    for when, released in (
        ("2010-06-01T02:00", "2010-05-31T23:03"),
        ("2010-06-01T10:00", "2010-06-01T12:00"),
        ("2010-06-02T17:00", "2010-06-02T18:05"),
    ):
        s = parse_sounding(three, Ledger(), time_ns=ns(when))
        assert s.time_ns == ns(released)
    with pytest.raises(InputError) as caught:
        parse_sounding(three, Ledger())
    assert caught.value.code == "SOUNDING-CHOICE"
    undated = igra("01", "99", "9999") + igra("02", "99", "9999")
    with pytest.raises(InputError) as caught:
        parse_sounding(undated, Ledger(), time_ns=ns("2010-06-01"))
    assert caught.value.code == "SOUNDING-CHOICE"


def test_igra_far_away_cut_off_and_damaged():
    ledger = Ledger()
    text = igra("01", "12", "9999", announced=40)
    parse_sounding(text, ledger, time_ns=ns("2010-06-03T12:00"))
    assert counts(ledger) == {"SOUNDING-TRUNCATED": 34, "SOUNDING-FAR-IN-TIME": 0}
    assert ledger.has_losses
    with pytest.raises(InputError) as caught:
        parse_sounding(text + "#garbage\n", Ledger(), time_ns=0)
    assert caught.value.code == "SOUNDING-FORMAT"
    assert "line 8" in caught.value.where
    with pytest.raises(InputError) as caught:
        parse_sounding(text.splitlines()[0], Ledger(), time_ns=0)
    assert caught.value.code == "SOUNDING-EMPTY"


def test_fill_values_of_netcdf(tmp_path):
    levels = {"pres": standard_hpa(HEIGHTS), "tdry": 15.0 - 0.0065 * HEIGHTS, "alt": HEIGHTS}
    levels |= {"dp": levels["tdry"] - 10.0, "rh": 0.0 * HEIGHTS + 50.0}
    levels["tdry"] = np.where(HEIGHTS == 1000.0, -9999.0, levels["tdry"])
    levels["dp"] = np.where(HEIGHTS == 2000.0, -9999.0, levels["dp"])
    path = tmp_path / "sonde.cdf"
    ledger = Ledger()
    with netcdf_file(path, "w") as file:
        file.createDimension("time", HEIGHTS.size)
        for name, column in levels.items():
            file.createVariable(name, "f4", ("time",))[:] = column
    s = read_sounding(path, ledger, latitude_rad=0.8)
    assert counts(ledger) == {"SOUNDING-MISSING": 1}
    assert s.time_ns is None
    assert s.name == "sounding sonde.cdf"
    # The relative humidity stands in where the dew point is missing: 50 % of 2.0 C.
    assert s.vapour_pressure_pa[3] == pytest.approx(
        0.5 * float(saturation_pressure_pa(np.array(275.15))), rel=0.01
    )
    with netcdf_file(path, "w") as file:
        file.createDimension("time", 3)
        file.createVariable("pres", "f4", ("time",))[:] = 1.0
    with pytest.raises(InputError, match="no variable tdry"):
        read_sounding(path, Ledger())


def test_a_netcdf_of_another_year_is_told_of(tmp_path):
    path = tmp_path / "sonde.cdf"
    columns = {"pres": standard_hpa(HEIGHTS), "tdry": 15.0 - 0.0065 * HEIGHTS, "alt": HEIGHTS}
    columns |= {"dp": columns["tdry"] - 10.0, "rh": 0.0 * HEIGHTS + 50.0}
    with netcdf_file(path, "w") as file:
        file.createDimension("time", HEIGHTS.size)
        for name, column in columns.items():
            file.createVariable(name, "f4", ("time",))[:] = column
        file.createVariable("base_time", "i4", ())[...] = 1_546_320_720  # 2019-01-01T05:32
        file.createVariable("time_offset", "f8", ("time",))[:] = -9999.0
    for flight, far in (("2019-01-01T08:00", False), ("2025-06-12T09:00", True)):
        ledger = Ledger()
        s = read_sounding(path, ledger, time_ns=ns(flight), latitude_rad=0.8)
        assert s.time_ns == ns("2019-01-01T05:32")
        assert ("SOUNDING-FAR-IN-TIME" in counts(ledger)) is far


def test_files(tmp_path, monkeypatch):
    path = tmp_path / "s.csv"
    path.write_bytes(b"\xef\xbb\xbf" + text_of(air()).encode())
    assert read_sounding(path, Ledger(), latitude_rad=0.8).h_m.size == HEIGHTS.size
    cases = {
        "absent.csv": (None, "SOUNDING-UNREADABLE"),
        "latin.csv": (b"h_m,pressure_hpa\n\xb0", "SOUNDING-UNREADABLE"),
        "netcdf4.nc": (b"\x89HDF\r\n\x1a\n", "SOUNDING-NETCDF"),
        "short.cdf": (b"CDF\x01\x00\x00", "SOUNDING-NETCDF"),
        "empty.cdf": (b"CDF\x01" + bytes(28), "SOUNDING-NETCDF"),
    }
    for name, (data, code) in cases.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError) as caught:
            read_sounding(tmp_path / name, Ledger())
        assert caught.value.code == code, name
    monkeypatch.setattr(from_disk, "LARGEST_BYTES", 100)
    with pytest.raises(InputError) as caught:
        read_sounding(path, Ledger())
    assert caught.value.code == "SOUNDING-SIZE"


@pytest.mark.parametrize(("stamp", "year"), [("730101", 1973), ("991231", 1999), ("110522", 2011)])
def test_the_century_of_a_wyoming_list(stamp, year):
    """Two digits of the year: the archive begins in 1973."""
    page = WYOMING_PAGE.replace("110522/1200", f"{stamp}/1200").replace("12Z 22 May 2011", "12Z")
    when = np.datetime64(parse_sounding(page, Ledger()).time_ns, "ns")
    assert str(when.astype("datetime64[h]")) == f"{year}-{stamp[2:4]}-{stamp[4:]}T12"


def rows_of(start: int, *, warmer: float = 0.0, identity: str = "") -> list[str]:
    """Ten levels of an ascent; pressure, temperature and what says which ascent it is."""
    return [
        f"{950.0 - 45.0 * k:.1f},{15.0 - 2.5 * k + warmer:.1f}{identity}"
        for k in range(start, start + 10)
    ]


@pytest.mark.parametrize("hours", [2, 5])
@pytest.mark.parametrize("interleaved", [False, True])
def test_of_two_ascents_in_one_table_the_nearest_in_time(hours, interleaved):
    early = rows_of(0, identity=",2025-06-12T06:00:00Z")
    late = rows_of(0, warmer=5.0, identity=f",2025-06-12T{6 + hours:02d}:00:00Z")
    rows = [*early, *late]
    if interleaved:
        rows = [row for pair in zip(early, late, strict=True) for row in pair]
    text = "\n".join(["pressure_hpa,temperature_c,time_utc", *rows])
    for flight, celsius in (("05:00", 15.0), ("13:00", 20.0)):
        ledger = Ledger()
        s = parse_sounding(
            text, ledger, station_h_m=540.0, latitude_rad=0.8, time_ns=ns(f"2025-06-12T{flight}")
        )
        assert s.temperature_k[0] == pytest.approx(celsius + 273.15)
        assert s.h_m.size == 10
        assert counts(ledger)["SOUNDING-CHOSEN"] == 2
    with pytest.raises(InputError, match=r"SOUNDING-CHOICE.*2 soundings, and no time"):
        parse_sounding(text, Ledger(), station_h_m=540.0)


@pytest.mark.parametrize(
    ("head", "one", "other"),
    [
        (",station", ",11035", ",11520"),
        (",ascent,time_utc", ",a,2025-06-12T06:00Z", ",b,2025-06-12T06:00Z"),
        (",lat,lon", ",48.2,16.4", ",50.0,14.4"),
        ("", "", ""),
    ],
)
def test_two_ascents_of_one_time_in_one_table_are_refused(head, one, other):
    rows = [*rows_of(0, identity=one), *rows_of(0, warmer=5.0, identity=other)]
    text = "\n".join([f"pressure_hpa,temperature_c{head}", *rows])
    with pytest.raises(InputError, match="SOUNDING-CHOICE"):
        parse_sounding(text, Ledger(), station_h_m=540.0, time_ns=ns("2025-06-12T05:00"))


def test_rows_too_long_apart_are_refused():
    """Each level has its own time: no column parts the ascents, but none takes 13 hours."""
    rows = [f"{row},2025-06-12T{k + 5:02d}:00:00Z" for k, row in enumerate(rows_of(0))]
    text = "\n".join(["pressure_hpa,temperature_c,time_utc", *rows])
    with pytest.raises(InputError, match=r"SOUNDING-CHOICE.*up to 9\.0 hours apart"):
        parse_sounding(text, Ledger(), station_h_m=540.0)


def test_up_and_down_again_is_one_flight():
    """As a drone flies: its levels are put in order. Each may have its own time and place."""
    up = rows_of(0)
    rows = [f"{row},48.{k:02d},16.4" for k, row in enumerate([*up, *up[::-1]])]
    text = "\n".join(["pressure_hpa,temperature_c,lat,lon", *rows])
    ledger = Ledger()
    s = parse_sounding(text, ledger, station_h_m=540.0)
    assert s.h_m.size == 10
    assert set(counts(ledger)) >= {"SOUNDING-UNSORTED", "SOUNDING-DUPLICATE"}
    assert math.degrees(s.latitude_rad) == pytest.approx(48.0)


@pytest.mark.parametrize(
    ("column", "field", "told"),
    [
        ("time", "2025-06-12T06:00:00Z", True),
        ("datetime", "2025-06-12 06:00", True),
        ("date", "20250612", True),
        ("valid", "06/12/2025 06:00", True),
        ("time_s", "120", False),
        ("time", "120.5", False),
        ("wind", "12", False),
    ],
)
def test_a_time_in_a_column_of_another_name_is_not_unknown(column, field, told):
    rows = rows_of(0, identity=f",{field}")
    text = "\n".join([f"pressure_hpa,temperature_c,{column}", *rows])
    if told:
        with pytest.raises(InputError, match="SOUNDING-TIME") as caught:
            parse_sounding(text, Ledger(), station_h_m=540.0)
        assert "time_utc" in caught.value.remedy
    else:
        ledger = Ledger()
        parse_sounding(text, ledger, station_h_m=540.0)
        assert "SOUNDING-COLUMNS-UNUSED" in counts(ledger)


@pytest.mark.parametrize("field", ["2025-06-12", "20250612"])
def test_a_date_without_its_hour_is_no_time(field):
    with pytest.raises(InputError, match="SOUNDING-TIME"):
        dated(field)


def wyoming_of(heading: str, station: str = "", levels: int = 8) -> str:
    """A list of the University of Wyoming under a heading, with lines on its station after it."""
    rows = []
    for k in range(levels):
        h = 500 * k + 200
        p = 1013.25 * (1 - 2.25577e-5 * h) ** 5.25588
        rows.append(f"{p:7.1f}{h:7d}{15 - 0.0065 * h:7.1f}{5 - 0.0065 * h:7.1f}{50:7d}")
    rule = "-" * 77
    titles = "   PRES   HGHT   TEMP   DWPT   RELH\n    hPa     m      C      C      %"
    table = "\n".join([rule, titles, rule, *rows])
    return f"<H1>{heading}</H1>\n<PRE>\n{table}\n</PRE>\n{station}\n"


NEW_HEADING = "Observations for Station 11035 at 12 UTC 12 Mar 2015"
NEW_PLACE = "<I>Latitude: 48.2333 Longitude: 16.35</I>"


def test_the_present_page_has_time_and_place_in_its_head():
    s = parse_sounding(wyoming_of(f"{NEW_HEADING}</H1>\n{NEW_PLACE}\n<H1>"), Ledger())
    assert s.time_ns == ns("2015-03-12T12:00")
    assert s.station == "11035"
    assert np.degrees([s.latitude_rad, s.longitude_rad]) == pytest.approx([48.2333, 16.35])


@pytest.mark.parametrize(
    "heading",
    ["Observations for Station 11035 at noon", "11035 Wien Observations at 12Z 12 Mrz 2015"],
)
def test_a_heading_whose_time_cannot_be_read_is_refused(heading):
    with pytest.raises(InputError) as caught:
        parse_sounding(wyoming_of(heading), Ledger(), latitude_rad=0.8)
    assert caught.value.code == "SOUNDING-TIME"


@pytest.mark.parametrize("stamp", ["150312/12", "151312/1200", "noon"])
def test_an_observation_time_that_cannot_be_read_is_refused(stamp):
    station = f"Observation time: {stamp}"
    with pytest.raises(InputError) as caught:
        parse_sounding(wyoming_of("", station), Ledger(), latitude_rad=0.8)
    assert caught.value.code == "SOUNDING-TIME"


@pytest.mark.parametrize(
    ("flight", "hour"), [("2015-03-13T01", "13T00"), ("2015-03-12T10", "12T12")]
)
def test_of_two_ascents_of_a_page_the_nearest_in_time(flight, hour):
    page = wyoming_of("11035 Wien Observations at 12Z 12 Mar 2015", "Observation time: 150312/1200")
    page += wyoming_of("11035 Wien Observations at 00Z 13 Mar 2015", levels=9)
    s = parse_sounding(page, Ledger(), time_ns=ns(flight), latitude_rad=0.8)
    assert s.time_ns == ns(f"2015-03-{hour}:00")
    assert s.h_m.size == (9 if hour == "13T00" else 8)


@pytest.mark.parametrize(
    ("heading", "time"),
    [
        ("Observations for Station 11035 at 12:00 UTC 12 Mar 2015", "2015-03-12T12:00"),
        ("Observations for Station 11035 at 1130 UTC 12 March 2015", "2015-03-12T11:30"),
        ("OBSERVATIONS FOR STATION 11035 AT 06Z 12 MAR 2015", "2015-03-12T06:00"),
        ("Sounding of 11035, 12 UTC 12 Mar 2015", "2015-03-12T12:00"),
    ],
)
def test_forms_of_headings(heading, time):
    s = parse_sounding(wyoming_of(heading), Ledger(), latitude_rad=0.8)
    assert s.time_ns == ns(time)


@pytest.mark.parametrize("heading", ["11035 2015031212", "Wien, 12 UTC March 12, 2015"])
def test_a_date_above_the_titles_that_cannot_be_read_is_refused(heading):
    with pytest.raises(InputError, match="SOUNDING-TIME"):
        parse_sounding(wyoming_of(heading), Ledger(), latitude_rad=0.8)


@pytest.mark.parametrize(
    ("stamp", "told"), [("150312/1137", False), ("140312/1200", True), ("150312/0000", True)]
)
def test_a_heading_and_a_time_of_observation_agree(stamp, told):
    page = wyoming_of("11035 Wien Observations at 12Z 12 Mar 2015", f"Observation time: {stamp}")
    if told:
        with pytest.raises(InputError, match=r"SOUNDING-TIME.*differ by"):
            parse_sounding(page, Ledger(), latitude_rad=0.8)
    else:
        assert parse_sounding(page, Ledger(), latitude_rad=0.8).time_ns == ns("2015-03-12T11:37")


def test_of_two_stations_of_one_hour_none_is_guessed():
    one = wyoming_of("11035 Wien Observations at 12Z 12 Mar 2015")
    other = wyoming_of("11520 Praha Observations at 12Z 12 Mar 2015", levels=9)
    flight = ns("2015-03-12T11:00")
    with pytest.raises(InputError, match=r"SOUNDING-CHOICE.*2 soundings of the file have the time"):
        parse_sounding(one + other, Ledger(), time_ns=flight, latitude_rad=0.8)
    twice = parse_sounding(one + one, Ledger(), time_ns=flight, latitude_rad=0.8)
    assert twice.h_m.size == 8


@pytest.mark.parametrize(
    "place", ["Latitude = 48.2333, Longitude = 16.35", "Lat: 48.2333 Lon: 16.35"]
)
def test_forms_of_a_place(place):
    s = parse_sounding(wyoming_of(f"{NEW_HEADING}</H1>\n{place}\n<H1>"), Ledger())
    assert np.degrees([s.latitude_rad, s.longitude_rad]) == pytest.approx([48.2333, 16.35])


def test_a_date_of_the_archive_that_is_none_is_refused():
    text = igra("01", "12", "1137").replace(" 06 01 ", " 13 01 ")
    with pytest.raises(InputError) as caught:
        parse_sounding(text, Ledger())
    assert caught.value.code == "SOUNDING-TIME"
