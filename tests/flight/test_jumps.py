"""Samples that no vehicle and no air can reach are taken out and counted; what can be, stays."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies
from hypothesis.extra.numpy import arrays

from tests.flight.made_channels import EARTH_M, counted, located, turned_channel, with_columns
from tests.helpers import NS_PER_S, channel, refused
from unbend.atmosphere.rejection import Reason
from unbend.errors import MissionError
from unbend.flight.evidence.impossible_samples import (
    RANGES,
    mask_impossible_values,
    plausible_samples,
)

ROW = np.arange(60)
TENTHS = ROW / 10.0
STILL = {
    "lat_rad": 0.8,
    "lon_rad": 0.1,
    "h_msl_m": 900.0,
    "pressure_pa": 9e4,
    "temperature_k": 280.0,
}


def logged(**columns):
    """A channel of 10 Hz."""
    return channel("X", TENTHS, **columns)


def rotating(axes, *angles_deg):
    return turned_channel("X", TENTHS, axes, np.transpose(angles_deg))


# 60 m/s to the north-east across the date line; a roll at 400 deg/s, as a multirotor does.
FLOWN_RAD = TENTHS * 60.0 / EARTH_M
NOISE_PA = np.random.default_rng(2).normal(0.0, 8.0, 60)
SOUND = {
    "position": logged(
        lat_rad=0.8 + FLOWN_RAD,
        lon_rad=np.remainder(2.0 * np.pi - 1e-5 + FLOWN_RAD, 2.0 * np.pi) - np.pi,
    ),
    "attitude": rotating("x", 400.0 * TENTHS),
    "temperature": logged(temperature_k=280.0 - 0.01 * ROW),
    "pressure": logged(pressure_pa=90_000.0 - 12.0 * ROW + NOISE_PA),
}
HALF_TURNS_DEG = np.full(60, 180.0)
ELSEWHERE = {
    "position": {"lon_rad": SOUND["position"]["lon_rad"] + 150.0 / EARTH_M},
    "attitude": rotating("XZ", 400.0 * TENTHS, HALF_TURNS_DEG).columns,
    "temperature": {"temperature_k": SOUND["temperature"]["temperature_k"] - 5.5},
    "pressure": {"pressure_pa": SOUND["pressure"]["pressure_pa"] + 300.0},
}


def with_jumps(role, rows):
    """Sound samples, of which some rows are elsewhere: attitudes by half a turn about down."""
    sound = SOUND[role]
    is_moved = np.isin(ROW, rows)
    columns = {}
    for name, values in ELSEWHERE[role].items():
        columns[name] = np.where(is_moved, values, sound[name])
    return with_columns(sound, **columns)


@pytest.mark.parametrize("role", SOUND)
@pytest.mark.parametrize(
    "rows",
    [
        [],
        [0],
        [30],
        [59],
        [20, 21],
        [0, 1, 2, 3],
        [56, 57, 58, 59],
        [10, 11, 40, 58, 59],
    ],
)
def test_wrong_samples_at_any_place_are_taken_out_and_counted(role, rows):
    kept, notes = plausible_samples(with_jumps(role, rows), role)
    others_ns = np.delete(ROW * NS_PER_S // 10, rows)
    assert kept.time_ns.tolist() == others_ns.tolist()
    assert [note.count for note in notes] == [len(rows)] * bool(rows)
    if rows == [30]:
        assert counted(notes) == [("loss", "SENSOR-JUMP", 1)]
        assert "3.000 s" in notes[0].what


@pytest.mark.parametrize(
    ("role", "column", "interval_s", "limit"),
    [
        ("position", "lat_rad", 0.1, 100.0 / EARTH_M),
        ("position", "lat_rad", 1.0, 700.0 / EARTH_M),
        ("height", "h_msl_m", 0.01, 20.0),
        ("height", "h_msl_m", 1.0, 200.0),
        ("pressure", "pressure_pa", 0.01, 100.0),
        ("pressure", "pressure_pa", 1.0, 2500.0),
        ("temperature", "temperature_k", 0.1, 5.0),
        ("temperature", "temperature_k", 1.0, 20.0),
    ],
)
@pytest.mark.parametrize(("share", "kept_rows"), [(0.999, 60), (1.001, 59)])
def test_how_far_a_sample_may_be_from_those_around_it(
    role,
    column,
    interval_s,
    limit,
    share,
    kept_rows,
):
    """By what is noise, and by what air and aircraft can change in the interval."""
    values = STILL[column] + limit * share * (ROW == 30)
    moved = channel("X", ROW * interval_s, **STILL | {column: values})
    kept, _ = plausible_samples(moved, role)
    assert np.isfinite(kept[column]).sum() == kept_rows


def test_a_step_that_stays_is_no_jump():
    """A sensor that is set anew, or a gap: both sides of it may be true."""
    steps = logged(temperature_k=280.0 + 20.0 * (ROW >= 30))
    kept, notes = plausible_samples(steps, "temperature")
    assert len(kept) == 60
    assert notes == ()


@pytest.mark.parametrize("rows", [[0], [30, 31], [59]])
def test_heights_that_jump_for_some_rows_are_unknown(rows):
    height_m = 600.0 + 2.0 * ROW
    height_m[rows] += 8_000.0
    flown = with_columns(SOUND["position"], h_msl_m=height_m)
    kept, notes = plausible_samples(flown, "height")
    assert np.flatnonzero(np.isnan(kept["h_msl_m"])).tolist() == rows
    assert counted(notes) == [("loss", "SENSOR-RANGE", len(rows))]


def test_what_jumps_everywhere_is_noise_and_is_reported():
    row = np.arange(50_000)
    noise = channel("X", row / 10.0, pressure_pa=90_000.0 + 5_000.0 * (row % 2))
    kept, notes = plausible_samples(noise, "pressure")
    assert len(kept) == row.size
    assert [note.code for note in notes] == ["SENSOR-NOISE"]


# By hand: the poles, the Dead Sea and a balloon, the driest cold.
LIMITS = {
    "lat_rad": (-np.pi / 2, np.pi / 2),
    "lon_rad": (-2 * np.pi, 2 * np.pi),
    "h_msl_m": (-600.0, 60_000.0),
    "h_ellipsoid_m": (-700.0, 60_000.0),
    "pressure_pa": (20.0, 120_000.0),
    "temperature_k": (170.0, 340.0),
    "relative_humidity": (-0.05, 1.15),
    "airspeed_m_s": (-5.0, 700.0),
}


@pytest.mark.parametrize("column", RANGES)
def test_the_range_of_each_column(column):
    """A day lies between the samples: nothing is too fast."""
    low, high = LIMITS[column]
    beyond = 1e-6 * abs(high - low)
    usual = STILL.get(column, 0.0)
    columns = {
        "lat_rad": 0.0,
        "lon_rad": 0.0,
        "x": 0.0,
    }
    for value, is_possible in (
        (low, True),
        (low - beyond, False),
        (high, True),
        (high + beyond, False),
    ):
        values = np.where(ROW == 30, value, usual)
        days = channel("X", ROW * 86_400.0, **columns | {column: values})

        masked, notes = mask_impossible_values(days)

        of_range = [note for note in notes if note.code == "SENSOR-RANGE"]
        assert counted(of_range) == [("loss", "SENSOR-RANGE", 1)] * (not is_possible)
        assert np.isfinite(masked[column]).sum() == 59 + is_possible


@pytest.mark.parametrize("role", SOUND)
def test_a_log_flags_what_a_mission_would(role):
    """Nothing is left of the wrong rows that a role could use, and they are counted once."""
    wrong = with_jumps(role, [30, 31])
    wrong = with_columns(wrong, board_temperature_k=np.full(60, 310.0))
    masked, notes = mask_impossible_values(wrong)
    assert len(masked) == 58
    assert sum(note.count for note in notes) == 2
    again, notes = plausible_samples(masked, role)
    assert len(again) == 58
    assert notes == ()


def test_a_column_in_another_unit_is_left_to_the_mission():
    masked, notes = mask_impossible_values(logged(temperature_k=15.0))
    assert (masked["temperature_k"] == 15.0).all()
    assert located(notes) == [("warning", "SENSOR-ODD", "X")]


@pytest.mark.parametrize(
    ("role", "column", "value", "unit"),
    [
        ("pressure", "pressure_pa", 1013.25, "hPa"),
        ("temperature", "temperature_k", 15.0, "degC"),
        ("humidity", "relative_humidity", 65.0, "percent"),
    ],
)
def test_a_wrong_unit_is_refused(role, column, value, unit):
    with refused("CHANNEL-UNIT", MissionError) as refusal:
        plausible_samples(channel("BARO[0]", TENTHS, **{column: value}), role)
    assert f"looks like {unit}" in refusal.value.what
    # What is to be written is YAML, brackets of the name included.
    _, _, section = refusal.value.remedy.partition(f"log.channels.{role}: ")
    assert yaml.safe_load(section) == {"name": "BARO[0]", "unit": unit}


def test_power_ups_and_labels_stay_with_their_samples():
    temperature_k = [
        280.0,
        np.nan,
        280.0,
        np.nan,
        np.nan,
        280.0,
    ]
    made = replace(
        channel("X", np.arange(6), temperature_k=temperature_k),
        boot=np.array([0, 0, 1, 1, 2, 2], np.int16),
        labels={"image": tuple("abcdef")},
    )

    kept, notes = plausible_samples(made, "temperature")

    assert kept.boot.tolist() == [0, 1, 2]
    assert kept.labels["image"] == ("a", "c", "f")
    assert counted(notes) == [("loss", "SENSOR-RANGE", 3)]


@pytest.mark.parametrize(
    ("before", "aligned"),
    [
        (0, 1),
        (2, 3),
        (20, 1),
    ],
)
def test_the_first_attitude_after_alignment_is_no_loss(before, aligned):
    """Yaw is 0 until the filter is aligned, half-way there in one sample, then right."""
    yaw_deg = np.full(60, 170.0)
    yaw_deg[:before] = 0.0
    yaw_deg[before] = 80.0
    kept, notes = plausible_samples(rotating("z", yaw_deg), "attitude")
    assert counted(notes) == [("note", "ATTITUDE-ALIGNED", aligned)]
    assert len(kept) == 60 - aligned


@pytest.mark.parametrize(("turn_deg", "rows"), [(49.9, 60), (50.1, 59)])
def test_an_attitude_may_turn_by_500_degrees_a_second(turn_deg, rows):
    turned = rotating("z", turn_deg * (ROW == 30))
    kept, _ = plausible_samples(turned, "attitude")
    assert len(kept) == rows


def test_a_glitch_beside_an_alignment_is_a_loss():
    yaw_deg = np.full(60, 170.0)
    yaw_deg[0] = 80.0
    yaw_deg[40] = 20.0
    masked, notes = mask_impossible_values(rotating("z", yaw_deg))
    assert len(masked) == 58
    assert counted(notes) == [("note", "ATTITUDE-ALIGNED", 1), ("loss", "SENSOR-JUMP", 1)]
    assert "4.000 s" in notes[1].what


def test_each_value_and_sample_that_is_not_used_keeps_its_reason():
    """Row 20 has nothing left; of rows 5 and 30 the other value is used. Each is counted once."""
    pressure_pa = np.full(40, 9e4)
    pressure_pa[[5, 20]] = [1.0, 8e4]  # out of range; a jump there and back
    pressure_pa[35] = np.nan  # missing in the log itself
    temperature_k = np.full(40, 280.0)
    temperature_k[[20, 30]] = [np.nan, 900.0]
    log = channel(
        "BARO",
        np.arange(40),
        pressure_pa=pressure_pa,
        temperature_k=temperature_k,
    )

    masked, notes_of_log = mask_impossible_values(log)

    assert sorted(counted(notes_of_log)) == [
        ("loss", "SENSOR-JUMP", 1),
        ("loss", "SENSOR-RANGE", 1),
        ("loss", "SENSOR-RANGE", 1),
    ]
    assert len(masked) == 39
    assert masked.removed.time_ns.tolist() == [20 * NS_PER_S]
    assert masked.removed.reason.tolist() == [Reason.JUMP]
    of_pressure = {5: Reason.OUT_OF_RANGE, 20: Reason.JUMP, 35: Reason.NO_VALUE}
    of_temperature = {20: Reason.JUMP, 30: Reason.OUT_OF_RANGE}
    missing = [("loss", "SENSOR-RANGE", 1)]
    for role, reasons, expected in (
        ("pressure", of_pressure, missing),
        ("temperature", of_temperature, []),
    ):
        kept, notes = plausible_samples(masked, role)
        assert counted(notes) == expected
        assert len(kept) == 40 - len(reasons)
        rows = kept.removed.time_ns // NS_PER_S
        assert dict(zip(rows, kept.removed.reason, strict=True)) == reasons


READINGS_PA = arrays(
    np.float64,
    40,
    elements=strategies.floats(-1e7, 1e7) | strategies.just(np.nan),
)


@settings(max_examples=60)
@given(READINGS_PA)
def test_masking_touches_no_plausible_value_and_counts_all_others_once(values):
    row = np.arange(40.0)
    logged = channel(
        "X",
        row,
        pressure_pa=values,
        row=row,
    )

    masked, notes = mask_impossible_values(logged)

    read_pa = values[masked["row"].astype(int)]
    pressure_pa = masked["pressure_pa"]
    is_kept = np.isfinite(pressure_pa)
    kept_pa = pressure_pa[is_kept]
    np.testing.assert_array_equal(kept_pa, read_pa[is_kept])
    if any(note.code == "SENSOR-ODD" for note in notes):
        return
    low, high = RANGES["pressure_pa"]
    assert (kept_pa >= low).all()
    assert (kept_pa <= high).all()
    lost = np.isfinite(values).sum() - kept_pa.size
    assert sum(note.count for note in notes if note.kind == "loss") == lost
