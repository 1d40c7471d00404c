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

from unbend.batch.runs import read_mission
from unbend.errors import InputError, MissionError
from unbend.stages.multi_image.camera_images import images_of_camera
from unbend.stages.story import PreparedMission

from .flown_images import CAMERA, tie_points, truth_of
from .written_surveys import SHUTTER_LAG_US, write_surveys

SITL = Path(__file__).resolve().parents[3] / "shared" / "logs"
CHANNEL = {"BIN": "CAM[{}]", "tlog": "CAMERA_FEEDBACK[{}]"}


def scattered(names: list[str]) -> pd.DataFrame:
    """Observations of which no point is seen twice."""
    return pd.DataFrame(
        {
            "image": np.repeat(names, 2),
            "point": [f"{name}/{i}" for name in names for i in "ab"],
            "x_px": 100.0,
            "y_px": 200.0,
        }
    )


def exif_table(path: Path, names: list[str], time_s: np.ndarray, *, decimals: int = 2) -> None:
    """What exiftool -csv writes for images exposed at these Unix times by the camera's clock."""
    moment = pd.to_datetime(np.floor(time_s * 10**decimals) / 10**decimals, unit="s").round("ms")
    table = pd.DataFrame(
        {
            "SourceFile": [f"./{name}" for name in names],
            "DateTimeOriginal": moment.strftime("%Y:%m:%d %H:%M:%S"),
            "SubSecTimeOriginal": [
                f"{round(t.microsecond / 1e6 * 10**decimals):0{decimals}d}" if decimals else ""
                for t in moment
            ],
        }
    )
    table.to_csv(path, index=False)


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

    def mission(
        self,
        folder: Path,
        observations: pd.DataFrame,
        events: dict[str, Any],
        extension: str = "BIN",
    ) -> Path:
        """A mission file of the flight."""
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
        return path


def misplaced(prepared: PreparedMission, truth: pd.DataFrame, names: list[str]) -> int:
    """How many images have a station farther than 20 m from where they were taken.

    The exposures of both flights are farther apart than that.
    """
    stations = prepared.stations
    row = {name: i for i, name in enumerate(stations.image.tolist())}
    rows = np.array([row[name] for name in names])
    north = (np.degrees(stations.lat_rad[rows]) - truth["lat"]) * 111_200.0
    east = (np.degrees(stations.lon_rad[rows]) - truth["lng"]) * 111_320.0
    east *= np.cos(np.radians(truth["lat"]))
    return int(np.count_nonzero(~(np.hypot(north, east) < 20.0)))


def entries(prepared: PreparedMission, code: str) -> list[Any]:
    return [entry for entry in prepared.ledger if entry.code == code]


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


@pytest.mark.parametrize(
    ("pattern", "extension"), [("IMG_{n:04d}.tif", "BIN"), ("*", "tlog")], ids=["BIN", "tlog"]
)
def test_tie_points_find_the_five_exposures_without_an_image(survey, extension, pattern, tmp_path):
    flight, truth, names = survey
    events = {"log": {"cam": {"channel": CHANNEL[extension].format(0), "image": pattern}}}
    observations = flight.tie_points(truth, names)
    path = flight.mission(tmp_path, observations, events, extension)
    prepared = read_mission(path)
    assert misplaced(prepared, truth, names) == 0
    assert prepared.stations.image.tolist() == names
    (entry,) = entries(prepared, "EVENTS-ASSIGNED")
    assert "tie points" in entry.what
    assert "IMG_0001.tif of event 6" in entry.what
    (entry,) = entries(prepared, "EVENTS-UNUSED")
    assert "5 events have no image: 1, 2, 3, 4, 5" in entry.what
    losses = {entry.code for entry in prepared.ledger if entry.kind == "loss"}
    assert losses <= {"LOG-DROPOUT"}  # the logger's own count in one of the logs


@pytest.mark.parametrize("pattern", ["IMG_{n:04d}.tif", "*"])
def test_counting_alone_never_decides_where_counts_differ(survey, pattern, tmp_path):
    flight, truth, names = survey
    events: dict[str, Any] = {"log": {"cam": {"channel": "CAM[0]", "image": pattern}}}
    path = flight.mission(tmp_path, scattered(names), events)
    with pytest.raises(MissionError, match="EVENTS-AMBIGUOUS") as caught:
        read_mission(path)
    assert "251" in caught.value.what
    assert "events.first_image.cam" in caught.value.remedy
    events["first_image"] = {"cam": {"image": "IMG_0001.tif", "event": 6}}
    path = flight.mission(tmp_path, scattered(names), events)
    assert misplaced(read_mission(path), truth, names) == 0
    events["first_image"] = {"cam": {"image": "IMG_0252.tif", "event": 6}}
    path = flight.mission(tmp_path, scattered(names), events)
    with pytest.raises(MissionError, match="EVENTS-FIRST-IMAGE"):
        read_mission(path)


