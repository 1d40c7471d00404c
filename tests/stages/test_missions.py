"""Missions told in other ways: other heights, pixels, tables, units; the same answer."""

from __future__ import annotations

import datetime as dt
import json
import re
import struct

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from pymavlink import DFReader

from unbend.tables.geodata.geoid import package_geoid

pytestmark = pytest.mark.usefixtures("plain_report")

UNDULATION_M = 47.6
LEAP_SECONDS = 18


def corrected(mission) -> np.ndarray:
    table = mission.results()
    return np.stack(
        [table[c].to_numpy(zero_copy_only=False) for c in ("x_corrected_px", "y_corrected_px")],
        axis=1,
    )


def ran(mission, exit_code: int = 0) -> dict:
    ended = mission.run()
    assert ended.code == exit_code, ended.text
    assert "Traceback" not in ended.text
    return json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))


def codes(manifest: dict, kind: str) -> set[str]:
    return {e["code"] for e in manifest["ledger"] if e["kind"] == kind}


def entry_of(manifest: dict, code: str) -> dict:
    return next(entry for entry in manifest["ledger"] if entry["code"] == code)


def refused_code(mission, code: str) -> str:
    ended = mission.run()
    assert (ended.code, code in ended.err) == (6, True), ended.text
    return ended.err


def shifted_ground(mission, by: float) -> None:
    table = mission.measurements()
    h = table["h_g_m"].to_numpy() + by
    mission.observe(table.set_column(4, "h_g_m", pa.array(h)))


def test_ground_above_the_ellipsoid(mission, baseline):
    shifted_ground(mission, UNDULATION_M)
    mission.config["ground"]["reference"] = "ellipsoid"
    ran(mission)
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-6)
    np.testing.assert_allclose(
        mission.results()["h_g_m"].to_numpy(), baseline.results()["h_g_m"].to_numpy(), atol=1e-6
    )


def test_ground_above_the_ellipsoid_when_the_log_knows_the_undulation(mission, baseline):
    shifted_ground(mission, UNDULATION_M)
    mission.config["ground"]["reference"] = "ellipsoid"
    del mission.config["mission"]["undulation_m"]
    manifest = ran(mission)
    assert "HEIGHT-UNDULATION" in codes(manifest, "note")
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-3)


def test_the_geoid_gives_the_undulation_that_the_log_lacks(mission_factory, tmp_path):
    """NavSatFix has heights above the ellipsoid alone; EGM96 has 47.2 m there, at each place."""
    mission = mission_factory(tmp_path, "mcap")
    stated = ran(mission)
    assert "by mission.undulation_m" in entry_of(stated, "HEIGHT-UNDULATION")["what"]
    sea_level = mission.stations()["h_msl_m"].to_numpy()
    del mission.config["mission"]["undulation_m"]
    manifest = ran(mission)
    stations = mission.stations()
    place = (np.radians(stations[f"{axis}_deg"].to_numpy()) for axis in ("lat", "lon"))
    undulation = package_geoid().undulation(*place)
    assert np.ptp(undulation) > 0.02
    found = stations["h_msl_m"].to_numpy() - sea_level
    np.testing.assert_allclose(found, UNDULATION_M - undulation, atol=1e-3)
    assert "EGM96" in entry_of(manifest, "HEIGHT-UNDULATION")["what"]


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_an_undulation_of_the_wrong_sign_is_a_finding(mission_factory, tmp_path, kind):
    mission = mission_factory(tmp_path, kind)
    mission.config["mission"]["undulation_m"] = -UNDULATION_M
    entries = [e for e in ran(mission, 3)["ledger"] if e["code"] == "HEIGHT-GEOID"]
    assert {entry["kind"] for entry in entries} == {"finding"}
    assert any("-94.8 m from EGM96" in e["what"] and "other sign" in e["what"] for e in entries)
    # What is found may be accepted, with its reason; it stays in the ledger.
    codes = {e["code"] for e in ran(mission, 3)["ledger"] if e["kind"] in ("finding", "loss")}
    assert codes <= {"HEIGHT-GEOID", "TIES-HEIGHT"}
    mission.config["accept"] = [{"code": code, "reason": "as flown"} for code in sorted(codes)]
    accepted = [e for e in ran(mission, 0)["ledger"] if e["code"] in codes]
    assert all(e["kind"] == "warning" and "as flown" in e["what"] for e in accepted)
    del mission.config["accept"]
    mission.config["mission"]["undulation_m"] = UNDULATION_M - 5.0
    assert {e["kind"] for e in ran(mission, 0)["ledger"] if e["code"] == "HEIGHT-GEOID"} == {
        "warning"
    }


