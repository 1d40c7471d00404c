"""Sound inputs that are unusual, near what the guards against extreme values refuse: read in full.

Identifiers of 13 digits and more, other units, coarse quaternions, far zones, long paths.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from tests.faults.extreme_blocks import read_block, small_blocks
from tests.faults.extreme_tables import EO_TEXT, GPST, MRK_TEXT, TOW, UNIX_S, UTC, WEEK
from unbend.config.mounts import MountSection
from unbend.config.section import PathText
from unbend.config.yaml_text import read_yaml
from unbend.messages import Ledger
from unbend.tables.geodata.object_points import read_object_points
from unbend.tables.imports import blocks
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.image_stamps import parse_time
from unbend.tables.imports.stated import Stated, channel_of_rows
from unbend.tables.imports.user_tables import read_events, read_orientation
from unbend.tables.imports.user_trajectories import read_trajectory_csv
from unbend.tables.observations import open_observations
from unbend.written_numbers import angle_of, number_of

FIRST_ID = 1_778_068_782_000_123  # 16 digits: microseconds since 1970 as the number of an image
NOON_NS = UNIX_S * 10**9
LEAP_S = 18  # of GPS time in 2026


def losses(ledger: Ledger) -> list[str]:
    return [entry.code for entry in ledger if entry.kind == "loss"]


# Identifiers


def test_the_number_of_an_event_may_have_16_digits(tmp_path: Path) -> None:
    lines = MRK_TEXT.splitlines()
    rest = [line.partition("\t")[2] for line in lines]
    text = "\n".join(f"{FIRST_ID + k}\t{line}" for k, line in enumerate(rest)) + "\n"
    path = tmp_path / "flight.MRK"
    path.write_text(text, encoding="utf-8")
    ledger = Ledger()
    channel = read_mrk(path, GPST, ledger)
    assert channel["event_index"].astype(np.int64).tolist() == [FIRST_ID + k for k in range(8)]
    assert losses(ledger) == []


def test_the_number_of_an_exposure_may_have_16_digits(tmp_path: Path) -> None:
    text = EO_TEXT
    for k in range(8):
        text = text.replace(f"img_{k:03d}\t{k + 1}\t", f"img_{k:03d}\t{FIRST_ID + k}\t")
    path = tmp_path / "eo.txt"
    path.write_text(text, encoding="utf-8")
    channel = read_eo_text(path, GPST, Ledger())
    assert channel["event_index"].astype(np.int64).tolist() == [FIRST_ID + k for k in range(8)]


@pytest.mark.parametrize("name", ["1778068782000", str(2**63 - 1), "1_0", "1e308", "9" * 30])
def test_names_that_look_like_numbers_are_names(tmp_path: Path, name: str) -> None:
    points = tmp_path / "points.csv"
    points.write_text(f"p,x,y,h\n{name},465000.5,5238000.5,500.5\nb,465001.5,5238001.5,501.5\n")
    columns = {"point": "p", "x": "x", "y": "y", "height": "h"}
    assert read_object_points(points, columns, key="k")[0].to_pylist() == [name, "b"]
    events = tmp_path / "events.csv"
    events.write_text(f"i,t\n{name},2026-05-06T12:00:00Z\nb,2026-05-06T12:00:01Z\n")
    table = read_events(events, {"image": "i", "time_utc": "t"}, Ledger())
    assert table.image.tolist() == [name, "b"]


def test_whole_numbers_of_64_bits_stay_exact(tmp_path: Path) -> None:
    """Names of points as integers, and the user's own column of nanoseconds."""
    numbers = [2**63 - 1 - k for k in range(3)]
    times = [NOON_NS + k for k in range(3)]
    table = {
        "image": ["a", "a", "b"],
        "point": numbers,
        "x_px": [1.5, 2.5, 3.5],
        "y_px": [1.5, 2.5, 3.5],
        "t": times,
    }
    path = tmp_path / "o.parquet"
    pq.write_table(pa.table(table), path)
    names = {name: name for name in ("image", "point", "x_px", "y_px")}
    opened = open_observations(path, names, None, Ledger())
    (batch,) = opened.batches(1000)
    assert batch.point.to_pylist() == [str(number) for number in numbers]
    assert batch.users["t"].to_pylist() == times
    points = pa.table({"p": numbers, "h": [1.5, 2.5, 3.5]})
    pq.write_table(points, tmp_path / "p.parquet")
    given, _ = read_object_points(tmp_path / "p.parquet", {"point": "p", "height": "h"}, key="k")
    assert given.to_pylist() == [str(number) for number in numbers]


def test_tracks_of_opensfm_may_have_numbers_of_63_bits(tmp_path: Path) -> None:
    start, files = small_blocks()["opensfm"]
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    path = tmp_path / "tracks.csv"
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    rows = [line.split("\t") for line in lines]
    track = rows[0][1]
    for row in rows:
        if row[1] == track:
            row[1] = str(2**53 + 1)
    path.write_text("\n".join([head, *("\t".join(row) for row in rows)]) + "\n", encoding="utf-8")
    points = set()
    for batch in blocks.block_rows(tmp_path / start, "opensfm"):
        points.update(batch.column("point").to_pylist())
    assert str(2**53 + 1) in {str(point) for point in points}


