"""Commands of triggers and pulses of shutters in logs of PX4."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.errors import MissionError
from unbend.flight.channels import Channel, Source
from unbend.flight.triggers import lag_from_feedback, shutter_finding, trigger_notes

SECOND = 1_000_000_000
NUMBER = np.arange(1.0, 13.0)
LAG_S = 0.12


def events(name: str, message: str, lag_s: float, feedback: float | None = None) -> Channel:
    columns = {"event_index": NUMBER}
    if feedback is not None:
        columns["feedback"] = np.full(NUMBER.shape, feedback)
    time_ns = np.round((NUMBER * 3.0 + lag_s) * SECOND).astype(np.int64)
    return Channel(name, time_ns, columns, Source(message), roles=("events",))


CAPTURE_AT_TRIGGER = events("camera_capture", "camera_capture", 0.0)
CAPTURE = events("camera_capture", "camera_capture", LAG_S)
COMMANDS = events("camera_trigger.sent", "camera_trigger", 0.0, feedback=0.0)
PULSES = events("camera_trigger", "camera_trigger", LAG_S, feedback=1.0)
CAM = replace(events("CAM[0]", "CAM", LAG_S), source=Source("CAM", "0"))
CAM_OF_ANOTHER = replace(CAM, name="CAM[1]", source=Source("CAM", "1"))
TRIG = replace(events("TRIG[0]", "TRIG", 0.0), source=Source("TRIG", "0"))
UNSAID = events("camera_trigger", "camera_trigger", 0.0)


@pytest.mark.parametrize(
    ("channels", "chosen", "parameters", "says"),
    [
        # what the parameter says
        ([CAPTURE_AT_TRIGGER, UNSAID], CAPTURE_AT_TRIGGER, {"CAM_CAP_FBACK": 0.0}, "delay_s"),
        ([CAPTURE, UNSAID], CAPTURE, {"CAM_CAP_FBACK": 1.0}, None),
        # the times of the commands contradict the parameter
        ([CAPTURE_AT_TRIGGER, COMMANDS], CAPTURE_AT_TRIGGER, {"CAM_CAP_FBACK": 1.0}, "delay_s"),
        ([CAPTURE_AT_TRIGGER, COMMANDS], CAPTURE_AT_TRIGGER, {}, "delay_s"),
        # and tell where nothing is stated; without either it is not known
        ([CAPTURE, COMMANDS], CAPTURE, {}, None),
        ([CAPTURE], CAPTURE, {}, "which is not logged"),
        # rows of camera_trigger say themselves what they are
        ([UNSAID], UNSAID, {}, "delay_s"),
        ([COMMANDS], COMMANDS, {}, "delay_s"),
        ([PULSES, COMMANDS], PULSES, {}, None),
    ],
)
def test_captures_at_the_trigger_are_told_from_those_at_the_feedback(
    channels: list[Channel], chosen: Channel, parameters: dict[str, float], says: str | None
) -> None:
    notes = list(trigger_notes(tuple(channels), chosen, parameters))
    assert [note.code for note in notes] == ["EVENTS-TRIGGER-TIME"] * (says is not None)
    assert all(str(says) in note.what for note in notes)


def test_topics_over_ros_are_those_of_the_log() -> None:
    capture = replace(CAPTURE_AT_TRIGGER, source=Source("px4_msgs/CameraCapture"))
    (entry,) = trigger_notes((capture,), capture, {"CAM_CAP_FBACK": 0.0})
    assert entry.code == "EVENTS-TRIGGER-TIME"


def test_the_lag_is_that_of_pulses_behind_commands() -> None:
    delay, _ = lag_from_feedback((PULSES, COMMANDS), COMMANDS, "cam")
    assert delay.seconds == pytest.approx(LAG_S, abs=1e-6)
    with pytest.raises(MissionError, match="EVENTS-FEEDBACK"):
        lag_from_feedback((PULSES, COMMANDS), PULSES, "cam")


def test_commands_without_a_pulse_are_lost_exposures() -> None:
    fewer = PULSES.rows(NUMBER != 5.0)
    (entry,) = trigger_notes((fewer, COMMANDS), fewer, {})
    assert (entry.code, entry.kind, entry.count) == ("EVENTS-LOST", "loss", 1)


@pytest.mark.parametrize(
    ("channels", "chosen", "lag_ms"),
    [
        pytest.param([PULSES, COMMANDS], COMMANDS, 120.0, id="pulses are logged"),
        pytest.param([PULSES, COMMANDS], PULSES, None, id="the pulses are chosen"),
        pytest.param([COMMANDS], COMMANDS, None, id="no pulses"),
        pytest.param([PULSES.rows(NUMBER < 0.0), COMMANDS], COMMANDS, None, id="an empty channel"),
        pytest.param([CAM, TRIG], TRIG, 120.0, id="ArduPilot"),
        pytest.param([CAM_OF_ANOTHER, TRIG], TRIG, None, id="the shutter of another camera"),
    ],
)
def test_commands_are_not_taken_for_exposures_where_pulses_are_logged(
    channels: list[Channel], chosen: Channel, lag_ms: float | None
) -> None:
    found = list(shutter_finding(tuple(channels), chosen, "cam"))
    expected = [] if lag_ms is None else [("EVENTS-NOT-SHUTTER", "finding")]
    assert [(entry.code, entry.kind) for entry in found] == expected
    assert [entry.values["lag_ms"] for entry in found] == pytest.approx([lag_ms] * len(expected))


def test_the_scatter_of_the_lag_is_half_of_the_middle_two_thirds() -> None:
    """Lags of 100, 102, ... 122 ms: their 16th and 84th percentiles are 103.52 and 118.48 ms."""
    lags_s = 0.1 + 0.002 * (NUMBER - 1.0)
    time_ns = np.round((NUMBER * 3.0 + lags_s) * SECOND).astype(np.int64)
    delay, (message,) = lag_from_feedback(
        (replace(PULSES, time_ns=time_ns), COMMANDS), COMMANDS, "c"
    )
    assert delay.seconds == pytest.approx(0.111, abs=1e-8)
    assert delay.sigma_s == pytest.approx(0.00748, abs=1e-8)
    assert message.values["lag_ms"] == pytest.approx(111.0)
    assert message.values["scatter_ms"] == pytest.approx(7.48)