def test_a_grid_of_the_mission_file_and_its_mistakes(mission_factory, tmp_path):
    mission = mission_factory(tmp_path, "mcap")
    del mission.config["mission"]["undulation_m"]
    mission.config["mission"]["geoid"] = "national.gtx"
    assert "mission.geoid" in refused_code(mission, "INPUT-MISSING")

    def grid(south, value):
        head = struct.pack(">4d2i", south, 8.0, 0.5, 0.5, 3, 3)
        (mission.folder / "national.gtx").write_bytes(head + np.full(9, value, ">f4").tobytes())

    grid(47.0, 47.5)
    what = entry_of(ran(mission), "HEIGHT-UNDULATION")["what"]
    assert what == "undulation of 47.50 m, by national.gtx"
    grid(47.0, -47.5)
    assert "other sign" in entry_of(ran(mission, 3), "HEIGHT-GEOID")["what"]
    grid(49.0, 47.5)
    manifest = ran(mission, 3)
    assert "6 of 6 stations are outside national.gtx" in entry_of(manifest, "GEOID-OUTSIDE")["what"]
    assert manifest["stations"] == {"height_reference_unknown": 6}
    both = mission_factory(tmp_path / "both", "bin")  # a log with both heights
    both.config["mission"] = {"name": "both", "geoid": str(mission.folder / "national.gtx")}
    assert "are outside national.gtx" in entry_of(ran(both, 3), "GEOID-OUTSIDE")["what"]
    (mission.folder / "national.gtx").write_bytes(b"not a grid")
    refused_code(mission, "GEOID-GRID")


def test_heights_above_an_unknown_take_off_point(mission_factory, tmp_path):
    mission = mission_factory(tmp_path, "mcap")
    mission.config["ground"]["reference"] = "relative"
    ended = mission.run()
    assert ended.code == 6
    assert "HEIGHT-REFERENCE" in ended.err
    proposed = re.search(r"write ground\.home_h_msl_m: ([\d.]+)", ended.err)
    # The simulated field lies at 450 m; the geoid of the package is not quite the simulator's.
    assert float(proposed[1]) == pytest.approx(450.0, abs=3.0)


def test_inspect_init_and_check_give_one_take_off(mission_factory, tmp_path, unbend):
    """With the home of an autopilot, and with none: the height where the log begins."""
    for kind in ("bin", "tlog"):
        mission = mission_factory(tmp_path / kind, kind)
        flight = json.loads(unbend("inspect", mission.log, "--json").out)["flight"]
        assert flight["take_off_reference"] == "sea level"
        metres = f"{flight['take_off_m']:.0f} m"
        assert metres == "450 m"
        assert f"take-off {metres} above sea level" in " ".join(
            unbend("inspect", mission.log).out.split()
        )
        proposed = unbend(
            "init", mission.log, mission.folder / "observations.parquet", "--out", "-"
        ).out
        assert f"take-off {metres} above the sea" in proposed
        assert f"take-off {metres}," in " ".join(unbend("check", mission.save()).out.split())


def test_ground_above_the_take_off_point(mission, baseline):
    shifted_ground(mission, -600.0)
    mission.config["ground"] |= {"reference": "relative", "home_h_msl_m": 600.0}
    ran(mission)
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-9)


