"""The stations of a mission: when its images were exposed, by the log and by a table."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose

from tests.helpers import channel, with_code
from tests.stages.block_files import matrices
from tests.stages.other_logs import (
    channel_of,
    message_of,
    opened,
    read_folder,
    refusal_to_read,
    with_channels,
)
from unbend import load_mission
from unbend.messages import Ledger
from unbend.stages.story import prepare_mission


def times_ns(mission):
    """Times of the stations by their images."""
    stations = read_folder(mission).stations
    return pd.Series(stations.time_ns, index=stations.image).sort_index()


@pytest.mark.parametrize("delay_s", [0.25, -0.125])
def test_a_delay_of_log_events_is_the_shutter_after_the_event(mission, delay_s):
    before = times_ns(mission)
    for camera in mission.config["events"]["log"].values():
        camera["delay_s"] = delay_s
    assert times_ns(mission).equals(before + round(delay_s * 1e9))


def test_a_gimbal_whose_yaw_counts_from_the_nose(mission):
    """A payload that points straight down: the top of its image is where the nose points."""
    inputs = opened(mission)
    aircraft = channel_of(inputs, "ATT")
    gimbal = channel(
        "MOUNT_ORIENTATION",
        aircraft.time_ns / 1e9,
        gimbal_roll_rad=0.0,
        gimbal_pitch_rad=-np.pi / 2.0,
        gimbal_yaw_rad=0.0,
    )
    gimbal = replace(gimbal, time_ns=aircraft.time_ns)
    config = mission.config
    config["log"]["channels"]["attitude"] = "MOUNT_ORIENTATION"
    config["log"]["channels"]["aircraft_attitude"] = "ATT"
    config["mount"] = {"nadir": {"pitch_deg": 90.0}, "oblique": {"pitch_deg": 90.0}}
    ledger = Ledger()
    inputs = with_channels(inputs, gimbal)

    stations = prepare_mission(load_mission(mission.save()), inputs, ledger).stations

    assert with_code(ledger, "GIMBAL-YAW")
    # Observations of other cameras: tie points say so, and the stations are used all the same.
    assert stations.ok.all()
    axes = matrices(stations.quaternion)
    down = axes[:, 1]
    forward = axes[:, 2]
    assert_allclose(forward, [[0.0, 0.0, -1.0]] * len(stations), atol=1e-6)
    nose = matrices(stations.aircraft_quaternion)[:, 0, :2]
    nose /= np.linalg.norm(nose, axis=1, keepdims=True)
    assert_allclose(-down[:, :2], nose, atol=1e-3)


def test_a_limit_that_stations_exceed_is_a_loss(mission):
    mission.config["stations"] = {
        "max_sigma_horizontal_m": 100.0,
        "max_sigma_tilt_deg": 0.01,
    }
    ledger = read_folder(mission).ledger
    assert ledger.has_losses
    texts = [message.what for message in with_code(ledger, "STATIONS-SIGMA")]
    assert any("attitude (about a level axis)" in text for text in texts)


def test_a_table_joined_with_itself_is_a_loss(mission):
    table = mission.measurements()
    mission.observe(pa.concat_tables([table, table]))
    loss = message_of(read_folder(mission), "OBS-REPEATED-POINT")
    assert loss.kind == "loss"
    assert f"{table.num_rows} points occur twice in an image" in loss.what


def test_a_lag_from_feedback_needs_triggers(mission):
    for camera in mission.config["events"]["log"].values():
        camera["delay_s"] = "from_feedback"
    refusal_to_read(mission, "EVENTS-FEEDBACK")
