"""Tables, tags, weather and missions with fields at their limits: read, or refused by name.

Never another exception or a warning, never a result that no measurement can be.
"""

import random
import struct

import numpy as np
import pandas as pd
import pytest

from tests.faults.extreme_blocks import BLOCKS, TAGS, first_row, read_block, small_blocks
from tests.faults.extreme_inputs import LONG, impossible_values
from tests.faults.extreme_missions import MISSIONS
from tests.faults.extreme_tables import GPST, MRK_TEXT, NOON_NS, TABLES, TOW
from tests.faults.extreme_tables import UNIX_S as START_S
from tests.faults.extreme_weather import (
    GRIDS,
    PLAIN_SOUNDING,
    REPORT,
    WEATHER,
    head_of,
)
from tests.faults.mutate import limited, work_unit_s
from tests.helpers import NS_PER_S, refused
from tests.tables.arm_sounding import VARIABLES, write_arm
from unbend.atmosphere.hypsometry import fall_of_pressure
from unbend.atmosphere.surface_report import parse_metar
from unbend.config.campaign import open_configs
from unbend.errors import ConfigError, InputError, UnbendError, rendered
from unbend.messages import Ledger
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.imports.camera_events import read_mrk
from unbend.tables.imports.eo_head import head_of_eo
from unbend.tables.soundings import read_sounding
from unbend.tables.text_columns import numbers
from unbend.tables.weather_fields import possible_steps, possible_times
from unbend.units import exact_integers, measured

READERS = {**TABLES, **BLOCKS, **TAGS, **WEATHER, **GRIDS, **MISSIONS}
LONGEST_UNITS = 100.0  # of work, for an input of some kilobytes, or of one field of 140
LONGEST_REFUSAL = 8000  # characters: a field of 140,000 is not repeated


