"""Damaged PX4 logs: complete, salvaged with a ledger, or refused with a code."""

import pytest

from tests.faults.mutate import KINDS, REFUSALS, Trial, damage_reported, limited, work_unit_s
from tests.ingest.written_logs import ULogWriter
from unbend.ingest import open_log

UTC_US = 1_700_000_000_000_000
REFUSALS_OF_ULOG = REFUSALS | {"LOG-ULOG"}
SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])

FORMATS = {
    "sensor_gps": (
        "Q2dd4fB",
        "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
        "double altitude_msl_m;float eph;float epv;float hdop;float vdop;"
        "uint8_t fix_type;",
    ),
    "vehicle_attitude": ("4f", "float[4] q;"),
    "sensor_baro": ("2f", "float pressure;float temperature;"),
    "camera_capture": (
        "QI2db",
        "uint64_t timestamp_utc;uint32_t seq;double lat;double lon;int8_t result;",
    ),
}


def small_log(rows, *, sync):
    """A receiver, an attitude, a barometer and a camera, as the specification of ULog says."""
    writer = ULogWriter()
    for name, (_, fields) in FORMATS.items():
        writer.define(name, fields)
    writer.subscribe(*FORMATS)
    for k in range(rows):
        t = 60_000_000 + 100_000 * k
        values = {
            "sensor_gps": (UTC_US + t, 47.5, 8.25, 600.0, 0.5, 0.75, 1.0, 1.0, 3),
            "vehicle_attitude": (1.0, 0.0, 0.0, 0.0),
            "sensor_baro": (94_000.0 - k, 40.0),
        }
        if k % 10 == 0:
            values["camera_capture"] = (0, k, 47.5, 8.25, 1)
        for name, row in values.items():
            layout, _ = FORMATS[name]
            writer.row(name, layout, t, *row)
        if sync and k % 20 == 0:
            writer.message("S", SYNC)
    return writer.data


@pytest.fixture(scope="module")
def trial(tmp_path_factory) -> Trial:
    logs = [small_log(150, sync=True), small_log(150, sync=False)]
    return Trial(logs, ".ulg", open_log, tmp_path_factory.mktemp("ulog"))


def test_the_small_logs_are_whole(trial):
    for log in trial.whole:
        assert not damage_reported(log)
        assert sum(log.messages.values()) == 3 * 150 + 15


def test_mutations(trial, run_mutations, mutation_count):
    run_mutations(trial)

    assert set(trial.ends) <= {"complete", "reported", "renamed", "unreported"} | REFUSALS_OF_ULOG
    # whole messages that are gone leave no mark in a format without numbers
    kinds = {KINDS[recipe.kind] for recipe in trial.unreported}
    assert kinds <= {"truncate", "delete"}
    assert len(trial.unreported) <= mutation_count // 100, trial.summary()


def test_failures_found_once_stay_away(trial, run_corpus):
    run_corpus(trial, "ulog", {"complete", "reported"} | REFUSALS_OF_ULOG)


def test_every_cut_of_the_first_and_last_1000_bytes(trial, run_cuts):
    ends = run_cuts(trial)

    assert set(ends) <= {"LOG-FORMAT", "LOG-ULOG", "reported", "unreported"}
    assert ends["unreported"] <= 0.015 * ends.total() + 4  # cuts between two messages


def test_a_large_hole_ends_at_once(trial):
    """30 MB of zeros, as in a file whose space was set aside before the power went."""
    log = trial.logs[0]
    data = log[:8000] + bytes(30_000_000) + log[8000:]
    with limited(30.0 * work_unit_s()):
        assert trial.examine(0, data, "hole") == "reported"
    assert not trial.failures
