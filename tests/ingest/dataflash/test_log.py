"""DataFlash against pymavlink, against a writer with known content, and with damage."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.logs import LOGS, at_hand
from unbend.errors import LogError
from unbend.flight.clock import utc_of_gps
from unbend.flight.roles import assign_roles
from unbend.ingest import Log, open_log
from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.dataflash.dataflash_records import find_records
from unbend.messages import Ledger

DEGREE = np.pi / 180.0


def walk(data: bytes) -> SimpleNamespace:
    """The place and the definition of every record in a file, and its damage."""
    found = find_records(view_of_bytes(data))
    blocks = [(block.base + block.at.astype(np.int64), block.numbers) for block in found.wanted]
    offsets, numbers = map(np.concatenate, zip(*blocks, strict=True))
    damage = {name: getattr(found, name) for name in ("bad_bytes", "first_bad", "cut_bytes")}
    return SimpleNamespace(
        offsets=offsets, numbers=numbers, definitions=found.definitions, **damage
    )


def library_rows(path: Path, message: str) -> list:
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(path))
    rows = []
    while (row := reader.recv_match(type=message)) is not None:
        rows.append(row)
    reader.close()
    return rows


def entries(log: Log, code: str) -> list:
    return [entry for entry in log.ledger if entry.code == code]


@pytest.mark.parametrize(
    "name", at_hand("glitch_cleared.bin", "pymavlink_test.BIN", "beastayyg_sample.bin")
)
def test_columns_are_those_of_the_library_bit_for_bit(name: str) -> None:
    path = LOGS[name]
    log = open_log(path)
    named = {channel.source.message: channel.name for channel in log.channels}
    expected = {
        ("POS", "lat_rad"): ("Lat", DEGREE, 0.0),
        ("POS", "lon_rad"): ("Lng", DEGREE, 0.0),
        ("POS", "h_home_m"): ("RelHomeAlt", 1.0, 0.0),
        ("GPS", "h_msl_m"): ("Alt", 1.0, 0.0),
        ("GPS", "lon_rad"): ("Lng", DEGREE, 0.0),
        ("BARO", "pressure_pa"): ("Press", 1.0, 0.0),
        ("BARO", "board_temperature_k"): ("Temp", 1.0, 273.15),
    }
    for (message, column), (field, factor, offset) in expected.items():
        rows = library_rows(path, message)
        channel = log.channel(named[message])
        theirs = np.array([getattr(row, field) for row in rows]) * factor + offset
        np.testing.assert_array_equal(channel[column], theirs)
        times = np.array([row.TimeUS for row in rows], np.int64)
        np.testing.assert_array_equal(np.diff(channel.time_ns), np.diff(times) * 1000)
    attitude = library_rows(path, "ATT")
    angles = np.array([(row.Yaw, row.Pitch, row.Roll) for row in attitude])
    theirs = Rotation.from_euler("ZYX", angles, degrees=True)
    channel = log.channel("ATT")
    ours = Rotation.from_quat(np.stack([channel[f"q_{axis}"] for axis in "xyzw"], axis=1))
    assert (ours.inv() * theirs).magnitude().max() < 1e-12


@pytest.mark.parametrize("name", at_hand("glitch_cleared.bin", "beastayyg_sample.bin"))
def test_utc_agrees_with_the_gps_rows(name: str) -> None:
    path = LOGS[name]
    rows = library_rows(path, "GPS")
    told = utc_of_gps(
        np.array([row.GWk for row in rows]), np.array([row.GMS for row in rows]) / 1e3
    )
    fixes = next(c for c in open_log(path).channels if c.source.message == "GPS")
    late_s = (fixes.time_ns - told) / 1e9
    assert abs(np.median(late_s)) < 1e-6
    assert np.percentile(np.abs(late_s), 95) < 0.04  # LOGS.md: 20-39 ms from p5 to p95


def test_two_cameras_and_triggers_are_apart(real_log: Callable[[str], Path]) -> None:
    log = open_log(real_log("sitl_belowsea_2cam.BIN"))
    counts = {name: len(log.channel(name)) for name in ("CAM[0]", "CAM[1]", "TRIG[0]")}
    assert counts == {"CAM[0]": 127, "CAM[1]": 128, "TRIG[0]": 142}
    assert log.channel("POS")["h_msl_m"][0] == pytest.approx(-428, abs=2)


def test_barometers_by_instance_and_no_utc_without_gps(real_log: Callable[[str], Path]) -> None:
    log = open_log(real_log("ardusub_small.BIN"))
    hull = log.channel("BARO[0]")
    outside = log.channel("BARO[1]")
    assert np.median(hull["board_temperature_k"]) == pytest.approx(273.15 + 47, abs=1)
    assert np.median(outside["board_temperature_k"]) < 273.15 + 40
    assert "temperature_k" not in hull.columns
    assert len(entries(log, "TIME-NO-UTC")) == 1
    assert log.start_ns < 86_400 * 10**9


@pytest.fixture
def flight(dataflash_writer: Callable) -> Callable:
    """A small flight with two GPS, GPA with ellipsoidal heights, hygrometer, cabin and camera."""

    def write(rows: int = 40) -> bytes:
        writer = dataflash_writer()
        writer.define(20, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt")
        writer.define(21, "GPA", "QBCCCe", "TimeUS,I,VDop,HAcc,VAcc,AEl")
        writer.define(22, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
        writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
        writer.define(24, "HYGR", "QBff", "TimeUS,Id,Humidity,Temp")
        writer.define(25, "TEMP", "QBf", "TimeUS,Instance,Temp")
        writer.define(
            26,
            "CAM",
            "QIHLLeeeccC",
            "TimeUS,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,Roll,Pitch,Yaw",
        )
        for k in range(rows):
            t = 5_000_000 + k * 200_000
            status = 1 if k < 4 else 3
            for unit in (0, 1):
                writer.row(
                    "GPS",
                    t + unit,
                    unit,
                    status,
                    1000 + 200 * k,
                    1928,
                    12,
                    0.8,
                    47.0 + k * 1e-4,
                    -122.5,
                    600.25 + k,
                )
            # the second receiver does not know its ellipsoidal height: INT32_MIN
            writer.row("GPA", t, 0, 1.1, 0.5, 0.75, 580.5 + k)
            writer.row("GPA", t + 1, 1, 1.1, 0.25, 0.5, -(2**31) / 100)
            writer.row("ATT", t + 10, 1.5, -2.25, 350.0)
            writer.row("BARO", t + 20, 0, 94_000.0 - k, 35.0)
            writer.row("HYGR", t + 30, 3, 55.0, 12.5)
            writer.row("TEMP", t + 40, 1, 21.5)
            if k % 10 == 5:
                writer.row("CAM", t + 50, 1000, 1928, 47.0, -122.5, 610, 30, 611, 1, 2, 3)
        return writer.data

    return write


def opened(tmp_path: Path, data: bytes) -> Log:
    path = tmp_path / "flight.bin"
    path.write_bytes(data)
    return open_log(path)


def test_known_flight(tmp_path: Path, flight: Callable) -> None:
    log = opened(tmp_path, flight())
    first = log.channel("GPS[0]")
    second = log.channel("GPS[1]")
    assert (len(first), first.rank, second.rank) == (36, 20, 30)
    assert first.roles == ("height", "position")
    np.testing.assert_array_equal(first["h_ellipsoid_m"], 584.5 + np.arange(36))
    np.testing.assert_allclose(first["sigma_h_m"], np.full(36, 0.5 / np.sqrt(2.0)))
    assert "h_ellipsoid_m" not in second.columns
    np.testing.assert_array_equal(second["sigma_v_m"], np.full(36, 0.5))
    assert entries(log, "POSITION-NO-FIX")[0].count == 4
    # week 1928 is December 2016: 17 leap seconds; the first row with a fix is 1.8 s into it
    start = 1_482_019_200 - 17
    assert first.time_ns[0] == (start * 10**9) + 1_800_000_000
    assert log.channel("HYGR[3]")["relative_humidity"][0] == pytest.approx(0.55, abs=1e-15)
    assert log.channel("HYGR[3]")["temperature_k"][0] == 285.65
    # a probe may sit in the motor: it plays no role by itself, and any role when it is named
    probe = log.channel("TEMP[1]")
    assert (probe.roles, probe.fits_role("temperature")) == ((), True)
    shots = log.channel("CAM")
    np.testing.assert_array_equal(shots["event_index"], [0, 1, 2, 3])
    assert shots["yaw_rad"][0] == pytest.approx(3 * DEGREE, abs=1e-15)
    assert (log.boots, log.bad_bytes, log.lost_messages) == (1, 0, 0)
    assert not log.ledger.has_losses


@pytest.mark.parametrize("new_type", [0x00, 0x7F, 21, 22, 23, 26, 128])
def test_a_flipped_type_byte_costs_one_message(
    tmp_path: Path, flight: Callable, new_type: int
) -> None:
    data = flight()
    whole = walk(data)
    gps = next(n for n, form in enumerate(whole.definitions) if form.name == "GPS")
    victim = int(whole.offsets[whole.numbers == gps][30])
    damaged = bytearray(data)
    damaged[victim + 2] = new_type
    found = walk(bytes(damaged))
    kept = set(zip(found.offsets.tolist(), found.numbers.tolist(), strict=True))
    expected = set(zip(whole.offsets.tolist(), whole.numbers.tolist(), strict=True))
    assert {offset for offset, _ in expected - kept} == {victim}
    assert not kept - expected
    log = opened(tmp_path, bytes(damaged))
    loss = entries(log, "LOG-BAD-BYTES")[0]
    assert loss.count == log.bad_bytes == whole.definitions[gps].length
    assert f"byte {victim}" in loss.where
    assert log.ledger.has_losses


def test_every_bit_of_every_header_of_a_stretch(flight: Callable) -> None:
    data = flight(8)
    whole = walk(data)
    for victim in whole.offsets[-25:-1].tolist():
        for bit in range(24):
            damaged = bytearray(data)
            damaged[victim + bit // 8] ^= 1 << bit % 8
            lost = set(whole.offsets.tolist()) - set(walk(bytes(damaged)).offsets.tolist())
            assert lost <= {victim}, (victim, bit)


def test_a_hole_of_zeros_costs_what_it_covers(tmp_path: Path, flight: Callable) -> None:
    data = bytearray(flight())
    whole = walk(bytes(data))
    begin = int(whole.offsets[100]) + 20  # inside a record
    data[begin : begin + 512] = bytes(512)
    found = walk(bytes(data))
    covered = whole.offsets[(whole.offsets > begin - 20) & (whole.offsets < begin + 512)]
    lost = set(whole.offsets.tolist()) - set(found.offsets.tolist())
    assert lost == set(covered.tolist()) | {begin - 20}
    assert opened(tmp_path, bytes(data)).bad_bytes == found.bad_bytes >= 512


def test_a_cut_last_record_costs_no_other(tmp_path: Path, flight: Callable) -> None:
    data = flight()
    whole = walk(data)
    last = int(whole.offsets[-1])
    for end in range(last + 1, len(data)):
        found = walk(data[:end])
        assert (found.offsets.shape[0], found.bad_bytes) == (whole.offsets.shape[0] - 1, 0)
        assert found.cut_bytes == end - last
    log = opened(tmp_path, data[:-5])
    cut = entries(log, "LOG-TRUNCATED")[0]
    assert (cut.kind, "no end mark" in cut.what) == ("loss", True)
    assert log.bad_bytes == 0


def test_a_time_that_fits_nothing_is_dropped_and_no_boot(tmp_path: Path, flight: Callable) -> None:
    data = bytearray(flight())
    whole = walk(bytes(data))
    baro = next(n for n, form in enumerate(whole.definitions) if form.name == "BARO")
    data[int(whole.offsets[whole.numbers == baro][20]) + 3 + 5] ^= 1
    log = opened(tmp_path, bytes(data))
    assert (log.boots, len(log.channel("BARO[0]"))) == (1, 39)
    assert entries(log, "TIME-STRAY")[0].count == 1


@pytest.mark.parametrize("victims", [(0,), (5,), (5, 6, 7), (999,)])
def test_stamps_days_ahead_cost_their_own_rows(
    tmp_path: Path, dataflash_writer: Callable, victims: tuple[int, ...]
) -> None:
    writer = dataflash_writer()
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k in range(1000):
        ahead = 11 * 86_400_000_000 if k in victims else 0
        writer.row("BARO", 1_000_000 + k * 100_000 + ahead, 0, 95_000.0 - k, 20.0)
    log = opened(tmp_path, writer.data)
    assert log.boots == 1
    lost = 0 if victims == (999,) else len(victims)  # the last one may be late after a gap
    assert len(log.channel("BARO[0]")) == 1000 - lost
    assert sum(entry.count for entry in entries(log, "TIME-STRAY")) == lost
    assert log.ledger.has_losses == bool(lost)


def test_a_row_out_of_order_is_a_loss_with_its_place(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k in range(100):
        late = 250_000 if k == 40 else 0
        writer.row("BARO", 1_000_000 + k * 100_000 - late, 0, 95_000.0 - k, 20.0)
    log = opened(tmp_path, writer.data)
    assert len(log.channel("BARO[0]")) == 99
    loss = entries(log, "TIME-BACKWARD")[0]
    assert (loss.kind, loss.count) == ("loss", 1)
    assert loss.where.startswith("BARO[0], first at row 40, stamped 1970-01-01T00:00:04.75")


def test_instances_of_equal_standing_rank_alike(tmp_path: Path, dataflash_writer: Callable) -> None:
    writer = dataflash_writer()
    writer.define(24, "HYGR", "QBff", "TimeUS,Id,Humidity,Temp")
    writer.define(25, "TEMP", "QBf", "TimeUS,Instance,Temp")
    writer.define(26, "ARSP", "QBfc", "TimeUS,I,Airspeed,Temp")
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k in range(5):
        for unit in (0, 1):
            t = 1_000_000 + k * 100_000
            writer.row("HYGR", t, unit, 50.0, 10.0)
            writer.row("TEMP", t, unit, 80.0)
            writer.row("ARSP", t, unit, 50.0, 10.0)
            writer.row("BARO", t, unit, 95_000.0, 40.0)
    log = opened(tmp_path, writer.data)
    ranks = {channel.name: channel.rank for channel in log.channels}
    for kind in ("HYGR", "TEMP", "ARSP"):
        assert ranks[f"{kind}[0]"] == ranks[f"{kind}[1]"]
    assert ranks["BARO[0]"] < ranks["BARO[1]"]
    # what that means: no hygrometer is guessed to be the one outside, and no probe is air
    ledger = Ledger()
    roles = ledger.take(assign_roles(log.channels, {}, needs_cabin=True))
    assert not {"temperature", "humidity", "cabin_temperature"} & set(roles)
    told = " ".join(entry.what for entry in ledger if entry.code == "ROLE-AMBIGUOUS")
    assert "HYGR[0], HYGR[1]" in told
    assert "TEMP" not in told
    named = {"cabin_temperature": "TEMP[1]", "temperature": "HYGR[1]"}
    roles = assign_roles(log.channels, named, needs_cabin=True)[0]
    assert roles["cabin_temperature"].name == "TEMP[1]"
    assert roles["temperature"].name == "HYGR[1]"


def test_two_logs_in_one_file_are_two_boots(tmp_path: Path, flight: Callable) -> None:
    later = flight()
    log = opened(tmp_path, later + later)
    assert log.boots == 2
    # the same flight twice: the second has the same UTC and is not counted again
    assert {entry.kind for entry in entries(log, "TIME-REPEAT") if entry.where != "CAM"} == {"note"}
    assert len(log.channel("BARO[0]")) == 40
    np.testing.assert_array_equal(log.channel("BARO[0]").boot, np.zeros(40))


def test_a_definition_that_changes_in_the_file(
    tmp_path: Path, flight: Callable, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.data = flight(20)
    writer.define(23, "BARO", "QBffc", "TimeUS,I,Alt,Press,Temp")
    for k in range(5):
        writer.row("BARO", 30_000_000 + k * 100_000, 0, 12.0, 95_000.0 + k, 30.0)
    channel = opened(tmp_path, writer.data).channel("BARO[0]")
    assert len(channel) == 25
    np.testing.assert_array_equal(channel["pressure_pa"][-5:], 95_000.0 + np.arange(5))
    np.testing.assert_array_equal(channel["pressure_pa"][:5], 94_000.0 - np.arange(5))


def test_not_a_number_is_kept_as_a_row(tmp_path: Path, dataflash_writer: Callable) -> None:
    writer = dataflash_writer()
    writer.define(23, "BARO", "QBfc", "TimeUS,I,Press,Temp")
    for k, pressure in enumerate((1e5, float("nan"), float("inf"), 1e5)):
        writer.row("BARO", 1_000_000 + k, 0, pressure, 20.0)
    channel = opened(tmp_path, writer.data).channel("BARO[0]")
    np.testing.assert_array_equal(np.isnan(channel["pressure_pa"]), [False, True, True, False])


def test_a_definition_that_makes_no_sense_is_a_loss_where_there_are_records_of_it(
    tmp_path: Path, flight: Callable, dataflash_writer: Callable
) -> None:
    """Copter 3.4 defines BAR3 with more letters than names, and most vehicles log none of it."""
    writer = dataflash_writer()
    writer.data = flight()
    writer.define(60, "BAR3", "QffcfIf", "TimeUS,Alt,Press,Temp,CRt,SMS")
    log = opened(tmp_path, writer.data)
    assert entries(log, "LOG-BAD-FORMAT")[0].kind == "note"
    assert not log.ledger.has_losses
    writer.row("BAR3", 1_000_000, 0.0, 94_000.0, 20.0, 0.0, 0, 0.0)
    log = opened(tmp_path, writer.data + flight())
    assert entries(log, "LOG-BAD-FORMAT")[0].kind == "loss"


def test_an_accuracy_message_that_is_defined_and_never_sent(
    tmp_path: Path, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.define(20, "GPS", "QBIHLLe", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt")
    writer.define(21, "GPA", "QCCe", "TimeUS,HAcc,VAcc,AEl")
    writer.row("GPS", 1_000_000, 3, 1000, 2300, 47.0, -122.5, 600.25)
    channel = opened(tmp_path, writer.data).channel("GPS")
    assert {"h_msl_m", "lat_rad", "lon_rad"} < set(channel.columns)
    assert not {"sigma_h_m", "sigma_v_m", "h_ellipsoid_m"} & set(channel.columns)


def test_a_definition_without_a_needed_field_is_a_loss(
    tmp_path: Path, flight: Callable, dataflash_writer: Callable
) -> None:
    writer = dataflash_writer()
    writer.data = flight()
    writer.define(40, "AHR2", "Qcc", "TimeUS,Roll,Pitch")
    writer.row("AHR2", 20_000_000, 1.0, 2.0)
    log = opened(tmp_path, writer.data)
    loss = entries(log, "LOG-FIELDS")[0]
    assert (loss.kind, loss.where, loss.count) == ("loss", "AHR2", 1)
    assert "yaw_rad" in loss.what


def test_any_damage_opens_or_refuses(tmp_path: Path, flight: Callable) -> None:
    data = flight()
    whole = walk(flight())
    source = random.Random(11)
    for _ in range(60):
        damaged = bytearray(data)
        for _ in range(source.choice((1, 20, 200))):
            damaged[source.randrange(len(damaged))] ^= 1 << source.randrange(8)
        cut = source.randrange(len(damaged))
        del damaged[cut : cut + source.randrange(400)]
        try:
            log = opened(tmp_path, bytes(damaged))
        except LogError as error:
            outcome = error.code
        else:
            outcome = "opened"
            assert sum(log.messages.values()) <= whole.offsets.shape[0]
        assert outcome in {"opened", "LOG-FORMAT", "LOG-NO-MESSAGES"}


@pytest.mark.parametrize(("option", "ellipsoidal"), [(16.0, True), (64.0, False), (0.0, False)])
def test_heights_above_the_ellipsoid_by_parameter(
    option: float, ellipsoidal: bool, dataflash_writer: Callable, tmp_path: Path
) -> None:
    """ArduPilot, AP_GPS.h: bit 4 of GPS_DRV_OPTIONS makes GPS.Alt a height above the ellipsoid."""
    writer = dataflash_writer()
    writer.define(20, "GPS", "QBBIHBcLLe", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt")
    writer.define(21, "PARM", "QNf", "TimeUS,Name,Value")
    writer.row("PARM", 1_000, b"GPS_DELAY_MS", 16.0)
    writer.row("PARM", 1_000, b"GPS_DRV_OPTIONS", option)
    for k in range(20):
        writer.row(
            "GPS", 5_000_000 + k * 200_000, 0, 3, 1000 + 200 * k, 1928, 12, 0.8, 47.0, 8.0, 600.0
        )
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.data)
    log = open_log(path)
    known, unknown = ("h_ellipsoid_m", "h_msl_m")[:: 1 if ellipsoidal else -1]
    assert log.channel("GPS[0]")[known][0] == 600.0
    assert unknown not in log.channel("GPS[0]").columns
    assert bool(entries(log, "HEIGHT-ELLIPSOID")) is ellipsoidal


def test_the_table_of_an_instance_has_its_rows_only(tmp_path: Path, flight: Callable) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(flight())
    log = open_log(path)
    assert log.message("GPS")["I"].tolist() == [0, 1] * 40
    for instance in (0, 1):
        table = log.message("GPS", str(instance))
        assert table["I"].tolist() == [instance] * 40
        assert table["TimeUS"][0] == 5_000_000 + instance
    with pytest.raises(LogError, match="LOG-NO-TABLE"):
        log.message("GPS", "2")
