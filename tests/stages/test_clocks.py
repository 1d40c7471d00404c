"""Missions whose log has no UTC, or one that is not certain: dates, seasons and sigmas."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from tests.helpers import codes_of, entry_of, one_line
from tests.stages.corrected_rows import shift
from tests.stages.dataflash_records import records, write_value
from unbend.flight.station_builder import ClockSigmas
from unbend.ingest.flight_log import SecondClock
from unbend.stages.stations import clock_sigmas


def with_week(path, week):
    """Write another GPS week into all rows of a DataFlash log's receivers."""
    log = path.read_bytes()
    changed = bytearray(log)
    for record in records(log):
        if record.name == "GPS":
            field = record.fields()["GWk"]
            write_value(changed, field, week)
    path.write_bytes(changed)


def shifts(mission):
    """The corrections of the measured points, and their sigma by the air [px]."""
    rows = mission.result_rows().dropna(subset="x_corrected_px")
    sigmas = rows[["sigma_air_dx_px", "sigma_air_dy_px"]].to_numpy()
    return np.hypot(*shift(rows).T), np.hypot(*sigmas.T)


def test_without_a_date_no_season_is_assumed(mission_factory, tmp_path):
    """The same flight of June with UTC, without, and without but with a stated date.

    A climatology is the only air.
    """
    missions = {}
    codes = {}
    for name in ("dated", "undated", "stated"):
        mission = mission_factory(tmp_path / name)
        no_sensors = dict.fromkeys(("temperature", "humidity", "pressure"), "NONE")
        mission.config["log"]["channels"] |= no_sensors
        if name == "stated":
            mission.config["mission"]["date"] = "2025-06-12"
        if name != "dated":
            with_week(mission.log, 0)
        missions[name] = mission
        codes[name] = codes_of(mission.run_to_manifest(3))
    assert "FLIGHT-UNDATED" not in codes["dated"] | codes["stated"]
    assert codes["undated"] >= {"FLIGHT-UNDATED", "TIME-NO-UTC"}
    assert "FLIGHT-HOUR" in codes["stated"] - codes["dated"]
    hour = entry_of(missions["stated"].manifest(), "FLIGHT-HOUR")
    assert hour["where"] == "mission.date"
    assert "2025-06-12T10:20" in hour["what"]

    undated = missions["undated"]
    assert undated.manifest()["flight"]["begin_utc"] is None
    for name in ("stations.parquet", "profile.parquet"):
        times = pq.read_table(undated.output / name)["time_utc"]
        assert times.null_count == len(times)

    shift_of_season, sigma_of_season = shifts(missions["dated"])
    shift_of_year, sigma_of_year = shifts(undated)
    difference = np.abs(shift_of_year - shift_of_season)
    assert difference.max() < sigma_of_year.max()
    median_of_year = np.median(sigma_of_year)
    assert median_of_year > 1.3 * np.median(sigma_of_season)
    shift_of_day, sigma_of_day = shifts(missions["stated"])
    # The hour of the day stays unknown: by day the lowest air is warmer than its mean.
    assert shift_of_day == pytest.approx(shift_of_season, rel=0.04)
    assert np.median(sigma_of_day) < median_of_year


def test_sources_with_a_time_need_the_date_of_the_flight(mission, unbend):
    with_week(mission.log, 0)
    report = {"h_msl_m": 450, "metar": "LSZH 120920Z 24008KT CAVOK 18/07 Q1016"}
    mission.config.setdefault("atmosphere", {})["surface"] = [report]
    undated = unbend("check", mission.save())
    assert undated.code == 6, undated.text
    assert "FLIGHT-UNDATED" in undated.err

    mission.config["mission"]["date"] = "2025-06-12T09:30"
    dated = unbend("check", mission.save())
    assert dated.code in (0, 3)


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
    ended = unbend("check", mission.save())
    assert words in one_line(ended.text)


CLOCKS = yaml.safe_load("""
- [CAM, POS, [0, 0, 0]]
- [null, POS, [4, 4, 4]]
- [CAM, track.csv, [4, 0, 0]]
- [null, track.csv, [0, 4, 4]]
- [/image, POS, [3, 3, 3]]
- [/image, track.csv, [5, 3, 3]]
- [/image, /fix, [0, 3, 3]]
- [CAM, /fix, [3, 0, 0]]
- [null, /fix, [5, 4, 4]]
""")


@pytest.mark.parametrize(("exposures", "position", "sigmas"), CLOCKS)
def test_between_two_clocks_is_their_sigma(exposures, position, sigmas):
    """UTC is 4 s from the clock of the log, and this 3 s from the clock of the stamps."""
    names = ["POS", "GPS[0]", "ATT", "CAM", "/image", "/fix"]
    channels = {name: Mock(rank=1) for name in [*names, "track.csv"]}
    for name, channel in channels.items():
        channel.name = name
    second_clock = SecondClock(frozenset({"/image", "/fix"}), ahead_s=0.0, sigma_s=3.0)
    flight = SimpleNamespace(
        log=SimpleNamespace(utc_sigma_s=4.0, second_clock=second_clock),
        channels=tuple(channels[name] for name in names),
    )
    roles = {
        "position": channels[position],
        "height": channels["GPS[0]"],
        "attitude": channels["ATT"],
    }
    log = None if exposures is None else {"nadir": SimpleNamespace(channel=exposures)}
    mission = SimpleNamespace(events=SimpleNamespace(log=log))
    assert clock_sigmas(mission, flight, "nadir", roles) == ClockSigmas(*sigmas)
