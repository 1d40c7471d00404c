"""What logs say of themselves in texts and parameters, and what of two logs of a flight agrees.

Tables, which are the truth of real logs here, are compared with the libraries in ``test_equal``.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.ingest.written_logs import DataFlashWriter, MavlinkWriter, opened
from tests.logs import LOGS, at_hand
from unbend.ingest import open_log

DATAFLASH_LOGS = at_hand(
    "flight.bin",
    "glitch_cleared.bin",
    "beastayyg_sample.bin",
    "ardusub_small.BIN",
    "pymavlink_test.BIN",
    "sitl_survey.BIN",
    "sitl_belowsea_2cam.BIN",
)
TELEMETRY_LOGS = at_hand(
    "flight.tlog",
    "pymavlink_swift_flight.tlog",
    "ardusub_small.tlog",
    "sitl_survey.tlog",
    "sitl_belowsea_2cam.tlog",
)


def texts_of(log, message):
    """The lines of all channels of texts of a message."""
    for channel in log.channels:
        if channel.source.message == message:
            for row in channel.labels["text"]:
                yield from row.split("\n")


@pytest.mark.parametrize("name", DATAFLASH_LOGS)
def test_texts_and_parameters_of_dataflash_are_what_is_logged(name):
    log = open_log(LOGS[name])
    if "MSG" in log.messages:
        logged = [text.strip() for text in log.message("MSG")["Message"].tolist()]
        assert [*texts_of(log, "MSG")] == logged
    if "EV" in log.messages:
        names = {"EKF_ALT_RESET": "60", "EKF_YAW_RESET": "62", "GPS_PRIMARY_CHANGED": "67"}
        names |= {"LAND_COMPLETE": "18", "NOT_LANDED": "28"}
        events = [line.split()[1] for line in texts_of(log, "EV")]
        ids = log.message("EV")["Id"].tolist()
        assert [names.get(event, event) for event in events] == [str(number) for number in ids]
    parameters = {}
    if "PARM" in log.messages:
        rows = log.message("PARM")
        parameters = dict(zip(rows["Name"].tolist(), rows["Value"].tolist(), strict=True))
    assert log.parameters == parameters
    assert len(parameters) > (800 if name not in ("flight.bin", "glitch_cleared.bin") else 0)


@pytest.mark.parametrize("name", TELEMETRY_LOGS)
def test_texts_and_parameters_of_telemetry_are_what_was_sent(name):
    log = open_log(LOGS[name])
    if "STATUSTEXT" in log.messages:
        sent = [text.strip() for text in log.message("STATUSTEXT")["text"].tolist()]
        lines = [*texts_of(log, "STATUSTEXT")]
        assert len(lines) <= len(sent)  # long ones are joined
        assert sorted("".join(lines)) == sorted("".join(sent))
    parameters = {}
    if "PARAM_VALUE" in log.messages:
        rows = log.message("PARAM_VALUE")
        is_autopilot = (rows["system"] == 1) & (rows["component"] == 1)
        names = rows["param_id"][is_autopilot].tolist()
        values = rows["param_value"][is_autopilot].tolist()
        parameters = dict(zip(names, values, strict=True))
    assert log.parameters == parameters


def test_texts_of_one_time_are_lines_of_one_row(tmp_path):
    writer = DataFlashWriter()
    writer.define_receiver()
    writer.define(21, "MSG", "QN", "TimeUS,Message")
    writer.define(22, "ERR", "QBB", "TimeUS,Subsys,ECode")
    writer.define(23, "EV", "QB", "TimeUS,Id")
    writer.define(24, "PARM", "QNf", "TimeUS,Name,Value")
    for name, value in ((b"GPS_DELAY_MS", 0.0), (b"GPS_TYPE", 1.0), (b"GPS_DELAY_MS", 120.0)):
        writer.row("PARM", 900_000, name, value)
    for k in range(5):
        writer.fix(
            1_000_000 + 200_000 * k,
            1000 + 200 * k,
            week=2300,
        )
    writer.row("MSG", 1_300_000, b"GPS Glitch")
    writer.row("MSG", 1_300_000, b"DCM active")
    writer.row("ERR", 1_300_000, 16, 2)
    writer.row("ERR", 1_400_000, 99, 0)
    writer.row("EV", 1_350_000, 62)
    writer.row("MSG", 1_400_000, b"EKF3 lane switch")
    log = opened(tmp_path / "texts.bin", writer.data)
    texts = log.channel("MSG")
    assert texts.labels["text"] == ("GPS Glitch\nDCM active", "EKF3 lane switch")
    assert np.diff(texts.time_ns).tolist() == [100_000_000]
    # the first fix was stamped 120 ms after its epoch, which is the time of its row
    assert texts.time_ns[0] - log.channel("GPS[0]").time_ns[0] == 420_000_000
    assert log.channel("ERR").labels["text"] == ("ERR EKFCHECK 2", "ERR 99 0")
    assert log.channel("EV").labels["text"] == ("EV EKF_YAW_RESET",)
    assert log.parameters == {"GPS_DELAY_MS": 120.0, "GPS_TYPE": 1.0}
    assert not log.ledger.has_losses
    assert {channel.name for channel in log.channels if not channel.is_evidence} == {"GPS[0]"}


def test_a_log_of_evidence_alone_is_refused(tmp_path):
    writer = DataFlashWriter()
    writer.define(21, "XKF4", "QBcc", "TimeUS,C,SV,SP")
    for k in range(5):
        writer.row("XKF4", 1_000_000 + 100_000 * k, 0, 0.25, 0.5)
    with refused("LOG-NO-MESSAGES", says="none with a position"):
        opened(tmp_path / "health.bin", writer.data)


def test_a_receiver_without_vertical_speed_has_none(tmp_path):
    writer = DataFlashWriter()
    writer.define(20, "GPS", "QBIHLLefff", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs,VZ")
    writer.define(21, "GPA", "QCCCB", "TimeUS,HAcc,VAcc,SAcc,VV")
    for k, has_vertical in enumerate((1, 0, 1)):
        time_us = 1_000_000 + 200_000 * k
        writer.row(
            "GPS",
            time_us,
            3,
            200 * k,
            2300,
            47.0,
            -122.5,
            600.25,
            10.0,
            0.0,
            0.5,
        )
        writer.row("GPA", time_us, 0.5, 0.75, 0.25, has_vertical)
    channel = opened(tmp_path / "receiver.bin", writer.data).channel("GPS")
    assert_array_equal(channel["v_down_m_s"], [0.5, np.nan, 0.5])
    assert channel["sigma_speed_m_s"].tolist() == [0.25] * 3
    assert channel["v_north_m_s"].tolist() == [10.0] * 3


def test_both_logs_of_a_flight_have_the_same_innovations(real_log):
    """XKF4 is scaled by 100 and a root, as the report is: else 14 would not be above 1."""
    logged = open_log(real_log("sitl_survey.BIN")).channel("XKF4[0]")
    sent = open_log(real_log("sitl_survey.tlog")).channel("EKF_STATUS_REPORT")
    inside = slice(10, -10)
    row = np.searchsorted(logged.time_ns, sent.time_ns[inside])
    for column in ("innovation_position", "innovation_height", "innovation_compass"):
        apart = np.abs(logged[column][row] - sent[column][inside])
        assert np.median(apart) < 0.01, column
    logged_flags = logged["filter_flags"][row].astype(int) & 0x3FF
    sent_flags = sent["filter_flags"][inside].astype(int) & 0x3FF
    assert np.mean(logged_flags == sent_flags) > 0.99


def test_long_texts_of_telemetry_are_joined(tmp_path):
    first = "EKF3 IMU0 stopped aiding because the receiver lost"
    assert len(first) == 50
    parts = (
        (first.encode(), 7, 0),
        (b"AHRS: DCM active", 0, 0),
        (b" its fix", 7, 1),
        (b", and the baro", 7, 2),
        (b"GPS Glitch", 0, 0),
        (b"tail of a text", 8, 1),
        (b"a" * 50, 9, 0),
        (b"c" * 9, 9, 2),
    )
    writer = MavlinkWriter()
    for k, (text, number, chunk) in enumerate(parts):
        at_us = 1_700_000_000_000_000 + k * 1_000_000
        writer.send("attitude", at_us, time_boot_ms=60_000 + 1000 * k)
        writer.send(
            "statustext",
            at_us,
            severity=2,
            text=text,
            id=number,
            chunk_seq=chunk,
        )
    texts = opened(tmp_path / "texts.tlog", writer.data).channel("STATUSTEXT").labels["text"]
    assert texts == (
        f"{first} its fix, and the baro",
        "AHRS: DCM active",
        "GPS Glitch",
        "...tail of a text",
        "a" * 50 + "..." + "c" * 9,
    )
