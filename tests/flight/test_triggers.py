"""Commands of triggers and pulses of shutters, in logs of ArduPilot and PX4."""

from dataclasses import replace

import numpy as np
import pytest

from tests.flight.made_channels import counted, ranked
from tests.helpers import refused
from unbend.errors import MissionError
from unbend.flight.channels import Source
from unbend.flight.triggers import lag_from_feedback, shutter_finding, trigger_notes
from unbend.messages import Ledger

NUMBER = np.arange(1.0, 13.0)
LAG_S = 0.12
LOST = "EVENTS-LOST"
AT_TRIGGER = "EVENTS-TRIGGER-TIME"


def fired(name, lag_s=0.0, **columns):
    """Twelve numbered events, as long behind every third second."""
    return ranked(
        name,
        NUMBER * 3.0 + lag_s,
        50,
        "events",
        event_index=NUMBER,
        **columns,
    )


CAPTURE_AT_TRIGGER = fired("camera_capture")
CAPTURE_OF_ROS = replace(CAPTURE_AT_TRIGGER, source=Source("px4_msgs/CameraCapture"))
CAPTURE = fired("camera_capture", LAG_S)
COMMANDS = replace(fired("camera_trigger", feedback=0.0), name="camera_trigger.sent")
PULSES = fired("camera_trigger", LAG_S, feedback=1.0)
UNSAID = fired("camera_trigger")
CAM = fired("CAM[0]", LAG_S)
CAM_OF_ANOTHER = fired("CAM[1]", LAG_S)
TRIG = fired("TRIG[0]")


@pytest.mark.parametrize(
    ("channels", "parameters", "says"),
    [
        # The first channel is the chosen one. What the parameter says:
        ([CAPTURE_AT_TRIGGER, UNSAID], {"CAM_CAP_FBACK": 0.0}, "delay_s"),
        ([CAPTURE_OF_ROS], {"CAM_CAP_FBACK": 0.0}, "delay_s"),
        ([CAPTURE, UNSAID], {"CAM_CAP_FBACK": 1.0}, None),
        # the times of the commands contradict the parameter
        ([CAPTURE_AT_TRIGGER, COMMANDS], {"CAM_CAP_FBACK": 1.0}, "delay_s"),
        ([CAPTURE_AT_TRIGGER, COMMANDS], {}, "delay_s"),
        # and tell where nothing is stated; without either it is not known
        ([CAPTURE, COMMANDS], {}, None),
        ([CAPTURE], {}, "which is not logged"),
        # rows of camera_trigger say themselves what they are
        ([UNSAID], {}, "delay_s"),
        ([COMMANDS], {}, "delay_s"),
        ([PULSES, COMMANDS], {}, None),
        ([TRIG, CAM], {}, "delay_s"),
        ([CAM, TRIG], {}, None),
    ],
)
def test_events_at_the_trigger_are_told_from_those_at_the_feedback(channels, parameters, says):
    notes = tuple(trigger_notes(tuple(channels), channels[0], parameters))
    assert counted(notes) == [("note", AT_TRIGGER, 12)] * (says is not None)
    for note in notes:
        assert says in note.what


@pytest.mark.parametrize(
    ("rows", "messages"),
    [
        (
            {"CAM[0]": 3, "CAM[1]": 4, "TRIG[0]": 5},
            [(LOST, "CAM[0]", 2), (AT_TRIGGER, "CAM[1]", 4)],
        ),
        (
            {"CAM[0]": 4, "CAM[1]": 3, "TRIG[1]": 5},
            [(AT_TRIGGER, "CAM[0]", 4), (LOST, "CAM[1]", 2)],
        ),
        (
            {
                "CAM[0]": 5,
                "CAM[1]": 3,
                "TRIG[0]": 5,
                "TRIG[1]": 4,
            },
            [(LOST, "CAM[1]", 1)],
        ),
        (
            {"CAM[0]": 3, "CAM[1]": 4},
            [(AT_TRIGGER, "CAM[0]", 3), (AT_TRIGGER, "CAM[1]", 4)],
        ),
        ({"CAM": 3, "TRIG": 5}, [(LOST, "CAM", 2)]),
        ({"CAM": 3}, [(AT_TRIGGER, "CAM", 3)]),
        ({"CAM[0]": 3, "CAM[1]": 4, "TRIG": 7}, []),
        ({"CAM[0]": 3, "CAM[1]": 4, "TRIG": 8}, [(LOST, "CAM[0], CAM[1]", 1)]),
    ],
    ids=[
        "the first camera alone has a feedback pin",
        "the second",
        "both, and one lost nothing",
        "neither",
        "no instances",
        "no instances and no pin",
        "triggers of all cameras",
        "triggers of all cameras, counted once",
    ],
)
def test_triggers_of_another_camera_do_not_count(rows, messages):
    channels = tuple(fired(name).rows(count >= NUMBER) for name, count in rows.items())
    cameras = [logged for logged in channels if logged.source.message == "CAM"]
    ledger = Ledger()  # which has equal messages of two cameras once
    for camera in cameras:
        ledger.extend(trigger_notes(channels, camera, {}))
    assert [(entry.code, entry.where, entry.count) for entry in ledger] == messages