def contradicted(mission):
    """One height for a hilly ground lies 112 m off where rays of its points meet."""
    ended = mission.run()
    assert ended.code == 3
    assert "TIES-HEIGHT" in ended.out


def test_constant_ground_height(mission, baseline):
    table = mission.measurements()
    mission.config["ground"]["height"] = 650.0
    contradicted(mission)
    constant = mission.results()
    assert set(constant["h_g_m"].to_pylist()) == {650.0}
    assert constant["h_g_m_input"].equals(table["h_g_m"])
    mission.observe(table.set_column(4, "h_g_m", pa.array(np.full(table.num_rows, 650.0))))
    mission.config["ground"]["height"] = {"column": "h_g_m"}
    contradicted(mission)
    np.testing.assert_array_equal(
        corrected(mission),
        np.stack([constant[c].to_numpy() for c in ("x_corrected_px", "y_corrected_px")], 1),
    )


def test_pixels_counted_from_the_centre_of_the_first(mission, baseline):
    table = mission.measurements()
    for i, name in ((2, "x_px"), (3, "y_px")):
        table = table.set_column(i, name, pa.array(table[name].to_numpy() - 0.5))
    mission.observe(table)
    mission.config["observations"]["pixel_origin"] = "centre"
    ran(mission)
    np.testing.assert_allclose(corrected(mission) + 0.5, corrected(baseline), atol=1e-8)
    np.testing.assert_array_equal(mission.results()["x_px"].to_numpy(), table["x_px"].to_numpy())
    for camera in mission.config["cameras"].values():
        camera["pixel_origin"] = "centre"
        camera["cx_px"] -= 0.5
        camera["cy_px"] -= 0.5
    ran(mission)
    np.testing.assert_allclose(corrected(mission) + 0.5, corrected(baseline), atol=1e-8)


def test_csv_gives_what_parquet_gives(mission, baseline):
    pa_csv.write_csv(mission.measurements(), mission.folder / "own.csv")
    mission.config["observations"]["path"] = "own.csv"
    ran(mission)
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-9, rtol=0)
    assert mission.results()["quality"].to_pylist() == baseline.results()["quality"].to_pylist()
    assert mission.results()["point"].to_pylist() == baseline.results()["point"].to_pylist()


def events_csv(baseline, how: str) -> str:
    stations = baseline.stations().to_pandas(timestamp_as_object=False)
    epoch = pd.Timestamp("1980-01-06", tz="UTC")
    head = "image,week,seconds,camera" if how == "gps" else "image,time_utc,camera"
    lines = [head]
    for row in stations.itertuples():
        since = (row.time_utc - epoch).value + LEAP_SECONDS * 10**9
        week, rest = divmod(since, 604_800 * 10**9)
        when = {
            "utc": row.time_utc.isoformat().replace("+00:00", "Z"),
            "naive": row.time_utc.tz_localize(None).isoformat(sep=" "),
            "gps": f"{week},{rest / 1e9:.7f}",
        }[how]
        lines.append(f"{row.image},{when},{row.camera}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("how", ["utc", "naive", "gps"])
def test_exposures_from_a_table(mission, baseline, how):
    (mission.folder / "events.csv").write_text(events_csv(baseline, how))
    columns = {"image": "image", "camera": "camera"}
    columns |= (
        {"gps_week": "week", "gps_seconds": "seconds"} if how == "gps" else {"time_utc": "time_utc"}
    )
    mission.config["events"] = {"csv": {"path": "events.csv", "columns": columns}}
    manifest = ran(mission)
    assert {i["role"] for i in manifest["inputs"]} == {"log", "observations", "events"}
    got, want = (m.stations().to_pandas() for m in (mission, baseline))
    assert got["image"].tolist() == want["image"].tolist()
    late = (got["time_utc"] - want["time_utc"]).abs().max()
    assert late <= pd.Timedelta(microseconds=1)
    for column, tolerance in (("lat_deg", 1e-9), ("h_msl_m", 1e-4), ("q_w", 1e-7)):
        np.testing.assert_allclose(got[column], want[column], atol=tolerance)
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-6)