@pytest.mark.parametrize("decimals", [0, 2])
@pytest.mark.parametrize("off_s", [7237.4, -3 * 86_400.0])
def test_times_of_a_clock_that_is_off_and_drifts(survey, decimals, off_s, tmp_path):
    flight, truth, names = survey
    time_s = flight.times(truth)
    clock = time_s + off_s + 2e-5 * (time_s - time_s[0])
    exif_table(tmp_path / "exif.csv", names, clock, decimals=decimals)
    events = {
        "log": {"cam": {"channel": "CAM[0]", "image": "IMG_{n:04d}.tif"}},
        "images": {"path": "exif.csv"},
    }
    prepared = read_mission(flight.mission(tmp_path, scattered(names), events))
    assert misplaced(prepared, truth, names) == 0
    assert bool(entries(prepared, "EXIF-CLOCK")) == (abs(off_s) > 86_400.0)
    assert "times" in entries(prepared, "EVENTS-ASSIGNED")[0].what


@pytest.mark.parametrize("extension", ["BIN", "tlog"])
@pytest.mark.parametrize("by", ["number", "times"])
def test_two_cameras_and_lost_pulses(pair, extension, by, tmp_path):
    """Of 142 exposures of the left camera 15 have no pulse; the right one's 128 all have."""
    names = {}
    times = {}
    parts = []
    whole = pd.read_csv(pair.table)
    for camera, instance in (("left", 0), ("right", 1)):
        truth = pair.truth(instance)
        fired = truth
        if camera == "left":  # the shutter follows the trigger by what it does elsewhere
            triggers = whole[(whole["row"] == "TRIG") & (whole["I"] == 0)]
            lost = triggers[~triggers["Img"].isin(truth["Img"])].assign(lost=True)
            lost["TimeUS"] += pair.shutter_lag_us
            fired = pd.concat([truth, lost]).sort_values("TimeUS")
            assert len(fired) == 142
        numbers = fired["Img"] if by == "number" else range(501, 501 + len(fired))
        names[camera] = [f"{camera}/DSC_{i:04d}.JPG" for i in numbers]
        times[camera] = pair.times(fired)
        parts.append(scattered(names[camera]))
    events: dict[str, Any] = {
        "log": {
            camera: {
                "channel": CHANNEL[extension].format(i),
                "image": f"{camera}/*" if by == "times" else f"{camera}/DSC_{{index:04d}}.JPG",
            }
            for i, camera in enumerate(names)
        }
    }
    if by == "times":
        clock = np.concatenate([times["left"] - 3600.0, times["right"] - 3600.0])
        exif_table(tmp_path / "exif.csv", names["left"] + names["right"], clock)
        events["images"] = {"path": "exif.csv"}
    observations = pd.concat(parts)
    path = pair.mission(tmp_path, observations, events, extension)
    prepared = read_mission(path)
    stations = prepared.stations
    for camera, instance in (("left", 0), ("right", 1)):
        truth = pair.truth(instance)
        # What is not among the truth's numbers had no pulse.
        fired = np.arange(1, len(names[camera]) + 1)
        own = [names[camera][i] for i in np.flatnonzero(np.isin(fired, truth["Img"]))]
        assert misplaced(prepared, truth, own) == 0
    unmatched = stations.image[stations.status == "unmatched"]
    assert len(unmatched) == 15
    assert all(image.startswith("left/") for image in unmatched)
    (entry,) = entries(prepared, "IMAGES-UNMATCHED")
    assert entry.count == 15


def test_the_logs_numbers_are_contradicted_by_tie_points(survey, tmp_path):
    """Files that count from the first image, taken for the log's numbers: five events off."""
    flight, truth, names = survey
    events = {"log": {"cam": {"channel": "CAM[0]", "image": "IMG_{index:04d}.tif"}}}
    observations = flight.tie_points(truth, names)
    path = flight.mission(tmp_path, observations, events)
    with pytest.raises(MissionError, match="EVENTS-CONTRADICTED"):
        read_mission(path)
    right = [f"IMG_{n:04d}.tif" for n in truth["Img"]]
    observations = flight.tie_points(truth, right)
    path = flight.mission(tmp_path, observations, events)
    prepared = read_mission(path)
    assert misplaced(prepared, truth, right) == 0
    assert "tie points" in entries(prepared, "EVENTS-ASSIGNED")[0].what


