"""Images get the events they were exposed at, or a refusal.

On logs that are written here, and on those of the autopilot's own simulator in ../shared/logs.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from pymavlink.DFReader import DFReader_binary

from tests.helpers import refused, with_code
from tests.logs import REAL
from tests.stages.flown_images import CAMERA, tie_points, truth_of
from tests.stages.other_logs import message_of, read_folder
from tests.stages.written_surveys import SHUTTER_LAG_US, write_surveys
from unbend.batch.runs import read_mission
from unbend.flight.stations import station_columns
from unbend.stages.multi_image.camera_images import images_of_camera

FLIGHTS = ["written"]
if REAL.is_dir():
    FLIGHTS.append("sitl")
CHANNEL = {"BIN": "CAM[{}]", "tlog": "CAMERA_FEEDBACK[{}]"}
EXIF = {"path": "exif.csv"}
PAIR = {"left": 0, "right": 1}
"""Cameras of the second flight, and their numbers in the log."""

COUNTED = "IMG_{n:04d}.tif"

GPS_EPOCH_S = 315_964_800
WEEK_S = 604_800
LEAP_S = 18
DAY_S = 86_400.0


def numbered(pattern, numbers):
    return [pattern.format(n=number) for number in numbers]


NAMES = numbered(COUNTED, range(1, 252))
"""The images of a survey of 256 exposures of which five gave none, counted from 1."""


def scattered(names):
    """Observations of which no point is seen twice."""
    rows = pd.DataFrame({"image": np.repeat(names, 2)})
    rows["x_px"] = 100.0
    rows["y_px"] = 200.0
    rows["point"] = rows.index.astype(str)
    return rows


@lru_cache
def boot_time(log):
    """Unix time of the boot of a log by its first GPS week and milliseconds, to 0.3 s."""
    file = DFReader_binary(log)
    try:
        while (row := file.recv_match(type="GPS")) is not None:
            if row.GWk > 0 and row.Status >= 3:
                week_s = GPS_EPOCH_S + row.GWk * WEEK_S - LEAP_S
                return week_s + row.GMS / 1e3 - row.TimeUS / 1e6
    finally:
        file.close()
    raise AssertionError("no GPS time")


@dataclass(frozen=True)
class Flown:
    """A flight: logs and truth under one name, the height of its ground, trigger to shutter.

    Its missions are written to a folder.
    """

    path: Path
    ground_m: float
    shutter_lag_us: int
    folder: Path

    @property
    def table(self):
        return f"{self.path}_truth.csv"

    def truth(self, instance=0):
        return truth_of(self.table, instance)

    def times(self, truth):
        """Unix times of exposures."""
        boot_s = boot_time(f"{self.path}.BIN")
        return boot_s + truth["TimeUS"].to_numpy() / 1e6

    def tie_points(self, truth, names):
        return tie_points(truth, names, self.ground_m)

    def write_exif(self, names, time_s, decimals=2):
        """As exiftool -csv, for images exposed at these Unix times by the camera's clock."""
        hundredths = np.floor(time_s * 100).astype(np.int64)
        moments = pd.to_datetime(hundredths * 10, unit="ms")
        fractions = moments.strftime("%f").str[:decimals]
        table = pd.DataFrame({"SourceFile": names})
        table["SourceFile"] = "./" + table["SourceFile"]
        table["DateTimeOriginal"] = moments.strftime("%Y:%m:%d %H:%M:%S")
        table["SubSecTimeOriginal"] = fractions
        table.to_csv(self.folder / EXIF["path"], index=False)

    def read(self, observations, events, extension="BIN"):
        """A mission of the flight, its images matched to events."""
        observations.to_parquet(self.folder / "observations.parquet")
        cameras = list(events["log"])
        sections = {
            "mission": {"name": "flight"},
            "log": {"path": f"{self.path}.{extension}"},
            "observations": {"path": "observations.parquet"},
            "cameras": {camera: dict(CAMERA) for camera in cameras},
            "mount": {camera: {} for camera in cameras},
            "events": events,
            "ground": {"height": self.ground_m, "reference": "msl"},
            "output": {"path": "results"},
        }
        path = self.folder / "mission.yaml"
        path.write_text(yaml.safe_dump(sections), "utf-8")
        return read_mission(path)


