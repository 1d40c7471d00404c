"""Logs of ArduPilot 3.2 and before: milliseconds since boot, exposures with only a GPS time."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.ingest import written_logs
from tests.ingest.written_logs import DataFlashWriter, entry_in

DEFINITIONS = {
    "GPS": ("BIHBcLLeeECfI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"),
    "ATT": ("IccC", "TimeMS,Roll,Pitch,Yaw"),
    "CAM": ("IHLLeeccC", "GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,Roll,Pitch,Yaw"),
    "MSG": ("N", "Message"),
    "PARM": ("Nf", "Name,Value"),
}


def rows():
    """A parameter, then fixes at 5 Hz, attitudes 50 ms later, two images and a text.

    The first image has the time of the last fix, as autopilots write it; the second has no week.
    """
    lines = ["PARM, GPS_TYPE, 1.0"]
    for k in range(20):
        week_ms = 1000 + 200 * k
        boot_ms = 60_000 + 200 * k
        fix = f"GPS, 3, {week_ms}, 1820, 10, 1.2, 47.5, 11.5, 0, 600, 12, 90, 0.5, {boot_ms}"
        lines += [fix, f"ATT, {boot_ms + 50}, 1.0, 2.0, 90.0"]
        if k == 5:
            lines.append(f"CAM, {week_ms}, 1820, 47.5, 11.5, 600, 0, 0, 0, 0")
        if k == 9:
            lines.append(f"CAM, {week_ms}, 0, 47.5, 11.5, 600, 0, 0, 0, 0")
            lines.append("MSG, GPS Glitch")
    return lines


def binary():
    writer = DataFlashWriter()
    for kind, (name, definition) in enumerate(DEFINITIONS.items(), 20):
        writer.define(kind, name, *definition)
    for line in rows():
        name, *cells = line.split(", ")
        values = []
        for letter, cell in zip(DEFINITIONS[name][0], cells, strict=True):
            if letter == "N":
                values.append(cell.encode())
            else:
                values.append(float(cell))
        writer.row(name, *values)
    return writer.data


def text():
    """As Mission Planner writes it."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format"]
    for kind, (name, (letters, columns)) in enumerate(DEFINITIONS.items(), 20):
        lines.append(f"FMT, {kind}, 45, {name}, {letters}, {columns}")
    return "\n".join([*lines, *rows(), ""]).encode()


@pytest.fixture(
    scope="module",
    params=[("old.bin", binary()), ("old.log", text())],
    ids=["binary", "text"],
)
def log(request, tmp_path_factory):
    name, content = request.param
    return written_logs.opened(tmp_path_factory.mktemp("old") / name, content)


def after_first_fix_ms(log, name):
    first_ns = log.channel("GPS").time_ns[0]
    after_ns = log.channel(name).time_ns - first_ns
    return (after_ns / 1e6).tolist()


def test_the_times_of_old_messages(log):
    assert not log.ledger.has_losses
    assert after_first_fix_ms(log, "GPS") == [200.0 * k for k in range(20)]
    assert after_first_fix_ms(log, "ATT") == [50.0 + 200.0 * k for k in range(20)]
    table = log.message("ATT")
    assert "TimeUS" not in table
    assert_array_equal(
        table["time_ns"],
        log.channel("ATT").time_ns,
    )


def test_an_exposure_is_half_an_interval_behind_its_fix(log):
    """Without a fix it stays at the record before it."""
    assert after_first_fix_ms(log, "CAM") == [1100.0, 1850.0]
    sigma_s = 0.2 / np.sqrt(12.0)  # anywhere in the interval
    assert log.channel("CAM")["sigma_time_s"] == pytest.approx(sigma_s)
    entry = entry_in(log, "EVENTS-FIX-TIME")
    assert entry.kind == "fallback"
    assert entry.count == 2


def test_texts_velocities_and_parameters(log):
    assert log.channel("MSG").labels["text"] == ("GPS Glitch",)
    assert after_first_fix_ms(log, "MSG") == [1850.0]
    assert log.channel("GPS")["v_east_m_s"] == pytest.approx(12.0)
    assert log.parameters == {"GPS_TYPE": 1.0}
