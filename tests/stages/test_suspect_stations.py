"""A log that contradicts itself, through the command line: suspect stations, used or not."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.helpers import one_line, with_code
from tests.stages.dataflash_records import records, times_us, value_of, write_value
from tests.stages.other_logs import read_folder

LATITUDE_OF_77_M = round(np.degrees(77.0 / 6.371e6) * 1e7)
AROUND_US = 2_000_000


def move(mission, name, column, by, first_us, last_us):
    """Change a column of a message of the log between two times, in the log's own unit."""
    log = mission.log.read_bytes()
    changed = bytearray(log)
    for record in records(log):
        if record.name == name and first_us <= record.time_us <= last_us:
            field = record.fields()[column]
            value = value_of(log, field)
            write_value(changed, field, value + by)
    mission.log.write_bytes(changed)


def move_north(mission, name):
    """A message of the log is 77 m off for 4 s around the first two exposures."""
    log = mission.log.read_bytes()
    shot_us = min(times_us(log, "CAM"))
    first_us = shot_us - AROUND_US
    last_us = shot_us + AROUND_US
    move(mission, name, "Lat", LATITUDE_OF_77_M, first_us, last_us)


@pytest.fixture
def glitch(mission):
    """The mission with a receiver and a filter that are off together."""
    move_north(mission, "GPS")
    move_north(mission, "POS")
    return mission


def suspicions(manifest):
    """What is said of the suspect stations of each camera."""
    texts = []
    for entry in manifest["ledger"]:
        if entry["code"] == "STATIONS-SUSPECT" and entry["kind"] == "loss":
            texts.append(entry["what"])
    assert len(texts) == 2
    return texts


def test_exposures_in_a_glitch_get_no_correction_and_the_run_ends_with_three(glitch):
    ended = glitch.run()
    assert ended.code == 3, ended.text
    printed = one_line(ended.out)
    assert "2 suspect stations (without corrected coordinates) before use." in printed
    assert (
        "Check the 2 suspect stations (unbend stations MISSION --plot FILE): 1 exposure " in printed
    )
    assert "Ready for bundle adjustment" not in printed

    stations = glitch.station_rows()
    suspect = stations[stations["status"] == "suspect"]
    good = stations.drop(suspect.index)
    assert len(suspect) == 2
    assert (good["status"] == "ok").all()
    assert suspect["suspect_m"].between(70.0, 84.0).all()
    for reason in suspect["suspect_reason"]:
        assert "GPS[0] steps at" in reason
    assert good["suspect_reason"].isna().all()

    rows = glitch.result_rows()
    of_suspect = rows["image"].isin(suspect["image"])
    assert set(rows["status"][of_suspect]) == {"no_station"}
    assert set(rows["status"][~of_suspect]) == {"ok"}

    for text in suspicions(glitch.manifest()):
        assert text.startswith("1 exposure from 2025-06-12T")
        assert "position is suspect, up to 77 m off" in text


def test_use_suspect_corrects_them_and_ends_with_three_all_the_same(glitch, unbend):
    glitch.config["stations"] = {"use_suspect": True}
    manifest = glitch.run_to_manifest(3)
    stations = glitch.station_rows()
    assert (stations["status"] == "suspect").sum() == 2
    assert stations["profile_id"].notna().all()
    rows = glitch.result_rows()
    assert set(rows["status"]) == {"ok"}
    assert rows["x_corrected_px"].notna().all()
    suspicions(manifest)
    # The finished run knows that they were used: an export computes its corrections again.
    path = glitch.folder / "l.csv"
    exported = unbend("export", glitch.output, "--format", "lattice-csv", "--out", path)
    assert exported.code == 0, exported.text
    text = path.read_text()
    assert all(image in text for image in stations["image"])


def test_a_filter_that_stays_where_it_was_is_not_suspect(mission):
    """The receiver alone jumps and returns: the filter's position, which is used, is right."""
    move_north(mission, "GPS")
    prepared = read_folder(mission)
    assert prepared.stations.ok.all()
    assert not prepared.ledger.has_losses


def test_air_is_not_sampled_at_heights_that_the_barometer_contradicts(mission, baseline):
    """80 m for a sixth of the flight, too long for the barometer to replace them."""
    times = times_us(mission.log.read_bytes(), "GPS")
    duration_us = times[-1] - times[0]
    begin_us = times[0] + 0.4 * duration_us
    end_us = begin_us + duration_us / 6.0
    move(mission, "GPS", "Alt", 8_000, begin_us, end_us)
    prepared = read_folder(mission)
    assert prepared.ledger.has_losses
    warnings = with_code(prepared.ledger, "AIR-SUSPECT-HEIGHT")
    assert {warning.kind for warning in warnings} == {"warning"}
    assert sum(warning.count for warning in warnings) > 100
    profile = prepared.air.adjustment.profile
    clean = pd.read_parquet(baseline.output / "profile.parquet")
    h_m = clean["h_m"].to_numpy()
    temperature_k = profile.temperature(h_m)
    refractivity = profile.refractivity(h_m)
    assert_allclose(temperature_k, clean["temperature_k"], rtol=0.0, atol=0.15)
    assert_allclose(refractivity, clean["refractivity"], rtol=0.0, atol=1e-7)
