"""DataFlash: real logs, logs of a writer with known content, and damage."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import with_code
from tests.ingest.dataflash.walk import walk
from tests.ingest.written_logs import DataFlashWriter, entry_in
from tests.logs import LOGS, at_hand
from unbend.flight.clock import utc_of_gps
from unbend.ingest import open_log

DAY_US = 86_400 * 10**6
WEEK = 1928  # of December 2016
EARLY_MS = 1000  # of the week, at the first fix


@pytest.mark.parametrize("name", at_hand("glitch_cleared.bin", "beastayyg_sample.bin"))
def test_utc_agrees_with_the_gps_rows(name):
    log = open_log(LOGS[name])
    rows = log.message("GPS")
    epoch_ns = utc_of_gps(rows["GWk"], rows["GMS"] / 1e3)
    (fixes,) = [channel for channel in log.channels if channel.source.message == "GPS"]
    late_s = (fixes.time_ns - epoch_ns) / 1e9
    assert abs(np.median(late_s)) < 1e-6
    assert np.percentile(np.abs(late_s), 95) < 0.04  # LOGS.md: 20-39 ms from p5 to p95


def flight(rows=40):
    """Two receivers with ellipsoidal heights, attitude, a barometer and a camera."""
    writer = DataFlashWriter()
    writer.define(20, "GPS", "QBBIHLLe", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt")
    writer.define(21, "GPA", "QBCCe", "TimeUS,I,HAcc,VAcc,AEl")
    writer.define(22, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    writer.define(26, "CAM", "QIHLLe", "TimeUS,GPSTime,GPSWeek,Lat,Lng,Alt")
    for k in range(rows):
        time_us = 5_000_000 + k * 200_000
        status = 1 if k < 4 else 3
        place = (47.0 + k * 1e-4, -122.5, 600.25 + k)
        for unit in (0, 1):
            epoch = (EARLY_MS + 200 * k, WEEK)
            writer.row("GPS", time_us + unit, unit, status, *epoch, *place)
        # the second receiver does not know its ellipsoidal height: INT32_MIN
        writer.row("GPA", time_us, 0, 0.5, 0.75, 580.5 + k)
        writer.row(
            "GPA",
            time_us + 1,
            1,
            0.25,
            0.5,
            -(2**31) / 100,
        )
        writer.row("ATT", time_us + 10, 1.5, -2.25, 350.0)
        writer.row("BARO", time_us + 20, 0, 94_000.0 - k, 35.0)
        if k % 10 == 5:
            writer.row(
                "CAM",
                time_us + 50,
                EARLY_MS,
                WEEK,
                47.0,
                -122.5,
                610,
            )
    return writer


def barometer():
    writer = DataFlashWriter()
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    return writer


def test_known_flight(opened):
    log = opened(flight().data)
    first = log.channel("GPS[0]")
    second = log.channel("GPS[1]")
    assert len(first) == 36
    assert first.rank == 20
    assert second.rank == 30
    assert first.roles == ("height", "position")
    assert_array_equal(first["h_ellipsoid_m"], 584.5 + np.arange(36))
    assert "h_ellipsoid_m" not in second.columns
    assert second["sigma_v_m"].tolist() == [0.5] * 36
    assert with_code(log.ledger, "POSITION-NO-FIX")[0].count == 4
    # 17 leap seconds in December 2016; the first row with a fix is 1.8 s into the week
    assert first.time_ns[0] == (1_482_019_200 - 17) * 10**9 + 1_800_000_000
    assert log.channel("CAM")["event_index"].tolist() == [0, 1, 2, 3]
    assert log.boots == 1
    assert log.bad_bytes == 0
    assert log.lost_messages == 0
    assert not log.ledger.has_losses


@pytest.mark.parametrize(
    "new_type",
    [0x00, 0x7F, 21, 22, 23, 26, 128],
)
def test_a_flipped_type_byte_costs_one_message(opened, new_type):
    data = flight().data
    whole = walk(data)
    victim = whole.places_of("GPS")[30]
    damaged = bytearray(data)
    damaged[victim + 2] = new_type
    records = walk(bytes(damaged)).records
    assert whole.records - records == {(victim, "GPS")}
    assert not records - whole.records
    log = opened(bytes(damaged))
    loss = entry_in(log, "LOG-BAD-BYTES")
    assert loss.count == log.bad_bytes == whole.lengths["GPS"]
    assert f"byte {victim}" in loss.where
    assert log.ledger.has_losses


def test_every_bit_of_every_header_of_a_stretch():
    data = flight(8).data
    whole = walk(data)
    for victim in whole.places[-12:-1].tolist():
        for bit in range(24):
            damaged = bytearray(data)
            damaged[victim + bit // 8] ^= 1 << bit % 8
            lost = set(whole.places.tolist()) - set(walk(bytes(damaged)).places.tolist())
            assert lost <= {victim}, (victim, bit)


def test_a_hole_of_zeros_costs_what_it_covers(opened):
    data = bytearray(flight().data)
    whole = walk(bytes(data))
    record = int(whole.places[100])
    begin = record + 20
    end = begin + 512
    data[begin:end] = bytes(512)
    holed = walk(bytes(data))
    covered = whole.places[(whole.places >= record) & (whole.places < end)]
    assert set(whole.places.tolist()) - set(holed.places.tolist()) == set(covered.tolist())
    assert opened(bytes(data)).bad_bytes == holed.bad_bytes >= 512


def test_a_cut_last_record_costs_no_other(opened):
    data = flight().data
    whole = walk(data)
    last = int(whole.places[-1])
    for end in range(last + 1, len(data)):
        cut = walk(data[:end])
        assert cut.places.size == whole.places.size - 1
        assert cut.bad_bytes == 0
        assert cut.cut_bytes == end - last
    log = opened(data[:-5])
    loss = entry_in(log, "LOG-TRUNCATED")
    assert loss.kind == "loss"
    assert "no end mark" in loss.what
    assert log.bad_bytes == 0


@pytest.mark.parametrize(
    "victims",
    [(0,), (5,), (5, 6, 7), (999,)],
)
def test_stamps_days_ahead_cost_their_own_rows(opened, victims):
    writer = barometer()
    for k in range(1000):
        ahead_us = 11 * DAY_US if k in victims else 0
        writer.row(
            "BARO",
            1_000_000 + k * 100_000 + ahead_us,
            0,
            95_000.0 - k,
            20.0,
        )
    log = opened(writer.data)
    assert log.boots == 1
    lost = 0 if victims == (999,) else len(victims)  # the last one may be late after a gap
    assert len(log.channel("BARO[0]")) == 1000 - lost
    assert sum(entry.count for entry in with_code(log.ledger, "TIME-STRAY")) == lost
    assert log.ledger.has_losses == bool(lost)


def test_a_row_out_of_order_is_a_loss_with_its_place(opened):
    writer = barometer()
    for k in range(100):
        late_us = 250_000 if k == 40 else 0
        writer.row(
            "BARO",
            1_000_000 + k * 100_000 - late_us,
            0,
            95_000.0 - k,
            20.0,
        )
    log = opened(writer.data)
    assert len(log.channel("BARO[0]")) == 99
    loss = entry_in(log, "TIME-BACKWARD")
    assert loss.kind == "loss"
    assert loss.count == 1
    assert loss.where.startswith("BARO[0], first at row 40, stamped 1970-01-01T00:00:04.75")
    assert entry_in(log, "TIME-NO-UTC").kind == "fallback"


def test_two_logs_in_one_file_are_two_boots(opened):
    data = flight().data
    log = opened(data + data)
    assert log.boots == 2
    # the same flight twice: the second has the same UTC and is not counted again
    repeats = with_code(log.ledger, "TIME-REPEAT")
    assert {entry.kind for entry in repeats if entry.where != "CAM"} == {"note"}
    assert_array_equal(log.channel("BARO[0]").boot, np.zeros(40))


def test_not_a_number_is_kept_as_a_row(opened):
    writer = barometer()
    for k, pressure in enumerate((1e5, float("nan"), float("inf"), 1e5)):
        writer.row("BARO", 1_000_000 + k, 0, pressure, 20.0)
    channel = opened(writer.data).channel("BARO[0]")
    assert_array_equal(
        channel["pressure_pa"],
        [1e5, np.nan, np.nan, 1e5],
    )


def test_a_definition_that_makes_no_sense_is_a_loss_where_there_are_records_of_it(opened):
    """Copter 3.4 defines BAR3 with more letters than names, and most vehicles log none of it."""
    writer = flight()
    writer.define(60, "BAR3", "QffcfIf", "TimeUS,Alt,Press,Temp,CRt,SMS")
    log = opened(writer.data)
    assert entry_in(log, "LOG-BAD-FORMAT").kind == "note"
    assert not log.ledger.has_losses
    writer.row(
        "BAR3",
        1_000_000,
        0.0,
        94_000.0,
        20.0,
        0.0,
        0,
        0.0,
    )
    log = opened(writer.data + flight().data)
    assert entry_in(log, "LOG-BAD-FORMAT").kind == "loss"


def test_an_accuracy_message_that_is_defined_and_never_sent(opened):
    writer = DataFlashWriter()
    writer.define_receiver()
    writer.define(21, "GPA", "QCCe", "TimeUS,HAcc,VAcc,AEl")
    writer.fix(1_000_000, 1000, week=2300)
    channel = opened(writer.data).channel("GPS[0]")
    assert {"h_msl_m", "lat_rad", "lon_rad"} < set(channel.columns)
    assert not {"sigma_h_m", "sigma_v_m", "h_ellipsoid_m"} & set(channel.columns)


def test_a_definition_without_a_needed_field_is_a_loss(opened):
    writer = flight()
    writer.define(40, "AHR2", "Qcc", "TimeUS,Roll,Pitch")
    writer.row("AHR2", 20_000_000, 1.0, 2.0)
    loss = with_code(opened(writer.data).ledger, "LOG-FIELDS")[0]
    assert (loss.kind, loss.where, loss.count) == ("loss", "AHR2", 1)
    assert "yaw_rad" in loss.what
