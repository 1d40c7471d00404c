"""The stations of a mission: when its images were exposed, by the log and by a table."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from pipeline.stages.story import check_mission


def times_ns(mission) -> dict[str, int]:
    stations = check_mission(mission.save()).stations
    return dict(zip(stations.image.tolist(), stations.time_ns.tolist(), strict=True))


@pytest.mark.parametrize("delay_s", [0.25, -0.125])
def test_a_delay_of_log_events_is_the_shutter_after_the_event(mission, delay_s):
    before = times_ns(mission)
    for camera in mission.config["events"]["log"].values():
        camera["delay_s"] = delay_s
    after = times_ns(mission)
    assert after == {image: time + round(delay_s * 1e9) for image, time in before.items()}


@pytest.mark.parametrize("delay_s", [0.25, -0.125])
def test_a_delay_of_a_table_is_true_time_minus_the_tables(mission, delay_s):
    """A camera whose clock is a quarter of a second slow writes times that much too early."""
    prepared = check_mission(mission.save())
    stations = prepared.stations
    with (mission.folder / "events.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["image", "camera", "time_utc"])
        for image, camera, time in zip(
            stations.image, stations.camera, stations.time_ns.tolist(), strict=True
        ):
            written = np.datetime64(time - round(delay_s * 1e9), "ns")
            rows.writerow([image, camera, f"{written}Z"])
    columns = {"image": "image", "camera": "camera", "time_utc": "time_utc"}
    mission.config["events"] = {
        "csv": {"path": "events.csv", "columns": columns, "delay_s": delay_s}
    }
    assert times_ns(mission) == dict(
        zip(stations.image.tolist(), stations.time_ns.tolist(), strict=True)
    )
