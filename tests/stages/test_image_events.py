"""Images get the events they were exposed at, or a refusal.

On logs that are written here, and on those of the autopilot's own simulator in ../shared/logs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from pymavlink.DFReader import DFReader_binary

from tests.helpers import refused, with_code
from tests.stages.flown_images import CAMERA, tie_points, truth_of
from tests.stages.written_surveys import SHUTTER_LAG_US, write_surveys
from unbend.batch.runs import read_mission
from unbend.stages.multi_image.camera_images import images_of_camera
from unbend.stages.story import PreparedMission

SITL = Path(__file__).resolve().parents[3] / "shared" / "logs"
CHANNEL = {"BIN": "CAM[{}]", "tlog": "CAMERA_FEEDBACK[{}]"}
COUNTED = "IMG_{n:04d}.tif"
PAIR = {"left": 0, "right": 1}
"""Cameras of the second flight, and their numbers in the log."""


def scattered(names: list[str]) -> pd.DataFrame:
    """Observations of which no point is seen twice."""
    rows = pd.DataFrame({"image": np.repeat(names, 2), "x_px": 100.0, "y_px": 200.0})
    return rows.assign(point=rows.index.astype(str))


def exif_table(folder: Path, names: list[str], time_s: np.ndarray, *, decimals: int = 2) -> None:
    """What exiftool -csv writes for images exposed at these Unix times by the camera's clock."""
    parts = np.floor(time_s * 10**decimals).astype(np.int64)
    moment = pd.to_datetime(parts // 10**decimals, unit="s")
    fraction = [f"{part % 10**decimals:0{decimals}d}" if decimals else "" for part in parts]
    table = pd.DataFrame(
        {
            "SourceFile": [f"./{name}" for name in names],
            "DateTimeOriginal": moment.strftime("%Y:%m:%d %H:%M:%S"),
            "SubSecTimeOriginal": fraction,
        }
    )
    table.to_csv(folder / "exif.csv", index=False)


@dataclass(frozen=True)
class Flown:
    """A flight: logs and truth under one name, the height of its ground, trigger to shutter."""

    path: Path
    ground_m: float
    shutter_lag_us: int

    def log(self, extension: str) -> Path:
        return self.path.with_suffix(f".{extension}")

    @property
    def table(self) -> Path:
        return self.path.with_name(f"{self.path.name}_truth.csv")

    def truth(self, instance: int) -> pd.DataFrame:
        return truth_of(self.table, instance)

    def times(self, truth: pd.DataFrame) -> np.ndarray:
        """Unix times of exposures."""
        return boot_time(self.log("BIN")) + truth["TimeUS"].to_numpy() / 1e6

    def tie_points(self, truth: pd.DataFrame, names: list[str]) -> pd.DataFrame:
        return tie_points(truth, names, self.ground_m)

    def read(
        self,
        folder: Path,
        observations: pd.DataFrame,
        events: dict[str, Any],
        extension: str = "BIN",
    ) -> PreparedMission:
        """A mission of the flight, its images matched to events."""
        observations.to_parquet(folder / "observations.parquet")
        cameras = list(events["log"])
        sections = {
            "mission": {"name": "flight"},
            "log": {"path": str(self.log(extension))},
            "observations": {"path": "observations.parquet"},
            "cameras": {camera: dict(CAMERA) for camera in cameras},
            "mount": {camera: {} for camera in cameras},
            "events": events,
            "ground": {"height": self.ground_m, "reference": "msl"},
            "output": {"path": "results"},
        }
        path = folder / "mission.yaml"
        path.write_text(yaml.safe_dump(sections, sort_keys=False), encoding="utf-8")
        return read_mission(path)


def one_camera(image: str, channel: str = "CAM[0]", **more: Any) -> dict[str, Any]:
    """Events of one camera, whose images are called so."""
    return {"log": {"cam": {"channel": channel, "image": image}}} | more


def assert_placed(prepared: PreparedMission, truth: pd.DataFrame, names: list[str]) -> None:
    """Each image has a station within 20 m of where it was taken.

    The exposures of both flights are farther apart than that.
    """
    stations = prepared.stations
    row = {name: i for i, name in enumerate(stations.image.tolist())}
    rows = np.array([row[name] for name in names])
    north = (np.degrees(stations.lat_rad[rows]) - truth["lat"]) * 111_200.0
    east = (np.degrees(stations.lon_rad[rows]) - truth["lng"]) * 111_320.0
    east *= np.cos(np.radians(truth["lat"]))
    assert (np.hypot(north, east) < 20.0).all()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("surveys")
    write_surveys(folder)
    return folder


FLIGHTS = ("written", "sitl") if SITL.is_dir() else ("written",)


@pytest.fixture(scope="module", params=FLIGHTS)
def flight(request: pytest.FixtureRequest, written: Path) -> Flown:
    """256 exposures of one camera: from the climb, over five lines, to the descent."""
    if request.param == "written":
        return Flown(written / "survey", 450.0, SHUTTER_LAG_US)
    return Flown(SITL / "sitl_survey", 590.0, 120_000)


@pytest.fixture(scope="module", params=FLIGHTS)
def pair(request: pytest.FixtureRequest, written: Path) -> Flown:
    """142 exposures of a left camera, 15 without a pulse, and 128 of a right one."""
    if request.param == "written":
        return Flown(written / "two_cameras", 450.0, SHUTTER_LAG_US)
    return Flown(SITL / "sitl_belowsea_2cam", -428.0, 120_000)


@pytest.fixture(scope="module")
def survey(flight: Flown) -> tuple[Flown, pd.DataFrame, list[str]]:
    """The images of a survey whose first five exposures gave none: 251, counted from 1."""
    truth = flight.truth(0).iloc[5:].reset_index(drop=True)
    return flight, truth, [f"IMG_{n:04d}.tif" for n in range(1, 252)]


@pytest.mark.parametrize(("pattern", "extension"), [(COUNTED, "BIN"), ("*", "tlog")])
def test_tie_points_find_the_five_exposures_without_an_image(survey, extension, pattern, tmp_path):
    flight, truth, names = survey
    events = one_camera(pattern, CHANNEL[extension].format(0))
    prepared = flight.read(tmp_path, flight.tie_points(truth, names), events, extension)
    assert_placed(prepared, truth, names)
    assert prepared.stations.image.tolist() == names
    (assigned,) = with_code(prepared.ledger, "EVENTS-ASSIGNED")
    assert "tie points" in assigned.what
    assert "IMG_0001.tif of event 6" in assigned.what
    (unused,) = with_code(prepared.ledger, "EVENTS-UNUSED")
    assert "5 events have no image: 1, 2, 3, 4, 5" in unused.what
    losses = {message.code for message in prepared.ledger if message.kind == "loss"}
    assert losses <= {"LOG-DROPOUT"}  # the logger's own count in one of the logs


@pytest.mark.parametrize("pattern", [COUNTED, "*"])
def test_counting_alone_never_decides_where_counts_differ(survey, pattern, tmp_path):
    flight, truth, names = survey
    events = one_camera(pattern)
    with refused("EVENTS-AMBIGUOUS") as refusal:
        flight.read(tmp_path, scattered(names), events)
    assert "251" in refusal.value.what
    assert "events.first_image.cam" in refusal.value.remedy
    events["first_image"] = {"cam": {"image": "IMG_0001.tif", "event": 6}}
    assert_placed(flight.read(tmp_path, scattered(names), events), truth, names)
    events["first_image"] = {"cam": {"image": "IMG_0252.tif", "event": 6}}
    with refused("EVENTS-FIRST-IMAGE"):
        flight.read(tmp_path, scattered(names), events)


@pytest.mark.parametrize("decimals", [0, 2])
@pytest.mark.parametrize("off_s", [7237.4, -3 * 86_400.0])
def test_times_of_a_clock_that_is_off_and_drifts(survey, decimals, off_s, tmp_path):
    flight, truth, names = survey
    time_s = flight.times(truth)
    clock_s = time_s + off_s + 2e-5 * (time_s - time_s[0])
    exif_table(tmp_path, names, clock_s, decimals=decimals)
    events = one_camera(COUNTED, images={"path": "exif.csv"})
    prepared = flight.read(tmp_path, scattered(names), events)
    assert_placed(prepared, truth, names)
    assert len(with_code(prepared.ledger, "EXIF-CLOCK")) == (abs(off_s) > 86_400.0)
    assert "times" in with_code(prepared.ledger, "EVENTS-ASSIGNED")[0].what


def with_lost_pulses(pair: Flown) -> pd.DataFrame:
    """All exposures of the left camera; where a pulse is lost, the shutter follows the trigger."""
    truth = pair.truth(0)
    table = pd.read_csv(pair.table)
    triggers = table[(table["row"] == "TRIG") & (table["I"] == 0)]
    lost = triggers[~triggers["Img"].isin(truth["Img"])]
    lost = lost.assign(TimeUS=lost["TimeUS"] + pair.shutter_lag_us)
    exposures = pd.concat([truth, lost]).sort_values("TimeUS")
    assert len(exposures) == 142
    return exposures


def assert_pair(prepared: PreparedMission, pair: Flown, names: dict[str, list[str]]) -> None:
    """Each image with a pulse has its station; the others are unmatched."""
    for camera, instance in PAIR.items():
        truth = pair.truth(instance)
        with_pulse = [names[camera][number - 1] for number in truth["Img"]]
        assert_placed(prepared, truth, with_pulse)
    stations = prepared.stations
    unmatched = stations.image[stations.status == "unmatched"]
    assert len(unmatched) == 15
    assert all(image.startswith("left/") for image in unmatched)
    (told,) = with_code(prepared.ledger, "IMAGES-UNMATCHED")
    assert told.count == 15


def names_and_times(pair: Flown, first_number: int) -> tuple[dict[str, list[str]], np.ndarray]:
    """Images of both cameras with the numbers of their exposures, and when they were exposed."""
    exposures = {"left": with_lost_pulses(pair), "right": pair.truth(1)}
    names = {}
    for camera, rows in exposures.items():
        numbers = range(first_number, first_number + len(rows))
        names[camera] = [f"{camera}/DSC_{number:04d}.JPG" for number in numbers]
    return names, np.concatenate([pair.times(rows) for rows in exposures.values()])


def both_cameras(image: str, channel: str) -> dict[str, Any]:
    sources = {}
    for camera, instance in PAIR.items():
        sources[camera] = {"channel": channel.format(instance), "image": f"{camera}/{image}"}
    return sources


@pytest.mark.parametrize("extension", ["BIN", "tlog"])
def test_lost_pulses_of_two_cameras_by_the_numbers_of_the_log(pair, extension, tmp_path):
    """Of 142 exposures of the left camera 15 have no pulse; the right one's 128 all have."""
    names, _ = names_and_times(pair, 1)
    events = {"log": both_cameras("DSC_{index:04d}.JPG", CHANNEL[extension])}
    observations = scattered(names["left"] + names["right"])
    assert_pair(pair.read(tmp_path, observations, events, extension), pair, names)


@pytest.mark.parametrize("extension", ["BIN", "tlog"])
def test_lost_pulses_of_two_cameras_by_the_times_of_their_files(pair, extension, tmp_path):
    names, time_s = names_and_times(pair, 501)
    both = names["left"] + names["right"]
    exif_table(tmp_path, both, time_s - 3600.0)
    events = {"log": both_cameras("*", CHANNEL[extension]), "images": {"path": "exif.csv"}}
    assert_pair(pair.read(tmp_path, scattered(both), events, extension), pair, names)


def test_the_logs_numbers_are_contradicted_by_tie_points(survey, tmp_path):
    """Files that count from the first image, taken for the log's numbers: five events off."""
    flight, truth, names = survey
    events = one_camera("IMG_{index:04d}.tif")
    with refused("EVENTS-CONTRADICTED"):
        flight.read(tmp_path, flight.tie_points(truth, names), events)
    right = [f"IMG_{n:04d}.tif" for n in truth["Img"]]
    prepared = flight.read(tmp_path, flight.tie_points(truth, right), events)
    assert_placed(prepared, truth, right)
    assert "tie points" in with_code(prepared.ledger, "EVENTS-ASSIGNED")[0].what


def test_counted_names_after_lost_pulses_are_not_believed(pair, tmp_path):
    """127 images of the left camera, 127 pulses: but the log's numbers say that 14 are missing."""
    truth = pair.truth(0)
    names = [f"left_{n:04d}" for n in range(1, 128)]
    events = one_camera("left_{n:04d}")
    with refused("EVENTS-AMBIGUOUS"):
        pair.read(tmp_path, scattered(names), events)
    assert_placed(pair.read(tmp_path, pair.tie_points(truth, names), events), truth, names)


@pytest.mark.parametrize(("first", "lost"), [(120, 5), (243, 5), (6, 4), (236, 12)])
def test_a_hole_between_counted_images_is_refused_by_tie_points_alone(
    flight, first, lost, tmp_path
):
    """Exposures without an image in the midst: the count goes on, and a part of it is shifted."""
    truth = flight.truth(0).drop(index=range(first, first + lost)).reset_index(drop=True)
    names = [f"IMG_{n:04d}.tif" for n in range(1, len(truth) + 1)]
    with refused("EVENTS-AMBIGUOUS"):
        flight.read(tmp_path, flight.tie_points(truth, names), one_camera(COUNTED))


@pytest.mark.parametrize("off_s", [0.0, 7237.4])
def test_two_cameras_in_one_channel_are_never_exchanged_by_whole_seconds(flight, off_s, tmp_path):
    """Pulses that two cameras take in turn, and clocks of whole seconds."""
    truth = flight.truth(0)
    names = [f"{'LR'[k % 2]}/IMG_{k // 2 + 1:04d}.tif" for k in range(len(truth))]
    exif_table(tmp_path, names, flight.times(truth) + off_s, decimals=0)
    sources = {camera: {"channel": "CAM[0]", "image": f"{camera}/{COUNTED}"} for camera in "LR"}
    events = {"log": sources, "images": {"path": "exif.csv"}}
    assert_placed(flight.read(tmp_path, scattered(names), events), truth, names)


def test_images_and_files_that_do_not_go_together(survey, tmp_path):
    flight, truth, names = survey
    time_s = flight.times(truth)
    events = one_camera("*", images={"path": "exif.csv"})

    def read(files: list[str]) -> PreparedMission:
        exif_table(tmp_path, files, time_s[: len(files)])
        return flight.read(tmp_path, scattered(names[100:]), events)

    prepared = read([f"IMG_{n:04d}.NEF" for n in range(1, 200)])
    assert_placed(prepared, truth.iloc[100:199].reset_index(), names[100:199])
    assert with_code(prepared.ledger, "IMAGES-ABSENT")[0].count == 52
    assert with_code(prepared.ledger, "IMAGES-UNMATCHED")[0].count == 52
    assert with_code(prepared.ledger, "STATIONS-UNUSED")[0].count == 100
    with refused("IMAGES-OTHER"):
        read([f"DSC_{n:04d}.NEF" for n in range(1, 200)])
    with refused("IMAGES-DUPLICATE"):
        read([f"{folder}/{names[100]}" for folder in "ab"])


def test_a_pattern_of_no_image_is_refused(survey, tmp_path):
    flight, _, names = survey
    with refused("IMAGES-OTHER"):
        flight.read(tmp_path, scattered(names), one_camera("DSC_*"))


def test_names_and_numbers_of_a_pattern():
    observed = ("DJI_20260501_0009_V.JPG", "DJI_20260501_0010_V.JPG", "other.tif")
    counted = images_of_camera("DJI_*_{n:04d}_V.JPG", observed, None)
    assert counted.name.tolist() == list(observed[:2])
    assert counted.number.tolist() == [9, 10]
    assert counted.numbering == "counted"
    sequence = images_of_camera("DJI*", observed, None)
    assert sequence.number.tolist() == [9, 10]
    assert sequence.numbering == "sequence"
    assert images_of_camera("*", ("a9", "a10", "a1"), None).name.tolist() == ["a1", "a9", "a10"]
    assert images_of_camera("*", ("a", "b"), None).number.tolist() == [0, 1]
    index = images_of_camera("{n}_{index:05d}.tif", ("7_00012.tif", "8_00013.TIF"), None)
    assert index.name.tolist() == ["7_00012.tif"]
    assert index.number.tolist() == [12]


@lru_cache
def boot_time(log: Path) -> float:
    """Unix time of the boot of a log by its first GPS week and milliseconds, to 0.3 s."""
    file = DFReader_binary(str(log))
    try:
        while (row := file.recv_match(type="GPS")) is not None:
            if row.GWk > 0 and row.Status >= 3:
                week_s = 315_964_800 + row.GWk * 604_800 - 18
                return week_s + row.GMS / 1e3 - row.TimeUS / 1e6
    finally:
        file.close()
    raise AssertionError("no GPS time")


@pytest.mark.parametrize(
    ("delay", "kinds"),
    [({}, ["finding"]), ({"delay_s": 0.08}, [])],
    ids=["without a delay", "as measured"],
)
def test_commands_of_a_trigger_beside_its_pulses_need_a_delay(mission, delay, kinds):
    mission.config["events"]["log"]["nadir"].update({"channel": "TRIG[0]"} | delay)
    told = with_code(read_mission(mission.save()).ledger, "EVENTS-NOT-SHUTTER")
    assert [message.kind for message in told] == kinds
