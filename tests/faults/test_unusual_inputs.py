"""Sound inputs that are unusual, near what the guards against extreme values refuse: read in full.

Identifiers of 13 digits and more, other units, coarse quaternions, far zones, long paths.
"""

import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.faults.extreme_blocks import first_row, read_block, small_blocks
from tests.faults.extreme_tables import EO_TEXT, GPST, MRK_TEXT, TOW, UNIX_S, UTC, WEEK
from tests.helpers import NS_PER_S, codes_of_losses
from tests.tables.observed import COLUMNS
from unbend.config.mounts import MountSection
from unbend.config.section import PathText
from unbend.config.yaml_text import read_yaml
from unbend.flight.channels import Channel
from unbend.messages import Ledger
from unbend.tables.geodata.object_points import read_object_points
from unbend.tables.imports import blocks
from unbend.tables.imports.camera_events import read_eo_text, read_mrk
from unbend.tables.imports.image_stamps import parse_time
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import read_events, read_orientation
from unbend.tables.observations import open_observations
from unbend.written_numbers import angle_of, number_of

FIRST_ID = 1_778_068_782_000_123  # 16 digits: microseconds since 1970 as the number of an image
IDS = list(range(FIRST_ID, FIRST_ID + 8))
NOON_NS = UNIX_S * NS_PER_S
GPS_EPOCH_S = 315_964_800
WEEK_S = 604_800
LEAP_S = 18  # of GPS time in 2026
POINT_COLUMNS = {
    "point": "p",
    "x": "x",
    "y": "y",
    "height": "h",
}


# Identifiers


def test_the_number_of_an_event_may_have_16_digits(write):
    lines = []
    for number, line in zip(IDS, MRK_TEXT.splitlines(), strict=True):
        _, _, fields = line.partition("\t")
        lines.append(f"{number}\t{fields}")
    ledger = Ledger()

    channel = read_mrk(write("flight.MRK", lines), GPST, ledger)

    assert channel["event_index"].astype(np.int64).tolist() == IDS
    assert codes_of_losses(ledger) == []


def test_the_number_of_an_exposure_may_have_16_digits(write):
    text = EO_TEXT
    for k, number in enumerate(IDS):
        text = text.replace(f"img_{k:03d}\t{k + 1}\t", f"img_{k:03d}\t{number}\t")

    channel = read_eo_text(write("eo.txt", text.splitlines()), GPST, Ledger())

    assert channel["event_index"].astype(np.int64).tolist() == IDS


@pytest.mark.parametrize("name", ["1778068782000", str(2**63 - 1), "1_0", "1e308", "9" * 30])
def test_names_that_look_like_numbers_are_names(write, name):
    rows = ["p,x,y,h", f"{name},465000.5,5238000.5,500.5", "b,465001.5,5238001.5,501.5"]
    points, _ = read_object_points(
        write("points.csv", rows),
        POINT_COLUMNS,
        key="k",
    )
    assert points.to_pylist() == [name, "b"]

    rows = ["i,t", f"{name},2026-05-06T12:00:00Z", "b,2026-05-06T12:00:01Z"]
    columns = {"image": "i", "time_utc": "t"}
    events = read_events(write("events.csv", rows), columns, Ledger())
    assert events.image.tolist() == [name, "b"]


def test_whole_numbers_of_64_bits_stay_exact(tmp_path):
    """Names of points as integers, and the user's own column of nanoseconds."""
    numbers = [2**63 - 1 - k for k in range(3)]
    names = [str(number) for number in numbers]
    times_ns = [NOON_NS + k for k in range(3)]
    table = {
        "image": ["a", "a", "b"],
        "point": numbers,
        "x_px": [1.5, 2.5, 3.5],
        "y_px": [1.5, 2.5, 3.5],
        "t": times_ns,
    }
    path = tmp_path / "o.parquet"
    pq.write_table(pa.table(table), path)
    opened = open_observations(path, COLUMNS, None, Ledger())
    (batch,) = opened.batches(1000)
    assert batch.point.to_pylist() == names
    assert batch.users["t"].to_pylist() == times_ns

    points = pa.table({"p": numbers, "h": [1.5, 2.5, 3.5]})
    pq.write_table(points, path)
    read, _ = read_object_points(
        path,
        {"point": "p", "height": "h"},
        key="k",
    )
    assert read.to_pylist() == names


