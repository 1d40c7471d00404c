"""Samples that no vehicle and no air can reach are taken out and counted; what can be, stays."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.atmosphere.rejection import Reason
from unbend.flight.channels import Channel, Source
from unbend.flight.evidence.quality import RANGES, mask_impossible_values, plausible_samples
from unbend.messages import Ledger

RATE_HZ = 10.0


def channel(n: int = 60, **columns: np.ndarray) -> Channel:
    time_ns = (np.arange(n) * (1e9 / RATE_HZ)).astype(np.int64)
    return Channel("X", time_ns, columns, Source("X"))


def flown(n: int = 60) -> dict[str, np.ndarray]:
    """60 m/s to the north-east across the date line."""
    along = np.arange(n) * (60.0 / RATE_HZ) / 6.371e6
    lon = np.pi - 1e-5 + along
    return {"lat_rad": 0.8 + along, "lon_rad": np.where(lon > np.pi, lon - 2 * np.pi, lon)}


def turned(n: int = 60) -> dict[str, np.ndarray]:
    """A roll at 400 deg/s, as a multirotor does."""
    half = np.radians(400.0 / RATE_HZ) * np.arange(n) / 2.0
    return {"q_w": np.cos(half), "q_x": np.sin(half), "q_y": 0.0 * half, "q_z": 0.0 * half}


def cold(n: int = 60) -> dict[str, np.ndarray]:
    return {"temperature_k": 280.0 - 0.01 * np.arange(n)}


def climbing(n: int = 60) -> dict[str, np.ndarray]:
    noise = np.random.default_rng(2).normal(0.0, 8.0, n)
    return {"pressure_pa": 90_000.0 - 12.0 * np.arange(n) + noise}


SOUND = {
    "position": flown,
    "attitude": turned,
    "temperature": cold,
    "pressure": climbing,
}
JUMPS = {
    "position": ("lon_rad", 150.0 / 6.371e6),
    "attitude": ("q_z", 8.0),
    "temperature": ("temperature_k", -5.5),
    "pressure": ("pressure_pa", 300.0),
}


@pytest.mark.parametrize("role", SOUND)
def test_what_can_be_stays(role: str) -> None:
    ledger = Ledger()
    assert len(ledger.take(plausible_samples(channel(**SOUND[role]()), role))) == 60
    assert not list(ledger)


@pytest.mark.parametrize("role", SOUND)
def test_one_wrong_sample_is_taken_out_and_counted(role: str) -> None:
    columns = SOUND[role]()
    name, jump = JUMPS[role]
    columns[name][30] += jump
    if role == "attitude":
        q = np.array([columns[f"q_{axis}"][30] for axis in "wxyz"])
        for axis, value in zip("wxyz", q / np.linalg.norm(q), strict=True):
            columns[f"q_{axis}"][30] = value
    ledger = Ledger()
    sound = ledger.take(plausible_samples(channel(**columns), role))
    assert len(sound) == 59
    assert 3_000_000_000 not in sound.time_ns.tolist()
    (entry,) = ledger
    assert (entry.kind, entry.code, entry.count) == ("loss", "SENSOR-JUMP", 1)
    assert "3.000 s" in entry.what


def test_a_step_that_stays_is_no_jump() -> None:
    """A sensor that is set anew, or a gap: both sides of it may be true."""
    columns = cold()
    columns["temperature_k"][30:] += 20.0
    ledger = Ledger()
    assert len(ledger.take(plausible_samples(channel(**columns), "temperature"))) == 60
    assert not list(ledger)


@pytest.mark.parametrize("role", SOUND)
@pytest.mark.parametrize(
    "rows", [(0,), (59,), (20, 21), (0, 1, 2, 3), (56, 57, 58, 59), (10, 11, 40, 58, 59)]
)
def test_wrong_samples_at_any_place(role: str, rows: tuple[int, ...]) -> None:
    columns = SOUND[role]()
    name, jump = JUMPS[role]
    for row in rows:
        columns[name][row] += jump * 40.0 if role != "attitude" else 0.0
        if role == "attitude":  # half a turn about the yaw axis
            w, x, y, z = (columns[f"q_{axis}"][row] for axis in "wxyz")
            for axis, value in zip("wxyz", (-z, y, -x, w), strict=True):
                columns[f"q_{axis}"][row] = value
    ledger = Ledger()
    sound = ledger.take(plausible_samples(channel(**columns), role))
    kept = np.setdiff1d(np.arange(60), rows) * 100_000_000
    np.testing.assert_array_equal(sound.time_ns, kept)
    assert sum(entry.count for entry in ledger) == len(rows)


@pytest.mark.parametrize("rows", [(0,), (30, 31), (59,)])
def test_heights_that_jump_for_some_rows_are_unknown(rows: tuple[int, ...]) -> None:
    height = 600.0 + 2.0 * np.arange(60)
    height[list(rows)] += 8_000.0
    sound = plausible_samples(channel(**flown(), h_msl_m=height), "height")[0]
    assert tuple(np.flatnonzero(np.isnan(sound["h_msl_m"]))) == rows


def test_what_jumps_everywhere_is_noise_and_is_told() -> None:
    n = 50_000
    pressure = 90_000.0 + 5_000.0 * (np.arange(n) % 2)
    ledger = Ledger()
    assert len(ledger.take(plausible_samples(channel(n, pressure_pa=pressure), "pressure"))) == n
    assert [entry.code for entry in ledger] == ["SENSOR-NOISE"]


# What can be and what cannot, by hand: the poles, the Dead Sea and a balloon, the driest cold.
LIMITS = {
    "lat_rad": ((-1.5707, 1.5707), (-1.5709, 1.5709)),
    "lon_rad": ((-6.28, 6.28), (-6.29, 6.29)),
    "h_msl_m": ((-599.0, 59_999.0), (-601.0, 60_001.0)),
    "h_ellipsoid_m": ((-699.0, 59_999.0), (-701.0, 60_001.0)),
    "pressure_pa": ((21.0, 119_999.0), (19.0, 120_001.0)),
    "temperature_k": ((170.5, 339.5), (169.5, 340.5)),
    "relative_humidity": ((-0.04, 1.14), (-0.06, 1.16)),
    "airspeed_m_s": ((-4.9, 699.0), (-5.1, 701.0)),
}


@pytest.mark.parametrize("column", RANGES)
def test_the_range_of_each_column(column: str) -> None:
    for values, wild in zip(LIMITS[column], (False, True), strict=True):
        for value in values:
            columns = {"lat_rad": np.zeros(60), "lon_rad": np.zeros(60), "x": np.zeros(60)}
            columns[column] = np.full(
                60, {"pressure_pa": 1e4, "temperature_k": 250.0}.get(column, 0.0)
            )
            columns[column][30] = value
            time_ns = np.arange(60) * 86_400 * 10**9  # a day between: nothing is too fast
            ledger = Ledger()
            sound = ledger.take(mask_impossible_values(Channel("X", time_ns, columns, Source("X"))))
            flags = [entry for entry in ledger if entry.code == "SENSOR-RANGE"]
            assert [(entry.kind, entry.count) for entry in flags] == ([("loss", 1)] if wild else [])
            assert int(np.isfinite(sound[column]).sum()) == 60 - wild, value


@pytest.mark.parametrize("role", SOUND)
def test_a_log_flags_what_a_mission_would(role: str) -> None:
    columns = SOUND[role]()
    name, jump = JUMPS[role]
    columns[name][30:32] += 40.0 * jump
    if role == "attitude":
        for row in (30, 31):
            q = np.array([columns[f"q_{axis}"][row] for axis in "wxyz"])
            for axis, value in zip("wxyz", q / np.linalg.norm(q), strict=True):
                columns[f"q_{axis}"][row] = value
    ledger = Ledger()
    sound = ledger.take(
        mask_impossible_values(channel(**columns, board_temperature_k=np.full(60, 310.0)))
    )
    assert len(sound) == 58  # nothing is left of these rows that a role could use
    assert sum(entry.count for entry in ledger) == 2
    again = Ledger()
    assert len(again.take(plausible_samples(sound, role))) == 58
    assert not list(again)


def test_a_row_stays_for_what_is_right_in_it() -> None:
    columns = cold() | {"relative_humidity": np.full(60, 0.5)}
    columns["relative_humidity"][7] = 4.0
    sound = mask_impossible_values(channel(**columns))[0]
    assert np.flatnonzero(np.isnan(sound["relative_humidity"])).tolist() == [7]
    assert np.isfinite(sound["temperature_k"]).all()


def test_a_column_in_another_unit_is_left_to_the_mission() -> None:
    ledger = Ledger()
    sound = ledger.take(mask_impossible_values(channel(temperature_k=np.full(60, 15.0))))
    assert (sound["temperature_k"] == 15.0).all()
    assert [(entry.kind, entry.code) for entry in ledger] == [("warning", "SENSOR-ODD")]


def test_an_impossible_value_is_counted_once() -> None:
    """Range, jump and, later, a missing value: of 60 samples four are bad, and four are counted."""
    pressure = climbing()["pressure_pa"]
    pressure[[7, 8]] = 2e6
    pressure[30] -= 300.0
    pressure[50] = np.nan  # missing in the log itself
    ledger = Ledger()
    log = channel(pressure_pa=pressure, temperature_k=np.full(60, 280.0))
    masked = ledger.take(mask_impossible_values(log))
    assert len(masked) == 60  # the temperature of these rows is known
    assert len(ledger.take(plausible_samples(masked, "pressure"))) == 56
    assert sorted((entry.code, entry.count) for entry in ledger) == [
        ("SENSOR-JUMP", 1),
        ("SENSOR-RANGE", 1),
        ("SENSOR-RANGE", 2),
    ]


@pytest.mark.parametrize(
    ("role", "column", "low", "high"),
    [
        ("pressure", "pressure_pa", 20.0, 120_000.0),
        ("temperature", "temperature_k", 170.0, 340.0),
        ("humidity", "relative_humidity", -0.05, 1.15),
        ("airspeed", "airspeed_m_s", -5.0, 700.0),
    ],
)
def test_limits_of_what_can_be_true(role: str, column: str, low: float, high: float) -> None:
    for limit, beyond in ((low, -1e-3), (high, 1e-3)):
        kept, notes = plausible_samples(channel(3, **{column: np.full(3, limit)}), role)
        assert (len(kept), notes) == (3, ())
        outside = channel(3, **{column: np.full(3, limit + beyond)})
        kept, notes = plausible_samples(outside, role)
        assert (len(kept), [(e.code, e.count) for e in notes]) == (0, [("SENSOR-RANGE", 3)])


def test_power_ups_stay_with_their_samples() -> None:
    boot = np.array([0, 0, 1, 1, 2, 2], np.int16)
    values = {"temperature_k": np.array([280.0, np.nan, 280.0, np.nan, np.nan, 280.0])}
    logged = Channel(
        "X", np.arange(6) * 10**9, values, Source("X"), boot, labels={"image": tuple("abcdef")}
    )
    kept, _ = plausible_samples(logged, "temperature")
    assert kept.boot.tolist() == [0, 1, 2]
    assert kept.labels["image"] == ("a", "c", "f")


def yawed(degrees: np.ndarray) -> dict[str, np.ndarray]:
    half = np.radians(degrees) / 2.0
    return {"q_w": np.cos(half), "q_x": 0.0 * half, "q_y": 0.0 * half, "q_z": np.sin(half)}


@pytest.mark.parametrize("before", [0, 2, 20])
def test_the_first_attitude_after_alignment_is_no_loss(before: int) -> None:
    """Yaw is 0 until the filter is aligned, half-way there in one sample, then right."""
    yaw = np.full(60, 170.0)
    yaw[:before], yaw[before] = 0.0, 80.0
    ledger = Ledger()
    sound = ledger.take(plausible_samples(channel(**yawed(yaw)), "attitude"))
    (entry,) = ledger
    told = before + 1 if before <= 4 else 1
    assert (entry.kind, entry.code, entry.count) == ("note", "ATTITUDE-ALIGNED", told)
    assert len(sound) == 60 - told


def test_a_glitch_beside_an_alignment_is_a_loss() -> None:
    yaw = np.full(60, 170.0)
    yaw[0], yaw[40] = 80.0, 20.0
    ledger = Ledger()
    sound = ledger.take(mask_impossible_values(channel(**yawed(yaw))))
    assert len(sound) == 58
    assert [(entry.kind, entry.code, entry.count) for entry in ledger] == [
        ("note", "ATTITUDE-ALIGNED", 1),
        ("loss", "SENSOR-JUMP", 1),
    ]
    assert "4.000 s" in list(ledger)[1].what


def test_each_value_and_sample_that_is_not_used_keeps_its_reason():
    pressure = np.full(40, 9e4)
    pressure[[5, 20]] = [1.0, 8e4]  # out of range; a jump there and back
    temperature = np.full(40, 280.0)
    temperature[20] = np.nan
    temperature[30] = 900.0
    time_ns = np.arange(40, dtype=np.int64) * 10**9
    log = Channel(
        "BARO", time_ns, {"pressure_pa": pressure, "temperature_k": temperature}, Source("BARO")
    )
    masked, _ = mask_impossible_values(log)
    # Row 20 has nothing left; of rows 5 and 30 the other value is used.
    assert masked.removed.time_ns.tolist() == [20 * 10**9]
    assert masked.removed.reason.tolist() == [Reason.JUMP]
    assert masked.rejected["pressure_pa"][5] == Reason.OUT_OF_RANGE
    assert masked.rejected["temperature_k"][29] == Reason.OUT_OF_RANGE
    for role, second in (("pressure", 5), ("temperature", 30)):
        kept, notes = plausible_samples(masked, role)
        assert notes == ()
        assert kept.removed.time_ns.tolist() == sorted([second * 10**9, 20 * 10**9])
        assert sorted(kept.removed.reason.tolist()) == [Reason.OUT_OF_RANGE, Reason.JUMP]
        assert len(kept) == 38