def test_an_image_point_of_no_object_point_may_be_written_unsigned(tmp_path: Path) -> None:
    """2**64 - 1, as COLMAP holds it and as scripts write it, is -1."""
    for name, text in small_blocks()["colmap"][1].items():
        (tmp_path / name).write_text(text)
    before = [batch.to_pydict() for batch in blocks.block_rows(tmp_path, "colmap")]
    path = tmp_path / "images.txt"
    text = path.read_text()
    lines = text.splitlines()
    row = 1 + next(k for k, line in enumerate(lines) if line and not line.startswith("#"))
    for name, unset in (("signed", "-1"), ("unsigned", str(2**64 - 1))):
        spoilt = [*lines]
        spoilt[row] = " ".join([*lines[row].split(" "), "1.5", "2.5", unset])
        path.write_text("\n".join(spoilt) + "\n")
        read_block(tmp_path, "colmap")
        rows = [batch.to_pydict() for batch in blocks.block_rows(tmp_path, "colmap")]
        if name == "signed":
            signed = rows
    assert rows == signed
    assert rows != before


# Units and places


def test_coordinates_may_be_millimetres(tmp_path: Path) -> None:
    """In a frame of their own, which known positions place."""
    text = "image,x,y,z,o,p,k\n"
    for k in range(3):
        text += f"{k},{465000500.25 + k},5238000500.5,1500250.5,1,2,3\n"
    path = tmp_path / "block.csv"
    path.write_text(text)
    columns = {"image": "image", "x": "x", "y": "y", "z": "z"}
    columns |= {"omega": "o", "phi": "p", "kappa": "k"}
    table = read_orientation(path, Stated(columns=columns), Ledger())
    assert table.position[0].tolist() == [465000500.25, 5238000500.5, 1500250.5]
    (tmp_path / "p.csv").write_text("p,x,y,h\na,465000500.25,5238000500.5,500.5\n")
    names = {"point": "p", "x": "x", "y": "y", "height": "h"}
    _, values = read_object_points(tmp_path / "p.csv", names, key="k")
    assert (values["x"][0], values["y"][0]) == (465000500.25, 5238000500.5)


