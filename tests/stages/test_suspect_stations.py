"""A log that contradicts itself, through the command line: suspect stations, used or not."""

from __future__ import annotations

import struct

import numpy as np
import pandas as pd
import pytest

from tests.helpers import with_code
from tests.stages.dataflash_records import records, times_us
from unbend.batch.runs import read_mission

pytestmark = pytest.mark.usefixtures("plain_report")

LATITUDE_OF_77_M = round(np.degrees(77.0 / 6.371e6) * 1e7)
AROUND_US = 2_000_000


def move(mission, names: set[str], column: str, by: int, first_us: float, last_us: float) -> None:
    """Change a column of messages of the log between two times, in the log's own unit."""
    content = mission.log.read_bytes()
    changed = bytearray(content)
    for record in records(content):
        if record.name in names and first_us <= record.time_us <= last_us:
            field = record.fields()[column]
            (value,) = struct.unpack_from(field.code, content, field.start)
            struct.pack_into(field.code, changed, field.start, value + by)
    mission.log.write_bytes(changed)


def move_north(mission, names: set[str]) -> None:
    """Messages of the log are 77 m off for 4 s around the first two exposures."""
    shot_us = min(times_us(mission.log.read_bytes(), "CAM"))
    first_us = shot_us - AROUND_US
    last_us = shot_us + AROUND_US
    move(mission, names, "Lat", LATITUDE_OF_77_M, first_us, last_us)


@pytest.fixture
def glitch(mission):
    """The mission with a receiver and a filter that are off together."""
    move_north(mission, {"GPS", "POS"})
    return mission


def suspicions(manifest) -> list[str]:
    entries = [entry for entry in manifest["ledger"] if entry["code"] == "STATIONS-SUSPECT"]
    return [entry["what"] for entry in entries if entry["kind"] == "loss"]


def test_exposures_in_a_glitch_get_no_correction_and_the_run_ends_with_three(glitch):
    ended = glitch.run()
    assert ended.code == 3, ended.text
    printed = " ".join(ended.out.split())
    assert "2 suspect stations (without corrected coordinates) before use." in printed
    assert (
        "Check the 2 suspect stations (unbend stations MISSION --plot FILE): 1 exposure " in printed
    )
    assert "Ready for bundle adjustment" not in printed
    stations = glitch.stations().to_pandas()
    suspect = stations["status"] == "suspect"
    assert suspect.sum() == 2
    assert (stations.loc[~suspect, "status"] == "ok").all()
    assert stations.loc[suspect, "suspect_m"].between(70.0, 84.0).all()
    reason = stations.loc[suspect, "suspect_reason"]
    assert reason.str.contains("GPS[0] steps at", regex=False).all()
    assert stations.loc[~suspect, "suspect_reason"].isna().all()
    rows = glitch.results().to_pandas()
    of_suspect = rows["image"].isin(stations.loc[suspect, "image"])
    assert of_suspect.any()
    assert set(rows.loc[of_suspect, "status"]) == {"no_station"}
    assert set(rows.loc[~of_suspect, "status"]) == {"ok"}
    told = suspicions(glitch.manifest())  # one entry a camera
    assert len(told) == 2
    assert all(what.startswith("1 exposure from 2025-06-12T") for what in told)
    assert all("position is suspect, up to 77 m off" in what for what in told)


def test_use_suspect_corrects_them_and_ends_with_three_all_the_same(glitch, unbend):
    glitch.config["stations"] = {"use_suspect": True}
    manifest = glitch.run_to_manifest(3)
    stations = glitch.stations().to_pandas()
    assert (stations["status"] == "suspect").sum() == 2
    assert stations["profile_id"].notna().all()
    rows = glitch.results().to_pandas()
    assert set(rows["status"]) == {"ok"}
    assert rows["x_corrected_px"].notna().all()
    assert len(suspicions(manifest)) == 2
    # The finished run knows that they were used: an export computes its corrections again.
    path = glitch.folder / "l.csv"
    exported = unbend("export", glitch.output, "--format", "lattice-csv", "--out", path)
    assert exported.code == 0, exported.text
    text = path.read_text()
    assert all(image in text for image in stations["image"])


def test_a_filter_that_stays_where_it_was_is_not_suspect(mission):
    """The receiver alone jumps and returns: the filter's position, which is used, is right."""
    move_north(mission, {"GPS"})
    prepared = read_mission(mission.save())
    assert prepared.stations.ok.all()
    assert not prepared.ledger.has_losses


def test_air_is_not_sampled_at_heights_that_the_barometer_contradicts(mission, baseline):
    """80 m for a sixth of the flight, too long for the barometer to replace them."""
    times = times_us(mission.log.read_bytes(), "GPS")
    duration_us = times[-1] - times[0]
    begin_us = times[0] + 0.4 * duration_us
    move(mission, {"GPS"}, "Alt", 8_000, begin_us, begin_us + duration_us / 6.0)
    prepared = read_mission(mission.save())
    assert prepared.ledger.has_losses
    told = with_code(prepared.ledger, "AIR-SUSPECT-HEIGHT")
    assert {message.kind for message in told} == {"warning"}
    assert sum(message.count for message in told) > 100
    profile = prepared.air.adjustment.profile
    clean = pd.read_parquet(baseline.output / "profile.parquet")
    temperature = profile.temperature(clean["h_m"].to_numpy())
    refractivity = profile.refractivity(clean["h_m"].to_numpy())
    np.testing.assert_allclose(temperature, clean["temperature_k"], rtol=0.0, atol=0.15)
    np.testing.assert_allclose(refractivity, clean["refractivity"], rtol=0.0, atol=1e-7)