def test_tracks_of_opensfm_may_have_numbers_of_63_bits(write):
    start, files = small_blocks()["opensfm"]
    tracks = files["tracks.csv"]
    track = tracks.splitlines()[1].split("\t")[1]
    long = str(2**53 + 1)
    every = rf"^([^\t]+\t){track}\t"
    renamed, images = re.subn(every, rf"\g<1>{long}\t", tracks, flags=re.MULTILINE)
    assert images > 1
    for name, text in (files | {"tracks.csv": renamed}).items():
        folder = write(name, text.splitlines()).parent

    points = []
    for batch in blocks.block_rows(folder / start, "opensfm"):
        points += batch.column("point").to_pylist()
    assert long in map(str, points)


def test_an_image_point_of_no_object_point_may_be_written_unsigned(write):
    """2**64 - 1, as COLMAP holds it and as scripts write it, is -1."""
    _, files = small_blocks()["colmap"]
    for name, text in files.items():
        folder = write(name, text.splitlines()).parent
    lines = files["images.txt"].splitlines()
    row = first_row(lines) + 1
    measured = lines[row]

    def rows():
        read_block(folder, "colmap")
        return [batch.to_pydict() for batch in blocks.block_rows(folder, "colmap")]

    before = rows()
    lines[row] = f"{measured} 1.5 2.5 -1"
    write("images.txt", lines)
    signed = rows()
    lines[row] = f"{measured} 1.5 2.5 {2**64 - 1}"
    write("images.txt", lines)

    assert rows() == signed
    assert signed != before


# Units and places


def test_coordinates_may_be_millimetres(write):
    """In a frame of their own, which known positions place."""
    rows = ["image,x,y,z,o,p,k"]
    for k in range(3):
        rows.append(f"{k},{465000500.25 + k},5238000500.5,1500250.5,1,2,3")
    columns = {
        "image": "image",
        "x": "x",
        "y": "y",
        "z": "z",
    }
    columns |= {"omega": "o", "phi": "p", "kappa": "k"}
    stated = Stated(columns=columns)
    table = read_orientation(write("block.csv", rows), stated, Ledger())
    assert table.position[0].tolist() == [465000500.25, 5238000500.5, 1500250.5]

    points = write("p.csv", ["p,x,y,h", "a,465000500.25,5238000500.5,500.5"])
    _, values = read_object_points(points, POINT_COLUMNS, key="k")
    assert values["x"].tolist() == [465000500.25]
    assert values["y"].tolist() == [5238000500.5]


@pytest.fixture
def read_trajectory(trajectory_of):
    """Reads rows of a trajectory without a loss; ``more`` columns stand behind the height."""

    def read(rows, *, stated: Stated = UTC, **more) -> Channel:
        channel, losses = trajectory_of(rows, stated, **more)
        assert losses == {}
        return channel

    return read


@pytest.mark.parametrize(
    "longitude",
    [
        "-180",
        "180",
        "359.9",
        "360",
        "-0.0",
    ],
)
@pytest.mark.parametrize("latitude", ["-90", "90", "0.0001"])
@pytest.mark.parametrize("height", ["-430", "0", "99999"])
def test_places_at_the_limits_of_the_earth_are_places(read_trajectory, longitude, latitude, height):
    rows = [f"{UNIX_S + k},{latitude},{longitude},{height}" for k in range(3)]
    assert len(read_trajectory(rows)) == 3


def moving_rows(count, more):
    return [f"{UNIX_S + k},47.3,{8.5 + k / 1e4},1500.5,{more}" for k in range(count)]