def test_exposures_outside_the_log_and_in_a_gap(mission, baseline):
    """One exposure a day late, and one where the attitude was cut from the log."""
    lines = events_csv(baseline, "utc").splitlines()
    head = lines[0]
    rows = [line.split(",") for line in lines[1:]]
    late = pd.Timestamp(rows[0][1]) + dt.timedelta(days=1)
    rows[0][1] = late.isoformat().replace("+00:00", "Z")
    (mission.folder / "events.csv").write_text(
        "\n".join([head, *(",".join(row) for row in rows)]) + "\n"
    )
    mission.config["events"] = {
        "csv": {
            "path": "events.csv",
            "columns": {"image": "image", "time_utc": "time_utc", "camera": "camera"},
        }
    }
    manifest = ran(mission, 3)
    stations = mission.stations().to_pandas().set_index("image")
    image = rows[0][0]
    assert stations.loc[image, "status"] == "outside_log"
    assert np.isnan(stations.loc[image, "lat_deg"])
    assert manifest["stations"]["outside_log"] == 1
    result = mission.results().to_pandas()
    assert set(result.loc[result["image"] == image, "status"]) == {"no_station"}
    assert result.loc[result["image"] == image, "x_corrected_px"].isna().all()
    assert set(result.loc[result["image"] != image, "status"]) == {"ok"}
    assert "STATIONS-FLAGGED" in codes(manifest, "loss")


def without_attitude(content: bytes, first_us: float, last_us: float) -> bytes:
    """A DataFlash log whose ATT records between two times are gone."""
    formats: dict[int, tuple[str, int]] = {}
    kept = bytearray()
    i = 0
    while i + 3 <= len(content):
        assert content[i : i + 2] == b"\xa3\x95"
        kind = content[i + 2]
        if kind == 128:
            name = content[i + 5 : i + 9].rstrip(b"\0").decode()
            formats[content[i + 3]] = (name, content[i + 4])
            length = 89
        else:
            length = formats[kind][1]
        record = content[i : i + length]
        when = int.from_bytes(record[3:11], "little")
        if kind == 128 or formats[kind][0] != "ATT" or not first_us <= when <= last_us:
            kept += record
        i += length
    return bytes(kept)


def test_attitude_with_a_hole_and_without_any(mission, baseline):
    content = mission.log.read_bytes()
    reader = DFReader.DFReader_binary(str(mission.log))
    cam = []
    while (message := reader.recv_match(type=["CAM"])) is not None:
        cam.append((message.TimeUS, message.I))
    reader.close()
    when = min(cam)[0]
    mission.log.write_bytes(without_attitude(content, when - 2e6, when + 2e6))
    manifest = ran(mission, 3)
    assert manifest["stations"]["in_gap"] == 2
    assert manifest["stations"]["ok"] == 4
    mission.log.write_bytes(without_attitude(content, 0, 1e18))
    manifest = ran(mission, 3)
    assert "CHANNEL-MISSING" in codes(manifest, "loss")
    assert set(mission.stations()["status"].to_pylist()) == {"no_attitude"}
    assert mission.results()["x_corrected_px"].null_count == mission.results().num_rows
    assert mission.results().num_rows == baseline.results().num_rows


def test_exposures_of_an_image_nobody_measured(mission):
    table = mission.measurements()
    first = table["image"][0].as_py()
    mission.observe(table.filter(pa.compute.not_equal(table["image"], first)))
    manifest = ran(mission)
    assert "STATIONS-UNUSED" in {e["code"] for e in manifest["ledger"]}
    assert mission.stations().num_rows == 6