@pytest.mark.parametrize("kind", READERS)
def test_fields_at_their_limits(tmp_path, mutation_count, mutation_seed, kind):
    limit_s = LONGEST_UNITS * work_unit_s()
    reader = READERS[kind]
    count = max(mutation_count // 250, 1)
    first_seed = mutation_seed if mutation_count > 2000 else 0  # `make test` has the same each day
    for seed in range(first_seed, first_seed + count):
        print(f"READERS[{kind!r}], random.Random('{kind} {seed}')")
        folder = tmp_path / str(seed)
        folder.mkdir()
        reader.write(folder, random.Random(f"{kind} {seed}"))
        with limited(limit_s):
            try:
                result = reader.read(folder)
            except UnbendError as error:
                refusal = error
            else:
                assert not [*impossible_values(result)]
                continue
        assert refusal.where
        assert refusal.remedy
        assert len(str(refusal)) < LONGEST_REFUSAL


# What is read of single fields


ONLY_THIRD = [False, False, True, False, False]


def sound_rows(more="", start_s=START_S):
    return [f"{start_s + k}.5,47.3,{8.5 + 1e-4 * k:.4f},1500.5{more}" for k in range(5)]


@pytest.mark.parametrize(
    ("place", "word"),
    [
        (0, "1e308"),
        (0, "9" * 400),
        (1, "inf"),
        (2, "1e308"),
        (2, "400.0"),
        (2, str(2**64)),
        (3, "1e308"),
        (3, "2147483647"),
        (3, "nan"),
        (0, "-1"),
        (0, "9999-12-31T23:59:59Z"),
    ],
)
def test_a_row_without_a_place_or_a_time_is_lost(trajectory_of, place, word):
    rows = sound_rows()
    fields = rows[2].split(",")
    fields[place] = word
    rows[2] = ",".join(fields)

    channel, losses = trajectory_of(rows)

    seconds = channel.time_ns / NS_PER_S - START_S
    assert seconds.tolist() == [0.5, 1.5, 3.5, 4.5]
    loss = losses["IMPORT-ROWS"]
    assert loss.count == 1
    assert "row 3" in loss.what


@pytest.mark.parametrize(
    ("column", "word"),
    [
        ("sigma_h_m", "-0.5"),
        ("sigma_h_m", "1e308"),
        ("sigma_h_m", "x"),
        ("v_north_m_s", "1e9"),
        ("v_north_m_s", "inf"),
        ("v_north_m_s", "1_0"),
    ],
)
def test_a_value_that_no_flight_has_is_unknown_and_counted(trajectory_of, column, word):
    rows = sound_rows(",0.25")
    rows[2] = rows[2].replace(",0.25", f",{word}")

    channel, losses = trajectory_of(rows, **{column: "c"})

    assert np.isnan(channel[column]).tolist() == ONLY_THIRD
    assert losses["IMPORT-VALUES"].count == 1


@pytest.mark.parametrize("first", ["0", "2", "0.9", "1e308"])
def test_a_quaternion_of_another_length_is_no_attitude(trajectory_of, first):
    rows = sound_rows(",1,0,0,0")
    rows[2] = rows[2].replace(",1,0,0,0", f",{first},0,0,0")

    channel, losses = trajectory_of(
        rows,
        q_w="w",
        q_x="x",
        q_y="y",
        q_z="z",
    )

    is_unknown = np.isnan(channel["q_x"]) | np.isnan(channel["q_w"])
    assert is_unknown.tolist() == ONLY_THIRD
    assert losses["IMPORT-VALUES"].count == 1


def test_the_seconds_of_the_week_go_on_over_a_damaged_one(trajectory_of):
    rows = sound_rows(start_s=TOW)
    rows[1] = rows[1].replace(f"{TOW + 1}.5", "1e400")

    channel, losses = trajectory_of(rows, GPST)

    assert np.diff(channel.time_ns).tolist() == [2 * NS_PER_S, NS_PER_S, NS_PER_S]
    assert losses["IMPORT-ROWS"].count == 1


@pytest.mark.parametrize(
    ("before", "word"),
    [("1500.000,Ellh", "1e308,Ellh"), ("8.50000000,Lon", "1e18,Lon")],
)
def test_an_event_that_is_nowhere_on_earth_is_lost(write, before, word):
    path = write("flight.MRK", MRK_TEXT.replace(before, word, 1).splitlines())
    ledger = Ledger()
    channel = read_mrk(path, GPST, ledger)
    assert channel["event_index"].tolist() == [float(k) for k in range(2, 9)]
    assert [(entry.code, entry.count) for entry in ledger] == [("IMPORT-ROWS", 1)]


LOG_PRESSURES = np.linspace(11.5, 11.0, 6)


def test_heights_that_are_the_same_imply_no_temperature():
    """A degenerate sounding: numpy warned of its rank."""
    fall = fall_of_pressure(np.full(6, 500.0), LOG_PRESSURES)
    assert np.isfinite(fall.unexplained)
    assert fall.implied_k is None


@pytest.mark.parametrize("height", [[0.0, 1000.0] * 3, [1e-300 * k for k in range(6)]])
def test_heights_without_a_fall_of_pressure_are_no_error(height):
    fall = fall_of_pressure(np.array(height), LOG_PRESSURES)
    assert np.isfinite(fall.unexplained)


@pytest.mark.parametrize("filling", [" ", "\n", "<", "9", "m "])
def test_a_long_field_in_the_head_of_an_orientation_takes_no_time(filling):
    """140,000 blanks took four minutes."""
    long = LONG * filling
    text = f"Shift values: X = 0.0{long} Y = 1.0 m, Z = 2.0 m\nUTM North{long}1"
    with limited(LONGEST_UNITS * work_unit_s()):
        head_of_eo(text)


def test_a_pressure_that_no_height_has_is_none(write):
    """5e-324 hPa overflowed with the vapour pressure above it."""
    *lines, last = PLAIN_SOUNDING.splitlines()
    height, _, *more = last.split(",")
    lines.append(",".join([height, "5e-324", *more]))
    path = write("s.csv", lines)
    ledger = Ledger()
    sounding = read_sounding(path, ledger, time_ns=NOON_NS)
    assert len(sounding.h_m) == len(lines) - 2
    assert "SOUNDING-RANGE" in {entry.code for entry in ledger}


@pytest.mark.parametrize("start", [np.inf, -np.inf, np.nan])
def test_a_netcdf_sounding_without_a_finite_time_is_refused(tmp_path, start):
    path = write_arm(tmp_path / "sonde.cdf", VARIABLES | {"base_time": np.array(start)})
    with refused("SOUNDING-NETCDF"):
        read_sounding(path, Ledger(), time_ns=NOON_NS)


# Blocks, weather, grids


@pytest.fixture
def small_model(write):
    """The lines of its files, which are written into the folder of the test."""
    _, files = small_blocks()["colmap"]
    lines = {name: content.splitlines() for name, content in files.items()}
    for name in lines:
        write(name, lines[name])
    return lines


@pytest.mark.parametrize(
    ("name", "field", "word", "text"),
    [
        ("images.txt", 5, "1e308", "has a coordinate of"),
        ("points3D.txt", 1, "1e308", "'1' has a"),
        ("points3D.txt", 1, "inf", "'1' has a coordinate of inf"),
        ("cameras.txt", 2, "1e400", "not as that program writes it"),
        ("cameras.txt", 2, str(2**64), "is not a possible camera"),
        ("cameras.txt", 4, "1e308", "is not a possible camera"),
        ("cameras.txt", 4, "-3000", "is not a possible camera"),
    ],
)
def test_a_number_of_a_block_that_cannot_be_is_refused(
    tmp_path, write, small_model, name, field, word, text
):
    lines = small_model[name]
    row = first_row(lines)
    fields = lines[row].split(" ")
    fields[field] = word
    lines[row] = " ".join(fields)
    write(name, lines)
    with pytest.raises(InputError) as caught:
        read_block(tmp_path, "colmap")
    assert text in caught.value.what
    assert str(tmp_path) in caught.value.where


@pytest.mark.parametrize("point", ["1e308", "inf", "nan", "0.5", str(2**63)])
def test_an_image_point_of_no_whole_number_names_its_line(tmp_path, write, small_model, point):
    lines = small_model["images.txt"]
    row = first_row(lines) + 1
    x, y, *_ = lines[row].split(" ")
    lines[row] = f"{x} {y} {point}"
    write("images.txt", lines)
    with pytest.raises(InputError, match="IMPORT-FORMAT") as caught:
        read_block(tmp_path, "colmap")
    assert f"{row + 1}" in str(caught.value)


@pytest.mark.parametrize("unit", ["s", "ms", "ns", "D"])
@pytest.mark.parametrize("text", ["9999-01-01", "2300-01-01", "1700-01-01", "NaT"])
def test_times_of_a_model_beyond_the_calendar_are_refused(unit, text):
    """Nanoseconds do not hold them: numpy makes any other time of them."""
    if unit == "ns" and text == "9999-01-01":
        pytest.skip("nanoseconds cannot state it")
    stamps = np.array(["2026-05-06", text], f"datetime64[{unit}]")
    with pytest.raises(InputError, match="MODEL-TIME"):
        possible_times(stamps, "model.nc")
    sound = possible_times(stamps[:1], "model.nc")
    assert sound.astype(np.int64).tolist() == [1_778_025_600 * 10**9]


def test_a_lead_time_of_no_forecast_is_refused():
    steps = np.array([6, 2**40], "timedelta64[s]")
    with pytest.raises(InputError, match="MODEL-TIME"):
        possible_steps(steps, "model.nc")
    assert possible_steps(steps[:1], "model.nc") == np.timedelta64(6, "s")


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, np.nan),
        (0, 1e18),
        (1, np.inf),
        (2, 5e-324),
        (3, np.inf),
        (2, np.nan),
    ],
)
def test_a_geoid_whose_head_is_no_grid_is_refused(tmp_path, place, value):
    head = [46.0, 7.0, 0.25, 0.25]
    head[place] = value
    path = tmp_path / "g.gtx"
    values = np.full((2, 2), 47.5, ">f4")
    path.write_bytes(struct.pack(">4d2i", *head, 2, 2) + values.tobytes())
    with pytest.raises(InputError, match="the header is not that of a GTX"):
        read_geoid(path)