def test_commands_without_a_pulse_are_lost_exposures():
    fewer = PULSES.rows(NUMBER != 5.0)
    assert counted(trigger_notes((fewer, COMMANDS), fewer, {})) == [("loss", LOST, 1)]


@pytest.mark.parametrize(
    ("trigger", "camera"),
    [("TRIG[0]", "CAM[0]"), ("camera_trigger", "camera_trigger")],
)
def test_the_lag_of_the_shutter_is_the_median_of_pairs_and_its_sigma_their_scatter(trigger, camera):
    """Lags of 100, 102, ... 122 ms: their 16th and 84th percentiles are 103.52 and 118.48 ms.

    One trigger has no pulse, the pulse of one comes too late, and of one it is of another power-up.
    The pulses of another camera have another lag.
    """
    number = np.arange(1.0, 16.0)
    seconds = number * 5.0
    lags_s = 0.1 + 0.002 * np.arange(15)
    lags_s[12] = 1.1
    sent = ranked(
        trigger,
        seconds,
        50,
        event_index=number,
        feedback=0.0,
    )
    pulses = ranked(
        camera,
        seconds + lags_s,
        50,
        event_index=number,
        feedback=1.0,
    )
    boots = (number == 15.0).astype(np.int16)
    pulses = replace(pulses, boot=boots).rows(number != 14.0)
    of_another = ranked("CAM[1]", seconds + 0.4, 50, event_index=number)

    delay, (note,) = lag_from_feedback((of_another, pulses, sent), sent, "cam")

    assert delay.seconds == pytest.approx(0.111, abs=1e-8)
    assert delay.sigma_s == pytest.approx(0.00748, abs=1e-8)
    assert (note.code, note.count) == ("EVENTS-SHUTTER-LAG", 12)
    assert note.values["lag_ms"] == pytest.approx(111.0)
    assert note.values["scatter_ms"] == pytest.approx(7.48)


@pytest.mark.parametrize(
    ("channels", "chosen"),
    [
        ((PULSES, COMMANDS), PULSES),
        ((CAM, TRIG), CAM),
        ((CAM.rows(NUMBER <= 9.0), TRIG), TRIG),
    ],
    ids=["pulses of PX4", "pulses of ArduPilot", "nine pairs"],
)
def test_a_lag_takes_ten_pairs_and_triggers(channels, chosen):
    with refused("EVENTS-FEEDBACK", MissionError):
        lag_from_feedback(channels, chosen, "cam")


@pytest.mark.parametrize(
    ("channels", "lag_ms"),
    [
        # The first channel is the chosen one.
        ([COMMANDS, PULSES], 120.0),
        ([PULSES, COMMANDS], None),
        ([COMMANDS], None),
        ([COMMANDS, PULSES.rows(NUMBER < 0.0)], None),
        ([TRIG, CAM], 120.0),
        ([TRIG, CAM_OF_ANOTHER], None),
    ],
    ids=[
        "pulses are logged",
        "the pulses are chosen",
        "no pulses",
        "an empty channel",
        "ArduPilot",
        "the shutter of another camera",
    ],
)
def test_commands_are_not_taken_for_exposures_where_pulses_are_logged(channels, lag_ms):
    findings = list(shutter_finding(tuple(channels), channels[0], "cam"))
    is_told = lag_ms is not None
    assert counted(findings) == [("finding", "EVENTS-NOT-SHUTTER", 0)] * is_told
    for finding in findings:
        assert finding.values["lag_ms"] == pytest.approx(lag_ms)