def one_camera(image, channel="CAM[0]", **sections):
    """Events of one camera, whose images are called so."""
    source = {"channel": channel, "image": image}
    return {"log": {"cam": source}} | sections


def assert_placed(prepared, truth, names):
    """Each image has a station within 20 m of where it was taken.

    The exposures of both flights are farther apart than that.
    """
    table = pd.DataFrame(station_columns(prepared.stations))
    stations = table.set_index("image").loc[names]
    latitude = truth["lat"].to_numpy()
    longitude = truth["lng"].to_numpy()
    north_m = 111_200.0 * (stations["lat_deg"] - latitude)
    east_m = 111_320.0 * (stations["lon_deg"] - longitude)
    east_m *= np.cos(np.radians(latitude))
    assert (np.hypot(north_m, east_m) < 20.0).all()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("surveys")
    write_surveys(folder)
    return folder


@pytest.fixture(params=FLIGHTS)
def flight(request, written, tmp_path):
    """256 exposures of one camera: from the climb, over five lines, to the descent."""
    if request.param == "written":
        return Flown(written / "survey", 450.0, SHUTTER_LAG_US, tmp_path)
    return Flown(REAL / "sitl_survey", 590.0, 120_000, tmp_path)


@pytest.fixture(params=FLIGHTS)
def pair(request, written, tmp_path):
    """142 exposures of a left camera, 15 without a pulse, and 128 of a right one."""
    if request.param == "written":
        return Flown(written / "two_cameras", 450.0, SHUTTER_LAG_US, tmp_path)
    return Flown(REAL / "sitl_belowsea_2cam", -428.0, 120_000, tmp_path)


# ---- one camera


@pytest.fixture
def truth(flight):
    """Of the 251 exposures that gave an image."""
    return flight.truth()[5:]


@pytest.mark.parametrize(
    ("pattern", "extension"),
    [
        (COUNTED, "BIN"),
        ("*", "tlog"),
    ],
)
def test_tie_points_find_the_five_exposures_without_an_image(flight, truth, extension, pattern):
    observations = flight.tie_points(truth, NAMES)
    events = one_camera(pattern, CHANNEL[extension].format(0))

    prepared = flight.read(observations, events, extension)

    assert_placed(prepared, truth, NAMES)
    assert prepared.stations.image.tolist() == NAMES
    assigned = message_of(prepared, "EVENTS-ASSIGNED")
    assert "tie points" in assigned.what
    assert "IMG_0001.tif of event 6" in assigned.what
    unused = message_of(prepared, "EVENTS-UNUSED")
    assert "5 events have no image: 1, 2, 3, 4, 5" in unused.what
    assert not any(message.kind == "loss" for message in prepared.ledger)


@pytest.mark.parametrize("pattern", [COUNTED, "*"])
def test_counting_alone_never_decides_where_counts_differ(flight, truth, pattern):
    events = one_camera(pattern)
    observations = scattered(NAMES)
    with refused("EVENTS-AMBIGUOUS", what="251", remedy="events.first_image.cam"):
        flight.read(observations, events)

    first = {"image": "IMG_0001.tif", "event": 6}
    events["first_image"] = {"cam": first}
    assert_placed(flight.read(observations, events), truth, NAMES)

    first["image"] = "IMG_0252.tif"
    with refused("EVENTS-FIRST-IMAGE"):
        flight.read(observations, events)


@pytest.mark.parametrize("decimals", [0, 2])
@pytest.mark.parametrize("off_s", [7237.4, -3 * DAY_S])
def test_times_of_a_clock_that_is_off_and_drifts(flight, truth, decimals, off_s):
    time_s = flight.times(truth)
    drift_s = 2e-5 * (time_s - time_s[0])
    flight.write_exif(NAMES, time_s + off_s + drift_s, decimals)

    events = one_camera(COUNTED, images=EXIF)
    prepared = flight.read(scattered(NAMES), events)

    assert_placed(prepared, truth, NAMES)
    is_days_off = abs(off_s) > DAY_S
    assert len(with_code(prepared.ledger, "EXIF-CLOCK")) == is_days_off
    assert "times" in message_of(prepared, "EVENTS-ASSIGNED").what


