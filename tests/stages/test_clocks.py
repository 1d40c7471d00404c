"""Missions whose log has no UTC, or one that is not certain: dates, seasons and sigmas."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from unbend.flight.station_builder import ClockSigmas
from unbend.stages.stations import clock_sigmas

pytestmark = pytest.mark.usefixtures("plain_report")

HEADER = b"\xa3\x95"
FMT = 128


def with_week(path: Path, week: int) -> None:
    """Write another GPS week into all rows of a DataFlash log's receivers."""
    data = bytearray(path.read_bytes())
    lengths: dict[int, int] = {FMT: 89}
    places: dict[int, int] = {}
    at = 0
    while data[at : at + 2] == HEADER:
        kind = data[at + 2]
        if kind == FMT:
            number, length, name, letters, columns = struct.unpack_from("<BB4s16s64s", data, at + 3)
            lengths[number] = length
            names = columns.rstrip(b"\0").decode().split(",")
            if name.rstrip(b"\0") == b"GPS":
                before = letters.rstrip(b"\0").decode()[: names.index("GWk")]
                sizes = {"Q": 8, "B": 1, "I": 4, "H": 2}
                places[number] = 3 + sum(sizes[letter] for letter in before)
        elif kind in places:
            struct.pack_into("<H", data, at + places[kind], week)
        at += lengths[kind]
    path.write_bytes(data)


def without_sensors(mission) -> None:
    """Let a climatology be the only air."""
    channels = mission.config["log"]["channels"]
    channels["temperature"] = channels["humidity"] = channels["pressure"] = "NONE"


def ran(mission) -> dict:
    ended = mission.run()
    assert ended.code in (0, 3), ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def codes(manifest: dict) -> set[str]:
    return {entry["code"] for entry in manifest["ledger"]}


def shifts(mission) -> tuple[np.ndarray, np.ndarray]:
    """The corrections of the measured points, and their sigma by the air [px]."""
    table = mission.results().to_pandas()
    known = table.x_corrected_px.notna()
    shift = np.hypot(table.x_corrected_px - table.x_px, table.y_corrected_px - table.y_px)
    sigma = np.hypot(table.sigma_air_dx_px, table.sigma_air_dy_px)
    return shift[known].to_numpy(), sigma[known].to_numpy()


def test_without_a_date_no_season_is_assumed(mission_factory, tmp_path):
    """The same flight of June with UTC, without, and without but with a stated date."""
    known = mission_factory(tmp_path / "known")
    unknown = mission_factory(tmp_path / "unknown")
    stated = mission_factory(tmp_path / "stated")
    stated.config["mission"]["date"] = "2025-06-12"
    for mission in (known, unknown, stated):
        without_sensors(mission)
        if mission is not known:
            with_week(mission.log, 0)
    assert "FLIGHT-UNDATED" not in codes(ran(known))
    of_unknown = ran(unknown)
    assert {"FLIGHT-UNDATED", "TIME-NO-UTC"} <= codes(of_unknown)
    assert of_unknown["flight"]["begin_utc"] is None
    assert pq.read_table(unknown.output / "stations.parquet")["time_utc"].null_count == len(
        pq.read_table(unknown.output / "stations.parquet")
    )
    of_profile = pq.read_table(unknown.output / "profile.parquet")["time_utc"]
    assert of_profile.null_count == len(of_profile)
    assert "FLIGHT-UNDATED" not in codes(ran(stated))

    true, of_season = shifts(known)
    shown, of_year = shifts(unknown)
    assert np.abs(shown - true).max() < of_year.max()
    assert np.median(of_year) > 1.3 * np.median(of_season)
    shown, of_season_alone = shifts(stated)
    # The hour of the day stays unknown: by day the lowest air is warmer than its mean.
    assert shown == pytest.approx(true, rel=0.04)
    assert np.median(of_season_alone) < np.median(of_year)


def test_sources_with_a_time_need_the_date_of_the_flight(mission, unbend):
    with_week(mission.log, 0)
    report = {"h_msl_m": 450, "metar": "LSZH 120920Z 24008KT CAVOK 18/07 Q1016"}
    mission.config.setdefault("atmosphere", {})["surface"] = [report]
    ended = unbend("check", mission.save())
    assert ended.code == 6, ended.text
    assert "FLIGHT-UNDATED" in ended.err
    mission.config["mission"]["date"] = "2025-06-12T09:30"
    assert unbend("check", mission.save()).code in (0, 3)


def test_a_stated_date_is_evidence_and_is_compared(mission, unbend):
    """Week 1346 is of October 2005, which no log can have, and 2370 is of June 2025."""
    mission.config["mission"]["date"] = "2025-06-12"
    with_week(mission.log, 2370 - 1024)
    ended = unbend("check", mission.save())
    assert "mission.date (2025-06-12)" in " ".join(ended.text.split())
    mission.config["mission"]["date"] = "2025-03-01"
    with_week(mission.log, 2370)
    assert "DATE-CONTRADICTED" in unbend("check", mission.save()).text


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
    names = ("POS", "GPS[0]", "ATT")
    logged = tuple(SimpleNamespace(name=name) for name in names)
    flight = SimpleNamespace(log=SimpleNamespace(utc_sigma_s=5.0), channels=logged)
    events = SimpleNamespace(log={} if events_in_log else None)
    roles = {
        "position": SimpleNamespace(name=position),
        "height": logged[1],
        "attitude": logged[2],
    }
    assert clock_sigmas(SimpleNamespace(events=events), flight, roles) == expected
