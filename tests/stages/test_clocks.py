"""Missions whose log has no UTC, or one that is not certain: dates, seasons and sigmas."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.helpers import codes_of
from unbend.flight.station_builder import ClockSigmas
from unbend.stages.stations import clock_sigmas

HEADER = b"\xa3\x95"
FMT = 128
SIZES = {"Q": 8, "B": 1, "I": 4, "H": 2}


def with_week(path: Path, week: int) -> None:
    """Write another GPS week into all rows of a DataFlash log's receivers."""
    data = bytearray(path.read_bytes())
    lengths: dict[int, int] = {FMT: 89}
    week_at: dict[int, int] = {}
    start = 0
    while data[start : start + 2] == HEADER:
        kind = data[start + 2]
        if kind == FMT:
            number, length, name, letters, columns = struct.unpack_from(
                "<BB4s16s64s", data, start + 3
            )
            lengths[number] = length
            if name.rstrip(b"\0") == b"GPS":
                before_week = columns.decode().split(",").index("GWk")
                sizes = [SIZES[letter] for letter in letters.decode()[:before_week]]
                week_at[number] = 3 + sum(sizes)
        elif kind in week_at:
            struct.pack_into("<H", data, start + week_at[kind], week)
        start += lengths[kind]
    path.write_bytes(data)


def shifts(mission) -> tuple[np.ndarray, np.ndarray]:
    """The corrections of the measured points, and their sigma by the air [px]."""
    table = mission.results().to_pandas().dropna(subset="x_corrected_px")
    shift = np.hypot(table.x_corrected_px - table.x_px, table.y_corrected_px - table.y_px)
    sigma = np.hypot(table.sigma_air_dx_px, table.sigma_air_dy_px)
    return shift.to_numpy(), sigma.to_numpy()


def test_without_a_date_no_season_is_assumed(mission_factory, tmp_path):
    """The same flight of June with UTC, without, and without but with a stated date.

    A climatology is the only air.
    """
    missions = {}
    codes = {}
    for name in ("dated", "undated", "stated"):
        mission = mission_factory(tmp_path / name)
        channels = mission.config["log"]["channels"]
        channels["temperature"] = channels["humidity"] = channels["pressure"] = "NONE"
        if name == "stated":
            mission.config["mission"]["date"] = "2025-06-12"
        if name != "dated":
            with_week(mission.log, 0)
        missions[name] = mission
        codes[name] = codes_of(mission.run_to_manifest(3))
    assert "FLIGHT-UNDATED" not in codes["dated"]
    assert codes["undated"] >= {"FLIGHT-UNDATED", "TIME-NO-UTC"}
    assert "FLIGHT-UNDATED" not in codes["stated"]

    undated = missions["undated"]
    assert undated.manifest()["flight"]["begin_utc"] is None
    for name in ("stations.parquet", "profile.parquet"):
        times = pq.read_table(undated.output / name)["time_utc"]
        assert times.null_count == len(times)

    shift, sigma_of_season = shifts(missions["dated"])
    shift_of_year, sigma_of_year = shifts(undated)
    assert np.abs(shift_of_year - shift).max() < sigma_of_year.max()
    assert np.median(sigma_of_year) > 1.3 * np.median(sigma_of_season)
    shift_of_day, sigma_of_day = shifts(missions["stated"])
    # The hour of the day stays unknown: by day the lowest air is warmer than its mean.
    assert shift_of_day == pytest.approx(shift, rel=0.04)
    assert np.median(sigma_of_day) < np.median(sigma_of_year)


def test_sources_with_a_time_need_the_date_of_the_flight(mission, unbend):
    with_week(mission.log, 0)
    report = {"h_msl_m": 450, "metar": "LSZH 120920Z 24008KT CAVOK 18/07 Q1016"}
    mission.config.setdefault("atmosphere", {})["surface"] = [report]
    undated = unbend("check", mission.save())
    assert undated.code == 6, undated.text
    assert "FLIGHT-UNDATED" in undated.err
    mission.config["mission"]["date"] = "2025-06-12T09:30"
    assert unbend("check", mission.save()).code in (0, 3)


@pytest.mark.parametrize(
    ("date", "week", "words"),
    [
        # Week 1346 is of October 2005, which no log can have, and 2370 is of June 2025.
        ("2025-06-12", 2370 - 1024, "mission.date (2025-06-12)"),
        ("2025-03-01", 2370, "DATE-CONTRADICTED"),
    ],
    ids=["evidence", "contradicted"],
)
def test_a_stated_date_is_evidence_and_is_compared(mission, unbend, date, week, words):
    mission.config["mission"]["date"] = date
    with_week(mission.log, week)
    assert words in " ".join(unbend("check", mission.save()).text.split())


@pytest.mark.parametrize(
    ("events_in_log", "position", "expected"),
    [
        (True, "POS", ClockSigmas(0.0, 0.0, 0.0)),
        (False, "POS", ClockSigmas(5.0, 5.0, 5.0)),
        (True, "track.csv", ClockSigmas(5.0, 0.0, 0.0)),
        (False, "track.csv", ClockSigmas(0.0, 5.0, 5.0)),
    ],
)
def test_between_the_clock_of_the_log_and_utc_lies_its_sigma(events_in_log, position, expected):
    names = {"position": position, "height": "GPS[0]", "attitude": "ATT"}
    roles = {role: SimpleNamespace(name=name) for role, name in names.items()}
    logged = [SimpleNamespace(name=name) for name in ("POS", "GPS[0]", "ATT")]
    flight = SimpleNamespace(log=SimpleNamespace(utc_sigma_s=5.0), channels=logged)
    events = SimpleNamespace(log={} if events_in_log else None)
    assert clock_sigmas(SimpleNamespace(events=events), flight, roles) == expected
