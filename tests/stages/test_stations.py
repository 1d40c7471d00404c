"""The stations of a mission: when its images were exposed, by the log and by a table."""

from __future__ import annotations

import csv
import json

import numpy as np
import pyarrow as pa
import pytest
from pymavlink.dialects.v20 import all as dialect

from unbend.batch.runs import read_mission


def times_ns(mission) -> dict[str, int]:
    stations = read_mission(mission.save()).stations
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
    prepared = read_mission(mission.save())
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


def test_a_gimbal_whose_yaw_counts_from_the_nose(mission_factory, tmp_path):
    """MOUNT_ORIENTATION without the yaw from north, of a payload that points straight down."""
    mission = mission_factory(tmp_path / "mission", "tlog")
    data = mission.log.read_bytes()
    made = bytearray()
    at = 0
    sender = dialect.MAVLink(None, 1, dialect.MAV_COMP_ID_GIMBAL)
    while at < len(data):
        end = at + 8 + 12 + data[at + 9]  # the time, then a frame of MAVLink 2 without signature
        made += data[at:end]
        if data[at + 15] == dialect.MAVLINK_MSG_ID_ATTITUDE:
            boot_ms = int.from_bytes(data[at + 18 : at + 22], "little")
            pointing = dialect.MAVLink_mount_orientation_message(boot_ms, 0.0, -90.0, 0.0)
            made += data[at : at + 8] + pointing.pack(sender)
            sender.seq = (sender.seq + 1) % 256
        at = end
    mission.log.write_bytes(bytes(made))
    mission.config["log"]["channels"] |= {
        "attitude": "MOUNT_ORIENTATION",
        "aircraft_attitude": "ATTITUDE",
    }
    mission.config["mount"] = {name: {"pitch_deg": 90.0} for name in mission.config["cameras"]}
    ended = mission.run()
    # What was observed was not seen by cameras that point straight down, and tie points say so.
    assert ended.code == 3, ended.text
    manifest = json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))
    codes = {entry["code"] for entry in manifest["ledger"]}
    assert "GIMBAL-YAW" in codes
    assert "TIES-HELD-BACK" in codes
    table = mission.stations().to_pandas().query("status == 'ok'")
    assert len(table) >= 4
    w, x, y, z = (table[f"q_{axis}"].to_numpy() for axis in "wxyz")
    down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    assert down == pytest.approx(np.tile([0.0, 0.0, -1.0], (len(table), 1)), abs=1e-6)
    # The picture's top (-y of the camera) is where the aircraft's nose points.
    top = -np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    w, x, y, z = (table[f"aircraft_q_{axis}"].to_numpy() for axis in "wxyz")
    nose = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z)], axis=1)
    nose /= np.linalg.norm(nose, axis=1)[:, None]
    assert top[:, :2] == pytest.approx(nose, abs=1e-3)


def test_a_limit_that_stations_exceed_ends_with_3(mission):
    mission.config["stations"] = {"max_sigma_horizontal_m": 100.0, "max_sigma_tilt_deg": 0.01}
    ended = mission.run("--force")
    assert ended.code == 3, ended.text
    assert "STATIONS-SIGMA" in ended.text
    assert "attitude (about a level axis)" in ended.text


def test_a_table_joined_with_itself_ends_with_3(mission):
    table = mission.measurements()
    mission.observe(pa.concat_tables([table, table]))
    ended = mission.run("--force")
    assert ended.code == 3, ended.text
    assert f"{table.num_rows} points occur twice in an image" in " ".join(ended.text.split())


def test_a_lag_from_feedback_needs_triggers(mission):
    for camera in mission.config["events"]["log"].values():
        camera["delay_s"] = "from_feedback"
    ended = mission.run("--force")
    assert ended.code == 6, ended.text
    assert "EVENTS-FEEDBACK" in ended.text