def test_the_logs_numbers_are_contradicted_by_tie_points(flight, truth):
    """Files that count from the first image, taken for the log's numbers: five events off."""
    events = one_camera("IMG_{index:04d}.tif")
    observations = flight.tie_points(truth, NAMES)
    with refused("EVENTS-CONTRADICTED"):
        flight.read(observations, events)

    names = numbered(COUNTED, truth["Img"])
    observations = flight.tie_points(truth, names)
    prepared = flight.read(observations, events)
    assert_placed(prepared, truth, names)
    assert "tie points" in message_of(prepared, "EVENTS-ASSIGNED").what


@pytest.mark.parametrize(
    ("first", "end"),
    [
        (120, 125),
        (243, 248),
        (6, 10),
        (236, 248),
    ],
)
def test_a_hole_between_counted_images_is_refused_by_tie_points_alone(flight, first, end):
    """Exposures without an image in the midst: the count goes on, and a part of it is shifted."""
    exposed = flight.truth().drop(index=range(first, end))
    names = numbered(COUNTED, range(1, len(exposed) + 1))
    observations = flight.tie_points(exposed, names)
    with refused("EVENTS-AMBIGUOUS"):
        flight.read(observations, one_camera(COUNTED))


@pytest.mark.parametrize("off_s", [0.0, 7237.4])
def test_two_cameras_in_one_channel_are_never_exchanged_by_whole_seconds(flight, off_s):
    """Pulses that two cameras take in turn, and clocks of whole seconds."""
    exposed = flight.truth()
    names = []
    for name in NAMES[: len(exposed) // 2]:
        names += ["L/" + name, "R/" + name]
    clock_s = flight.times(exposed) + off_s
    flight.write_exif(names, clock_s, decimals=0)
    events = {
        "log": {
            "L": {"channel": "CAM[0]", "image": "L/" + COUNTED},
            "R": {"channel": "CAM[0]", "image": "R/" + COUNTED},
        },
        "images": EXIF,
    }

    prepared = flight.read(scattered(names), events)

    assert_placed(prepared, exposed, names)


@pytest.fixture
def read_with_files(flight, truth):
    """Reads the mission of the last 151 images with the times of these files."""

    events = one_camera("*", images=EXIF)

    def read(files):
        times = flight.times(truth)
        flight.write_exif(files, times[: len(files)])
        return flight.read(scattered(NAMES[100:]), events)

    return read


def test_images_and_files_that_do_not_go_together(truth, read_with_files):
    prepared = read_with_files(numbered("IMG_{n:04d}.NEF", range(1, 200)))

    assert_placed(prepared, truth[100:199], NAMES[100:199])
    assert message_of(prepared, "IMAGES-ABSENT").count == 52
    assert message_of(prepared, "IMAGES-UNMATCHED").count == 52
    assert message_of(prepared, "STATIONS-UNUSED").count == 100


def test_files_of_other_images_or_of_one_twice_are_refused(read_with_files):
    with refused("IMAGES-OTHER"):
        read_with_files(numbered("DSC_{n:04d}.NEF", range(1, 200)))
    with refused("IMAGES-DUPLICATE"):
        name = NAMES[100]
        read_with_files(["a/" + name, "b/" + name])


def test_a_pattern_of_no_image_is_refused(flight):
    with refused("IMAGES-OTHER"):
        flight.read(scattered(NAMES), one_camera("DSC_*"))


# ---- two cameras


def with_lost_pulses(pair):
    """All exposures of the left camera; where a pulse is lost, the shutter follows the trigger."""
    truth = pair.truth()
    triggers = pd.read_csv(pair.table).query("row == 'TRIG' and I == 0")
    has_pulse = triggers["Img"].isin(truth["Img"])
    lost = triggers[~has_pulse].copy()
    lost["TimeUS"] += pair.shutter_lag_us
    exposures = pd.concat([truth, lost]).sort_values("TimeUS")
    assert len(exposures) == 142
    return exposures


def names_of_pair(first):
    """Images of both cameras with the numbers of their exposures."""
    return {
        "left": numbered("left/DSC_{n:04d}.JPG", range(first, first + 142)),
        "right": numbered("right/DSC_{n:04d}.JPG", range(first, first + 128)),
    }


def both_cameras(image, channel):
    sources = {}
    for camera, instance in PAIR.items():
        source = {"channel": channel.format(instance)}
        source["image"] = f"{camera}/{image}"
        sources[camera] = source
    return sources


def assert_pair(prepared, pair, names):
    """Each image with a pulse has its station; the others are unmatched."""
    for camera, instance in PAIR.items():
        truth = pair.truth(instance)
        images = np.array(names[camera])
        with_pulse = images[truth["Img"] - 1]
        assert_placed(prepared, truth, with_pulse)
    stations = prepared.stations
    for image in stations.image[stations.status == "unmatched"]:
        assert image.startswith("left/")
    assert np.sum(stations.status == "unmatched") == 15
    assert message_of(prepared, "IMAGES-UNMATCHED").count == 15


@pytest.mark.parametrize("extension", ["BIN", "tlog"])
def test_lost_pulses_of_two_cameras_by_the_numbers_of_the_log(pair, extension):
    """Of 142 exposures of the left camera 15 have no pulse; the right one's 128 all have."""
    names = names_of_pair(first=1)
    observations = scattered(names["left"] + names["right"])
    events = {"log": both_cameras("DSC_{index:04d}.JPG", CHANNEL[extension])}

    prepared = pair.read(observations, events, extension)

    assert_pair(prepared, pair, names)


@pytest.mark.parametrize("extension", ["BIN", "tlog"])
def test_lost_pulses_of_two_cameras_by_the_times_of_their_files(pair, extension):
    names = names_of_pair(first=501)
    both = names["left"] + names["right"]
    left = with_lost_pulses(pair)
    exposures = pd.concat([left, pair.truth(1)])
    pair.write_exif(both, pair.times(exposures) - 3600.0)
    events = {
        "log": both_cameras("*", CHANNEL[extension]),
        "images": EXIF,
    }

    prepared = pair.read(scattered(both), events, extension)

    assert_pair(prepared, pair, names)


def test_counted_names_after_lost_pulses_are_not_believed(pair):
    """127 images of the left camera, 127 pulses: but the log's numbers say that 14 are missing."""
    truth = pair.truth()
    names = numbered("left_{n:04d}", range(1, 128))
    events = one_camera("left_{n:04d}")
    with refused("EVENTS-AMBIGUOUS"):
        pair.read(scattered(names), events)

    observations = pair.tie_points(truth, names)
    prepared = pair.read(observations, events)
    assert_placed(prepared, truth, names)


# ---- names, and commands of a trigger

DJI = ("DJI_20260501_0009_V.JPG", "DJI_20260501_0010_V.JPG")


@pytest.mark.parametrize(
    ("pattern", "observed", "names", "numbers", "numbering"),
    [
        ("DJI_*_{n:04d}_V.JPG", (*DJI, "other.tif"), DJI, [9, 10], "counted"),
        ("DJI*", (*DJI, "other.tif"), DJI, [9, 10], "sequence"),
        ("*", ("a9", "a10", "a1"), ("a1", "a9", "a10"), [1, 9, 10], "sequence"),
        ("*", ("a", "b"), ("a", "b"), [0, 1], "sequence"),
        ("{n}_{index:05d}.tif", ("7_00012.tif", "8_00013.TIF"), ("7_00012.tif",), [12], "index"),
    ],
    ids=["counted", "in sequence", "any", "without numbers", "of the log"],
)
def test_images_of_a_pattern_are_in_the_order_of_their_numbers(
    pattern, observed, names, numbers, numbering
):
    images = images_of_camera(pattern, observed, None)
    assert images.name.tolist() == list(names)
    assert images.number.tolist() == numbers
    assert images.numbering == numbering


@pytest.mark.parametrize(
    ("delay", "kinds"),
    [
        ({}, ["finding"]),
        ({"delay_s": 0.08}, []),
    ],
    ids=["without a delay", "as measured"],
)
def test_commands_of_a_trigger_beside_its_pulses_need_a_delay(mission, delay, kinds):
    nadir = mission.config["events"]["log"]["nadir"]
    nadir["channel"] = "TRIG[0]"
    nadir.update(delay)
    prepared = read_folder(mission)
    messages = with_code(prepared.ledger, "EVENTS-NOT-SHUTTER")
    assert [message.kind for message in messages] == kinds