def in_hectopascal(source, target) -> None:
    """The recording again, its static pressure outside divided by a hundred.

    FluidPressure ends with two doubles, the pressure and its variance.
    """
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out)
        writer.start("ros2", "test")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            data = message.data
            if channel.topic == "/outside/pressure":
                pressure, variance = struct.unpack("<2d", data[-16:])
                data = data[:-16] + struct.pack("<2d", pressure / 100.0, variance)
            writer.add_message(
                channels[channel.id],
                message.log_time,
                data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()


def test_hectopascal_where_pascal_is_due(mission_factory, tmp_path):
    sound = mission_factory(tmp_path / "a", "mcap")
    wrong = mission_factory(tmp_path / "b", "mcap")
    in_hectopascal(sound.log, wrong.log)
    ended = wrong.run()
    assert ended.code == 6
    assert "CHANNEL-UNIT" in ended.err
    remedy = ended.err[ended.err.index("to do:") :].split("log.channels.pressure: ")[1]
    wrong.config["log"]["channels"]["pressure"] = yaml.safe_load(remedy)
    ran(sound)
    ran(wrong)
    np.testing.assert_allclose(corrected(wrong), corrected(sound), atol=1e-6)
    profile = pq.read_table(wrong.output / "profile.parquet")
    np.testing.assert_allclose(
        profile["pressure_pa"].to_numpy(),
        pq.read_table(sound.output / "profile.parquet")["pressure_pa"].to_numpy(),
        rtol=1e-9,
    )


def test_the_three_logs_of_one_flight_agree(mission_factory, tmp_path, baseline):
    for kind in ("tlog", "mcap"):
        other = mission_factory(tmp_path / kind, kind)
        ran(other)
        assert np.abs(corrected(other) - corrected(baseline)).max() < 0.01


def test_calibration_in_flight_warns(mission):
    mission.config["cameras"]["nadir"]["calibration"] = "in_flight_uncorrected"
    mission.config["cameras"]["oblique"]["calibration"] = "in_flight_corrected"
    manifest = ran(mission)
    found = [e for e in manifest["ledger"] if e["code"] == "CALIBRATION-IN-FLIGHT"]
    assert [e["where"] for e in found] == ["cameras.nadir.calibration"]
    assert "warning CALIBRATION-IN-FLIGHT" in mission.run().out


def test_windows(mission, baseline):
    """No window: no compartment. Constant air near the logged one: nearly the same."""
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "the hatch was open"}]
    for camera in mission.config["cameras"].values():
        del camera["window"]
    ran(mission)
    assert set(mission.results()["r_cc_rad"].to_pylist()) == {0.0}
    stations = baseline.stations().to_pandas()
    air = {
        "pressure_hpa": float(stations["cabin_pressure_pa"].mean() / 100.0),
        "temperature_c": float(stations["cabin_temperature_k"].mean() - 273.15),
    }
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": air}
    ran(mission)
    r_cc = mission.results()["r_cc_rad"].to_numpy()
    want = baseline.results()["r_cc_rad"].to_numpy()
    np.testing.assert_allclose(r_cc, want, rtol=0.03, atol=1e-9)


def test_standard_atmosphere_kept(mission, baseline):
    mission.config["atmosphere"]["adjust"] = False
    manifest = ran(mission)
    assert manifest["profile"]["basis"] == "standard"
    assert "AIR-NOT-ADJUSTED" in codes(manifest, "note")
    assert 1e-4 < np.abs(corrected(mission) - corrected(baseline)).max() < 0.2


def test_side_by_side_is_one_after_the_other(mission_factory, tmp_path, baseline, unbend):
    missions = [mission_factory(tmp_path / name) for name in ("a", "b")]
    ended = unbend("run", *(m.save() for m in missions), "--jobs", "2")
    assert ended.code == 0, ended.text
    for mission in missions:
        np.testing.assert_array_equal(corrected(mission), corrected(baseline))
