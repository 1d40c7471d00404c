"""Two surveys that are written here: logs of both kinds, and where each exposure was.

The path, the sensors and the logs are the simulator's; when the cameras are exposed, and which
pulses are lost, is stated here.
"""

import struct
from dataclasses import replace

import numpy as np
import pandas as pd

from tests.stages.dataflash_records import records, value_of
from unbend.simulate import true_air
from unbend.simulate.flight import FIELD_LAT_RAD, fly
from unbend.simulate.sensors import boot_us, sample
from unbend.simulate.write_dataflash import write_dataflash
from unbend.simulate.write_tlog import write_tlog

SHUTTER_LAG_US = 85_000
CAMERA_FEEDBACK = 180
STAMP_BYTES = 8
"""A frame of a tlog has the ground station's time before it."""
PAYLOAD = STAMP_BYTES + 10
"""The first byte of a payload, after the head of its frame."""

LOST = (1, 5, 18, 27, 33, 47, 52, 53, 66, 80, 91, 104, 117, 126, 142)
"""Exposures of the left camera without a pulse: all but the last between those that have one."""


def write_surveys(folder):
    """`survey`: 256 exposures. `two_cameras`: 142, of which the right camera takes the first 128.

    The left camera of the second has lost fourteen pulses and the last one.
    """
    write_survey(folder / "survey", exposures=256, cameras=("cam",))
    lost = {(0, number) for number in LOST}
    write_survey(
        folder / "two_cameras",
        exposures=142,
        cameras=("left", "right"),
        lost=lost,
        not_taken={(1, number) for number in range(129, 143)},
    )


def write_survey(path, *, exposures, cameras, lost=frozenset(), not_taken=frozenset()):
    """A log with the ending BIN, one with tlog, and a table of the truth.

    Pulses that are ``lost`` have been triggered; of what was not taken no log says anything. Both
    are cameras and numbers of exposures.
    """
    flight = fly(3000.0, 5, 7)
    flight = replace(flight, exposure_s=irregular_times(flight, exposures))
    samples = sample(flight, true_air(FIELD_LAT_RAD), 3, cameras)
    pulses = lost | not_taken
    silent = {"CAM": pulses, "TRIG": not_taken, "CAMERA_FEEDBACK": pulses}

    dataflash = path.with_suffix(".BIN")
    write_dataflash(dataflash, samples)
    leave_out(dataflash, dataflash_records, silent)
    telemetry = path.with_suffix(".tlog")
    write_tlog(telemetry, samples, 3)
    leave_out(telemetry, telemetry_records, silent)
    table = truth_table(flight, cameras, pulses)
    table.to_csv(f"{path}_truth.csv", index=False)


def irregular_times(flight, exposures):
    """Exposures seconds apart, more or less, from the climb to the descent: no two gaps equal."""
    gaps = np.random.default_rng(12).uniform(3.0, 5.0, exposures + 1)
    first = 200.0
    last = flight.duration_s - 200.0
    elapsed = np.cumsum(gaps)[:-1] / gaps.sum()
    time_s = first + (last - first) * elapsed
    return np.round(time_s, 6)


def truth_table(flight, cameras, without):
    """A row for each trigger of the first camera and each pulse of all."""
    state = flight.at(flight.exposure_s)
    place = pd.DataFrame(
        {
            "Img": np.arange(1, len(state.time_s) + 1),
            "TimeUS": boot_us(state.time_s),
            "lat": np.degrees(state.lat_rad),
            "lng": np.degrees(state.lon_rad),
            "alt_amsl": state.h_msl_m,
            "roll": np.degrees(state.roll_rad),
            "pitch": np.degrees(state.pitch_rad),
            "yaw": np.degrees(state.yaw_rad),
        }
    )
    triggers = place.assign(row="TRIG", I=0)
    triggers["TimeUS"] -= SHUTTER_LAG_US
    rows = [triggers]
    for instance in range(len(cameras)):
        numbers = [number for camera, number in without if camera == instance]
        is_logged = ~place["Img"].isin(numbers)
        rows.append(place[is_logged].assign(row="CAM", I=instance))
    return pd.concat(rows, ignore_index=True)


def dataflash_records(log):
    """The bytes of each record, its message, and camera and number of the exposure it tells of."""
    for record in records(log):
        shot = (0, 0)
        if record.name in ("CAM", "TRIG"):
            fields = record.fields()
            camera = value_of(log, fields["I"])
            shot = (camera, value_of(log, fields["Img"]))
        yield record.content, record.name, shot


def telemetry_records(content):
    """The same of MAVLink 2.

    A frame has ten bytes of head, the last three of which are the message, and two of a sum.
    """
    start = 0
    while start < len(content):
        head = content[start + STAMP_BYTES : start + PAYLOAD]
        end = start + PAYLOAD + head[1] + 2
        record = content[start:end]
        number_of_message = int.from_bytes(head[7:], "little")
        message = ""
        shot = (0, 0)
        if number_of_message == CAMERA_FEEDBACK:
            payload = record[PAYLOAD:-2].ljust(47, b"\0")
            (number,) = struct.unpack_from("<H", payload, 40)
            message = "CAMERA_FEEDBACK"
            shot = (payload[43], number)
        yield record, message, shot
        start = end


def leave_out(path, records_of, silent):
    """The log again, without the messages of some exposures."""
    log = path.read_bytes()
    with path.open("wb") as file:
        for record, message, shot in records_of(log):
            if shot not in silent.get(message, ()):
                file.write(record)