def test_an_hour_that_no_day_has_is_no_time_of_a_sounding(write):
    text = head_of("igra2_USM*")
    assert text.startswith("#USM00070026 2010 06 01 00 2303")
    spoilt = text.replace("2010 06 01 00 2303", "2010 06 01 50 9999", 1)
    path = write("s.txt", spoilt.splitlines())
    with pytest.raises(InputError, match="SOUNDING-TIME"):
        read_sounding(path, Ledger())


@pytest.mark.parametrize("word", ["_", "<" * 150_000, "x" * 150_000])
def test_a_field_of_a_sounding_that_is_no_number_is_missing_or_refused(tmp_path, word):
    path = tmp_path / "s.txt"
    path.write_text(PLAIN_SOUNDING.replace("15.00,", f"1{word}5.00,", 1))
    try:
        sounding = read_sounding(path, Ledger())
    except InputError as error:
        refusal = error
    else:
        assert sounding.h_m[0] > 400.0
        return
    assert refusal.code in ("SOUNDING-FORMAT", "SOUNDING-EMPTY")


def test_a_report_of_a_hundred_thousand_characters_is_none():
    with pytest.raises(InputError, match="it has 100"):
        parse_metar(f"{REPORT} {'A' * 100_000}", 183.0, Ledger(), flight_ns=NOON_NS)


# Mission files


def test_a_campaign_with_a_loop_is_refused(write):
    lines = ["campaign: c", "missions:", "- &m {mission: {name: a}, log: *m}"]
    path = write("campaign.yaml", lines)
    missions, campaigns = open_configs([path])
    assert not campaigns
    with pytest.raises(ConfigError, match="inside the section or list"):
        missions[0].load()


# The shared guards


def test_numbers_beyond_all_measures_are_none():
    fields = pd.Series(["1.5", "-0", "-1e12", "1e13", "inf", "9" * 400, "1_0", "x", ""])
    read = numbers(fields)
    assert read[:3].tolist() == [1.5, 0.0, -1e12]
    assert np.isnan(read[3:]).all()
    assert measured(np.array([3.0, np.nan]), largest=2.0)[0] != 3.0


@pytest.mark.parametrize("value", [0.5, np.nan, np.inf, 1e300, 2.0**60])
def test_what_is_no_whole_number_is_none(value):
    with pytest.raises(ValueError, match="is not a whole number"):
        exact_integers(np.array([1.0, value]))


def test_a_sentence_does_not_repeat_a_damaged_field():
    path = "/" + "f" * 400
    assert rendered("{path}: {field!r}", {"path": path, "field": "x" * 5000}).startswith(path)
    assert len(rendered("{field!r}", {"field": "x" * 5000})) < 100