def test_a_quaternion_of_two_decimals_is_an_attitude(read_trajectory):
    axes = {
        "q_w": "w",
        "q_x": "x",
        "q_y": "y",
        "q_z": "z",
    }
    read_trajectory(moving_rows(3, "0.5,0.5,0.5,0.51"), **axes)

    channel = read_trajectory(moving_rows(3, "0.71,0,0,0.71"), **axes)

    angle = 2.0 * np.arctan2(channel["q_z"][0], channel["q_w"][0])
    assert np.degrees(angle) == pytest.approx(90.0)


@pytest.mark.parametrize("word", ["", "nan", "NaN", "n/a", "--", "-", "null", "None"])
def test_words_for_an_unknown_velocity_are_no_loss(read_trajectory, word):
    rows = moving_rows(4, "10.5")
    rows[2] = rows[2].replace(",10.5", f",{word}")
    channel = read_trajectory(rows, v_north_m_s="v")
    assert np.isnan(channel["v_north_m_s"]).tolist() == [False, False, True, False]


def test_seconds_of_a_week_may_count_on(read_trajectory):
    """A flight over the end of the week: 604,800 and beyond belong to the next."""
    rows = []
    for k in range(3):
        rows.append(f"{WEEK_S + TOW + k}.5,47.3,{8.5 + k / 1e4},1500.5,{WEEK - 1}")
    channel = read_trajectory(rows, stated=GPST, week="w")
    in_next_week_s = GPS_EPOCH_S + WEEK_S * WEEK + TOW - LEAP_S
    assert channel.time_ns[0] == in_next_week_s * NS_PER_S + 500_000_000


# Times and texts


@pytest.mark.parametrize(
    ("zone", "ahead_h"),
    [("+14:00", 14.0), ("-12:00", -12.0), ("+1245", 12.75), ("-00:00", 0.0)],
)
def test_the_farthest_zones_are_zones(zone, ahead_h):
    here = parse_time("2026:05:06 12:00:00", zone)
    at_greenwich = parse_time("2026:05:06 12:00:00", "Z")
    assert here is not None
    assert at_greenwich is not None
    assert here.is_utc
    assert here == parse_time(f"2026:05:06 12:00:00{zone}")
    assert at_greenwich.time_ns - here.time_ns == ahead_h * 3600 * NS_PER_S


def test_a_field_may_be_filled_with_blanks():
    """Tables of fixed width fill up to 254 characters."""
    assert number_of("-89,9".ljust(254)) == -89.9
    assert angle_of("47 deg 18' 0\" N".ljust(254)) == pytest.approx(47.3)


# Mission files


@pytest.mark.parametrize("angle_deg", [360.0, -360.0, 400.0, 450.0, -720.0])
def test_a_mount_may_turn_more_than_once(angle_deg):
    """As the sum of two angles: the camera sits as after the rest of the last turn."""
    reduced_deg = float(np.fmod(angle_deg, 360.0))
    for name in ("roll_deg", "pitch_deg", "yaw_deg"):
        turned = MountSection.model_validate({name: angle_deg}).mount
        reduced = MountSection.model_validate({name: reduced_deg}).mount
        np.testing.assert_allclose(turned.camera_from_body, reduced.camera_from_body, atol=1e-12)


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
def test_long_paths_are_paths(path):
    assert WithPath.model_validate({"path": path}).path == path


def test_whole_numbers_with_a_tag_are_read_as_yaml_has_them(write):
    path = write("m.yaml", ["a: !!int 0x10", "b: !!int 12", "c: !!float 3", "d: 1000000000000000"])
    values, _ = read_yaml(path)
    assert values == {
        "a": 16,
        "b": 12,
        "c": 3.0,
        "d": 10**15,
    }


def test_sections_may_be_repeated_by_aliases(write):
    """Hundreds of missions that share a section."""
    path = write("m.yaml", ["a: &a {x: 1.5, y: [1, 2, 3]}", "b:", *["- {<<: *a, z: *a}"] * 500])
    values, _ = read_yaml(path)
    section = {"x": 1.5, "y": [1, 2, 3]}
    assert values["b"] == [section | {"z": section}] * 500