@pytest.mark.parametrize("longitude", ["-180", "180", "359.9", "360", "-0.0"])
@pytest.mark.parametrize("latitude", ["-90", "90", "0.0001"])
@pytest.mark.parametrize("height", ["-430", "0", "99999"])
def test_places_at_the_limits_of_the_earth_are_places(
    tmp_path: Path, longitude: str, latitude: str, height: str
) -> None:
    path = tmp_path / "t.csv"
    rows = [f"{UNIX_S + k},{latitude},{longitude},{height}" for k in range(3)]
    path.write_text("\n".join(["t,lat,lon,h", *rows]) + "\n")
    names = {"time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}
    ledger = Ledger()
    channel = read_trajectory_csv(path, replace(UTC, columns=names), ledger)
    assert len(channel) == 3
    assert losses(ledger) == []


@pytest.mark.parametrize(
    ("quaternion", "angle_deg"), [("0.71,0,0,0.71", 90.0), ("0.5,0.5,0.5,0.51", None)]
)
def test_a_quaternion_of_two_decimals_is_an_attitude(
    tmp_path: Path, quaternion: str, angle_deg: float | None
) -> None:
    path = tmp_path / "t.csv"
    rows = [f"{UNIX_S + k},47.3,{8.5 + k / 1e4},1500.5,{quaternion}" for k in range(3)]
    path.write_text("\n".join(["t,lat,lon,h,w,x,y,z", *rows]) + "\n")
    names = {"time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}
    names |= {f"q_{axis}": axis for axis in "wxyz"}
    ledger = Ledger()
    channel = read_trajectory_csv(path, replace(UTC, columns=names), ledger)
    assert losses(ledger) == []
    w = channel["q_w"][0]
    z = channel["q_z"][0]
    if angle_deg is not None:
        assert np.degrees(2.0 * np.arctan2(z, w)) == pytest.approx(angle_deg)


@pytest.mark.parametrize("word", ["", "nan", "NaN", "n/a", "--", "-", "null", "None"])
def test_words_for_an_unknown_velocity_are_no_loss(tmp_path: Path, word: str) -> None:
    path = tmp_path / "t.csv"
    rows = [f"{UNIX_S + k},47.3,{8.5 + k / 1e4},1500.5,{10 + k}.5" for k in range(4)]
    rows[2] = rows[2].rpartition(",")[0] + f",{word}"
    path.write_text("\n".join(["t,lat,lon,h,v", *rows]) + "\n")
    names = {"time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}
    ledger = Ledger()
    stated = replace(UTC, columns={**names, "v_north_m_s": "v"})
    channel = read_trajectory_csv(path, stated, ledger)
    assert np.flatnonzero(np.isnan(channel["v_north_m_s"])).tolist() == [2]
    assert losses(ledger) == []


def test_a_row_without_a_height_is_kept() -> None:
    """Where its reader takes it: unknown is not beyond all heights."""
    time_ns = NOON_NS + np.arange(3) * 10**9
    columns = {
        "lat_rad": np.radians([47.3, 47.3, 47.3]),
        "lon_rad": np.radians([8.5, 8.501, 8.502]),
        "h_msl_m": np.array([1500.5, np.nan, 1501.5]),
    }
    ledger = Ledger()
    readable = np.ones(3, np.bool_)
    channel = channel_of_rows(Path("f"), "MRK", time_ns, columns, ledger, readable=readable)
    assert len(channel) == 3
    assert losses(ledger) == []


def test_seconds_of_a_week_may_count_on(tmp_path: Path) -> None:
    """A flight over the end of the week: 604,800 and beyond belong to the next."""
    path = tmp_path / "t.csv"
    rows = [f"{WEEK - 1},{604_800 + TOW + k}.5,47.3,{8.5 + k / 1e4},1500.5" for k in range(3)]
    path.write_text("\n".join(["w,t,lat,lon,h", *rows]) + "\n")
    names = {"week": "w", "time": "t", "latitude": "lat", "longitude": "lon", "height": "h"}
    channel = read_trajectory_csv(path, replace(GPST, columns=names), Ledger())
    in_next_week_s = 315_964_800 + 604_800 * WEEK + TOW - LEAP_S
    assert channel.time_ns[0] == in_next_week_s * 10**9 + 500_000_000


# Times and texts


@pytest.mark.parametrize(
    ("zone", "ahead_h"), [("+14:00", 14.0), ("-12:00", -12.0), ("+1245", 12.75), ("-00:00", 0.0)]
)
def test_the_farthest_zones_are_zones(zone: str, ahead_h: float) -> None:
    here = parse_time("2026:05:06 12:00:00", zone)
    there = parse_time(f"2026:05:06 12:00:00{zone}")
    at_greenwich = parse_time("2026:05:06 12:00:00", "Z")
    assert here is not None
    assert at_greenwich is not None
    assert here == there
    assert here.is_utc
    assert at_greenwich.time_ns - here.time_ns == ahead_h * 3600 * 10**9


def test_a_field_may_be_filled_with_blanks() -> None:
    """Tables of fixed width fill up to 254 characters."""
    assert number_of("-89,9".ljust(254)) == -89.9
    assert angle_of("47 deg 18' 0\" N".ljust(254)) == pytest.approx(47.3)


# Mission files


@pytest.mark.parametrize("angle_deg", [360.0, -360.0, 400.0, 450.0, -720.0])
def test_a_mount_may_turn_more_than_once(angle_deg: float) -> None:
    """As the sum of two angles: the camera sits as after the rest of the last turn."""
    rest_deg = float(np.fmod(angle_deg, 360.0))
    for name in ("roll_deg", "pitch_deg", "yaw_deg"):
        turned = MountSection.model_validate({name: angle_deg}).mount
        rest = MountSection.model_validate({name: rest_deg}).mount
        np.testing.assert_allclose(turned.camera_from_body, rest.camera_from_body, atol=1e-12)


class WithPath(MountSection):
    """A section with a path."""

    path: PathText


@pytest.mark.parametrize(
    "path",
    [
        "a" * 251 + ".csv",
        "\\".join(["C:", *["folder"] * 60, "o.csv"]),
        "/".join([*["folder"] * 500, "o.csv"]),
        "https://host/o.parquet?token=" + "x" * 5000,
        "s3://bucket/" + "k" * 900,
        "é" * 127,
        "a b/ü 1e308/1_0.csv",
    ],
)
def test_long_paths_are_paths(path: str) -> None:
    assert WithPath.model_validate({"path": path}).path == path


def test_whole_numbers_with_a_tag_are_read_as_yaml_has_them(tmp_path: Path) -> None:
    text = "a: !!int 0x10\nb: !!int 12\nc: !!float 3\nd: 1000000000000000\n"
    path = tmp_path / "m.yaml"
    path.write_text(text)
    values, _ = read_yaml(path)
    assert values == yaml.safe_load(text)


def test_sections_may_be_repeated_by_aliases(tmp_path: Path) -> None:
    """Hundreds of missions that share a section."""
    text = "a: &a {x: 1.5, y: [1, 2, 3]}\nb:\n" + "- {<<: *a, z: *a}\n" * 500
    path = tmp_path / "m.yaml"
    path.write_text(text)
    values, _ = read_yaml(path)
    assert len(values["b"]) == 500
    frame = pd.DataFrame(values["b"])
    assert set(frame["x"]) == {1.5}