def test_counted_names_after_lost_pulses_are_not_believed(pair, tmp_path):
    """127 images of the left camera, 127 pulses: but the log's numbers say that 14 are missing."""
    truth = pair.truth(0)
    names = [f"left_{n:04d}" for n in range(1, 128)]
    events = {"log": {"left": {"channel": "CAM[0]", "image": "left_{n:04d}"}}}
    path = pair.mission(tmp_path, scattered(names), events)
    with pytest.raises(MissionError, match="EVENTS-AMBIGUOUS"):
        read_mission(path)
    path = pair.mission(tmp_path, pair.tie_points(truth, names), events)
    assert misplaced(read_mission(path), truth, names) == 0


@pytest.mark.parametrize(("first", "lost"), [(120, 5), (243, 5), (6, 4), (236, 12)])
def test_a_hole_between_counted_images_is_refused_by_tie_points_alone(
    flight, first, lost, tmp_path
):
    """Exposures without an image in the midst: the count goes on, and a part of it is shifted."""
    truth = flight.truth(0).drop(index=range(first, first + lost)).reset_index(drop=True)
    names = [f"IMG_{n:04d}.tif" for n in range(1, len(truth) + 1)]
    events = {"log": {"cam": {"channel": "CAM[0]", "image": "IMG_{n:04d}.tif"}}}
    observations = flight.tie_points(truth, names)
    path = flight.mission(tmp_path, observations, events)
    with pytest.raises(MissionError, match="EVENTS-AMBIGUOUS"):
        read_mission(path)


@pytest.mark.parametrize("off_s", [0.0, 7237.4])
def test_two_cameras_in_one_channel_are_never_exchanged_by_whole_seconds(flight, off_s, tmp_path):
    """Pulses that two cameras take in turn, and clocks of whole seconds."""
    truth = flight.truth(0)
    time_s = np.floor(flight.times(truth) + off_s)
    names = [f"{'LR'[k % 2]}/IMG_{k // 2 + 1:04d}.tif" for k in range(len(truth))]
    exif_table(tmp_path / "exif.csv", names, time_s, decimals=0)
    events = {
        "log": {
            camera: {"channel": "CAM[0]", "image": f"{camera}/IMG_{{n:04d}}.tif"} for camera in "LR"
        },
        "images": {"path": "exif.csv"},
    }
    path = flight.mission(tmp_path, scattered(names), events)
    assert misplaced(read_mission(path), truth, names) == 0


def test_images_and_files_that_do_not_go_together(survey, tmp_path):
    flight, truth, names = survey
    time_s = flight.times(truth)
    events = {
        "log": {"cam": {"channel": "CAM[0]", "image": "*"}},
        "images": {"path": "exif.csv"},
    }
    exif_table(tmp_path / "exif.csv", [f"IMG_{n:04d}.NEF" for n in range(1, 200)], time_s[:199])
    path = flight.mission(tmp_path, scattered(names[100:]), events)
    prepared = read_mission(path)
    assert misplaced(prepared, truth.iloc[100:199].reset_index(), names[100:199]) == 0
    assert entries(prepared, "IMAGES-ABSENT")[0].count == 52
    assert entries(prepared, "IMAGES-UNMATCHED")[0].count == 52
    assert entries(prepared, "STATIONS-UNUSED")[0].count == 100
    exif_table(tmp_path / "exif.csv", [f"DSC_{n:04d}.NEF" for n in range(1, 200)], time_s[:199])
    with pytest.raises(InputError, match="IMAGES-OTHER"):
        read_mission(path)
    exif_table(tmp_path / "exif.csv", [f"{f}/{names[100]}" for f in "ab"], time_s[:2])
    with pytest.raises(InputError, match="IMAGES-DUPLICATE"):
        read_mission(path)


def test_a_pattern_of_no_image_is_refused(survey, tmp_path):
    flight, _, names = survey
    events = {"log": {"cam": {"channel": "CAM[0]", "image": "DSC_*"}}}
    path = flight.mission(tmp_path, scattered(names), events)
    with pytest.raises(MissionError, match="IMAGES-OTHER"):
        read_mission(path)


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
    assert (index.name.tolist(), index.number.tolist()) == (["7_00012.tif"], [12])


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
    [
        pytest.param({}, ["finding"], id="without a delay"),
        pytest.param({"delay_s": 0.08}, [], id="as measured"),
    ],
)
def test_commands_of_a_trigger_beside_its_pulses_need_a_delay(mission, delay, kinds):
    mission.config["events"]["log"]["nadir"].update({"channel": "TRIG[0]"} | delay)
    prepared = read_mission(mission.save())
    assert [entry.kind for entry in entries(prepared, "EVENTS-NOT-SHUTTER")] == kinds
