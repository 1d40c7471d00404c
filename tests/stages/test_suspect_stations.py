"""A log that contradicts itself, through the command line: suspect stations, used or not."""

from __future__ import annotations

import json
import struct

import numpy as np
import pandas as pd
import pytest

pytestmark = pytest.mark.usefixtures("plain_report")

SIZES = {"Q": 8, "L": 4, "I": 4, "f": 4, "e": 4, "c": 2, "C": 2, "H": 2, "B": 1, "b": 1, "E": 4}
NORTH_M = 77.0


def records(content: bytes):
    """Start, name, format letters, columns and time of each record that begins with one."""
    formats: dict[int, tuple[str, int, str, list[str]]] = {}
    i = 0
    while i + 3 <= len(content):
        kind = content[i + 2]
        if kind == 128:
            name = content[i + 5 : i + 9]
            letters = content[i + 9 : i + 25]
            formats[content[i + 3]] = (
                name.rstrip(b"\0").decode(),
                content[i + 4],
                letters.rstrip(b"\0").decode(),
                content[i + 25 : i + 89].rstrip(b"\0").decode().split(","),
            )
            i += 89
            continue
        name, length, letters, columns = formats[kind]
        yield i, name, letters, columns, int.from_bytes(content[i + 3 : i + 11], "little")
        i += length


def moved(
    content: bytes, first_us: float, last_us: float, names: set[str], *, column: str, by: int
) -> bytes:
    """The log with a column of messages changed between two times, in the log's own unit."""
    changed = bytearray(content)
    for at, name, letters, columns, time_us in records(content):
        if name in names and first_us <= time_us <= last_us:
            where = at + 3 + sum(SIZES[x] for x in letters[: columns.index(column)])
            (value,) = struct.unpack_from("<i", content, where)
            struct.pack_into("<i", changed, where, value + by)
    return bytes(changed)


def moved_north(content: bytes, first_us: int, last_us: int, names: set[str]) -> bytes:
    """The log with the latitudes of messages moved by 77 m between two times."""
    by = round(np.degrees(NORTH_M / 6.371e6) * 1e7)
    return moved(content, first_us, last_us, names, column="Lat", by=by)


@pytest.fixture
def glitch(mission):
    """The mission with a receiver and a filter 77 m off for 4 s around its first two exposures."""
    content = mission.log.read_bytes()
    shot = min(time for _, name, _, _, time in records(content) if name == "CAM")
    moved = moved_north(content, shot - 2_000_000, shot + 2_000_000, {"GPS", "POS"})
    mission.log.write_bytes(moved)
    return mission


def suspicions(mission) -> list[str]:
    manifest = json.loads((mission.output / "manifest.json").read_text())
    wanted = ("loss", "STATIONS-SUSPECT")
    return [e["what"] for e in manifest["ledger"] if (e["kind"], e["code"]) == wanted]


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
    assert (
        stations.loc[suspect, "suspect_reason"].str.contains("GPS[0] steps at", regex=False).all()
    )
    assert stations.loc[~suspect, "suspect_reason"].isna().all()
    rows = glitch.results().to_pandas()
    of_suspect = rows["image"].isin(stations.loc[suspect, "image"])
    assert of_suspect.any()
    assert set(rows.loc[of_suspect, "status"]) == {"no_station"}
    assert set(rows.loc[~of_suspect, "status"]) == {"ok"}
    told = suspicions(glitch)  # one entry a camera
    assert len(told) == 2
    assert all(what.startswith("1 exposure from 2025-06-12T") for what in told)
    assert all("position is suspect, up to 77 m off" in what for what in told)


def test_use_suspect_corrects_them_and_ends_with_three_all_the_same(glitch, unbend):
    glitch.config["stations"] = {"use_suspect": True}
    ended = glitch.run()
    assert ended.code == 3, ended.text
    stations = glitch.stations().to_pandas()
    assert (stations["status"] == "suspect").sum() == 2
    assert stations["profile_id"].notna().all()
    rows = glitch.results().to_pandas()
    assert set(rows["status"]) == {"ok"}
    assert rows["x_corrected_px"].notna().all()
    assert len(suspicions(glitch)) == 2
    # The finished run knows that they were used: an export computes its corrections again.
    exported = unbend(
        "export", glitch.output, "--format", "lattice-csv", "--out", glitch.folder / "l.csv"
    )
    assert exported.code == 0, exported.text
    text = (glitch.folder / "l.csv").read_text()
    assert all(image in text for image in stations["image"])


def test_a_filter_that_stays_where_it_was_is_not_suspect(mission):
    """The receiver alone jumps and returns: the filter's position, which is used, is right."""
    content = mission.log.read_bytes()
    shot = min(time for _, name, _, _, time in records(content) if name == "CAM")
    mission.log.write_bytes(moved_north(content, shot - 2_000_000, shot + 2_000_000, {"GPS"}))
    ended = mission.run()
    assert ended.code == 0, ended.text
    assert set(mission.stations()["status"].to_pylist()) == {"ok"}


def test_air_is_not_sampled_at_heights_that_the_barometer_contradicts(mission, baseline):
    """80 m for a sixth of the flight, too long for the barometer to replace them."""
    content = mission.log.read_bytes()
    times = [time for _, name, _, _, time in records(content) if name == "GPS"]
    begin = times[0] + 0.4 * (times[-1] - times[0])
    end = begin + (times[-1] - times[0]) / 6.0
    mission.log.write_bytes(moved(content, begin, end, {"GPS"}, column="Alt", by=8_000))
    ended = mission.run()
    assert ended.code == 3, ended.text
    manifest = json.loads((mission.output / "manifest.json").read_text())
    entries = [e for e in manifest["ledger"] if e["code"] == "AIR-SUSPECT-HEIGHT"]
    assert {e["kind"] for e in entries} == {"warning"}
    assert sum(e["count"] for e in entries) > 100
    profile, clean = (
        pd.read_parquet(folder.output / "profile.parquet") for folder in (mission, baseline)
    )
    for column, allowed in (("temperature_k", 0.15), ("refractivity", 1e-7)):
        there = np.interp(clean["h_m"], profile["h_m"], profile[column])
        np.testing.assert_allclose(there, clean[column], rtol=0.0, atol=allowed)
