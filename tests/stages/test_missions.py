"""Missions told in other ways: other heights, pixels, tables, units; the same answer."""

from __future__ import annotations

import json
import re
import struct
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import yaml

from tests.helpers import codes_of, entry_of, refused, with_code
from tests.stages.dataflash_records import times_us, without
from tests.stages.other_logs import channel_of, flight_of, opened, with_channels
from unbend.batch.runs import read_mission
from unbend.tables.geodata.geoid import package_geoid

pytestmark = pytest.mark.usefixtures("plain_report")

UNDULATION_M = 47.6
LEAP_NS = 18 * 10**9
WEEK_NS = 604_800 * 10**9


def corrected(mission) -> np.ndarray:
    table = mission.results().select(["x_corrected_px", "y_corrected_px"])
    return table.to_pandas().to_numpy()


def prepared(mission):
    return read_mission(mission.save())


def with_ground(mission, height_m) -> None:
    """The observations with other heights of the ground."""
    table = mission.measurements()
    column = table.schema.get_field_index("h_g_m")
    mission.observe(table.set_column(column, "h_g_m", pa.array(height_m)))


def ground_m(mission) -> np.ndarray:
    return mission.measurements()["h_g_m"].to_numpy()


@pytest.mark.parametrize(
    ("level_m", "section", "atol"),
    [
        (-UNDULATION_M, {"reference": "ellipsoid"}, 1e-6),
        (600.0, {"reference": "relative", "home_h_msl_m": 600.0}, 1e-9),
    ],
    ids=["ellipsoid", "take-off"],
)
def test_ground_above_another_level(mission, baseline, level_m, section, atol):
    with_ground(mission, ground_m(mission) - level_m)
    mission.config["ground"] |= section
    mission.run_to_manifest()
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=atol)
    expected_m = baseline.results()["h_g_m"].to_numpy()
    np.testing.assert_allclose(mission.results()["h_g_m"].to_numpy(), expected_m, atol=1e-6)


def test_ground_above_the_ellipsoid_when_the_log_knows_the_undulation(mission, baseline):
    with_ground(mission, ground_m(mission) + UNDULATION_M)
    mission.config["ground"]["reference"] = "ellipsoid"
    del mission.config["mission"]["undulation_m"]
    manifest = mission.run_to_manifest()
    assert entry_of(manifest, "HEIGHT-UNDULATION")["kind"] == "note"
    np.testing.assert_allclose(corrected(mission), corrected(baseline), atol=1e-3)


@pytest.fixture
def by_mcap(mission_factory, tmp_path):
    """The mission by its MCAP log; NavSatFix has heights above the ellipsoid alone."""
    return mission_factory(tmp_path / "mcap", "mcap")


def test_the_geoid_gives_the_undulation_that_the_log_lacks(by_mcap):
    """EGM96 has 47.2 m there, at each place."""
    stated = prepared(by_mcap)
    (told,) = with_code(stated.ledger, "HEIGHT-UNDULATION")
    assert "by mission.undulation_m" in told.what
    del by_mcap.config["mission"]["undulation_m"]
    by_geoid = prepared(by_mcap)
    (told,) = with_code(by_geoid.ledger, "HEIGHT-UNDULATION")
    assert "EGM96" in told.what
    stations = by_geoid.stations
    undulation_m = package_geoid().undulation(stations.lat_rad, stations.lon_rad)
    assert np.ptp(undulation_m) > 0.02
    lower_m = stations.h_msl_m - stated.stations.h_msl_m
    np.testing.assert_allclose(lower_m, UNDULATION_M - undulation_m, atol=1e-3)


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_an_undulation_of_the_wrong_sign_is_a_finding(mission_factory, tmp_path, kind):
    mission = mission_factory(tmp_path, kind)
    mission.config["mission"]["undulation_m"] = -UNDULATION_M
    findings = with_code(prepared(mission).ledger, "HEIGHT-GEOID")
    assert {finding.kind for finding in findings} == {"finding"}
    assert any("-94.8 m from EGM96" in f.what and "other sign" in f.what for f in findings)
    mission.config["mission"]["undulation_m"] = UNDULATION_M - 5.0
    nearer = with_code(prepared(mission).ledger, "HEIGHT-GEOID")
    assert {message.kind for message in nearer} == {"warning"}


def test_what_is_found_may_be_accepted_with_its_reason(mission):
    """It stays in the ledger."""
    mission.config["mission"]["undulation_m"] = -UNDULATION_M
    ledger = mission.run_to_manifest(3)["ledger"]
    codes = {entry["code"] for entry in ledger if entry["kind"] in ("finding", "loss")}
    assert codes <= {"HEIGHT-GEOID", "TIES-HEIGHT"}
    mission.config["accept"] = [{"code": code, "reason": "as flown"} for code in sorted(codes)]
    ledger = mission.run_to_manifest()["ledger"]
    accepted = [entry for entry in ledger if entry["code"] in codes]
    assert {entry["code"] for entry in accepted} == codes
    for entry in accepted:
        assert entry["kind"] == "warning"
        assert "as flown" in entry["what"]


def write_geoid(mission, south_deg: float, undulation_m: float) -> None:
    head = struct.pack(">4d2i", south_deg, 8.0, 0.5, 0.5, 3, 3)
    values = np.full(9, undulation_m, ">f4")
    (mission.folder / "national.gtx").write_bytes(head + values.tobytes())


def test_a_grid_of_the_mission_file_and_its_mistakes(by_mcap):
    by_mcap.config["mission"] = {"name": "grid", "geoid": "national.gtx"}
    with refused("INPUT-MISSING") as refusal:
        prepared(by_mcap)
    assert "mission.geoid" in str(refusal.value)
    write_geoid(by_mcap, 47.0, 47.5)
    (told,) = with_code(prepared(by_mcap).ledger, "HEIGHT-UNDULATION")
    assert told.what == "undulation of 47.50 m, by national.gtx"
    write_geoid(by_mcap, 47.0, -47.5)
    (told,) = with_code(prepared(by_mcap).ledger, "HEIGHT-GEOID")
    assert told.kind == "finding"
    assert "other sign" in told.what
    (by_mcap.folder / "national.gtx").write_bytes(b"not a grid")
    with refused("GEOID-GRID"):
        prepared(by_mcap)


def test_stations_outside_the_grid_have_no_height(by_mcap, mission):
    write_geoid(by_mcap, 49.0, 47.5)
    by_mcap.config["mission"] = {"name": "grid", "geoid": "national.gtx"}
    outside = prepared(by_mcap)
    (told,) = with_code(outside.ledger, "GEOID-OUTSIDE")
    assert told.kind == "loss"
    assert "6 of 6 stations are outside national.gtx" in told.what
    assert outside.stations.status.tolist() == ["height_reference_unknown"] * 6
    # A log with both heights.
    write_geoid(mission, 49.0, 47.5)
    mission.config["mission"] = {"name": "grid", "geoid": "national.gtx"}
    (told,) = with_code(prepared(mission).ledger, "GEOID-OUTSIDE")
    assert "are outside national.gtx" in told.what


def test_heights_above_an_unknown_take_off_point(by_mcap):
    by_mcap.config["ground"]["reference"] = "relative"
    printed = by_mcap.refusal("HEIGHT-REFERENCE")
    proposed = re.search(r"write ground\.home_h_msl_m: ([\d.]+)", printed)
    # The simulated field lies at 450 m; the geoid of the package is not quite the simulator's.
    assert float(proposed[1]) == pytest.approx(450.0, abs=3.0)


@pytest.mark.parametrize("kind", ["bin", "tlog"])
def test_inspect_init_and_check_give_one_take_off(mission_factory, tmp_path, unbend, kind):
    """With the home of an autopilot, and with none: the height where the log begins."""
    mission = mission_factory(tmp_path, kind)
    flight = json.loads(unbend("inspect", mission.log, "--json").out)["flight"]
    assert flight["take_off_reference"] == "sea level"
    assert f"{flight['take_off_m']:.0f}" == "450"
    observations = mission.folder / "observations.parquet"
    commands = {
        "take-off 450 m above sea level": ("inspect", mission.log),
        "take-off 450 m above the sea": ("init", mission.log, observations, "--out", "-"),
        "take-off 450 m,": ("check", mission.save()),
    }
    for words, command in commands.items():
        assert words in " ".join(unbend(*command).out.split())


def test_constant_ground_height(mission):
    """One height for a hilly ground lies 112 m off where rays of its points meet."""
    mission.config["ground"]["height"] = 650.0
    assert "TIES-HEIGHT" in codes_of(mission.run_to_manifest(3))
    constant = mission.results()
    by_number = corrected(mission)
    assert set(constant["h_g_m"].to_pylist()) == {650.0}
    assert constant["h_g_m_input"].equals(mission.measurements()["h_g_m"])
    with_ground(mission, np.full(len(constant), 650.0))
    mission.config["ground"]["height"] = {"column": "h_g_m"}
    assert "TIES-HEIGHT" in codes_of(mission.run_to_manifest(3))
    np.testing.assert_array_equal(corrected(mission), by_number)


def test_pixels_counted_from_the_centre_of_the_first(mission, baseline):
    table = mission.measurements().to_pandas()
    table[["x_px", "y_px"]] -= 0.5
    mission.observe(pa.Table.from_pandas(table, preserve_index=False))
    mission.config["observations"]["pixel_origin"] = "centre"
    mission.run_to_manifest()
    np.testing.assert_allclose(corrected(mission) + 0.5, corrected(baseline), atol=1e-8)
    np.testing.assert_array_equal(mission.results()["x_px"].to_numpy(), table["x_px"])
    for camera in mission.config["cameras"].values():
        camera["pixel_origin"] = "centre"
        camera["cx_px"] -= 0.5
        camera["cy_px"] -= 0.5
    mission.run_to_manifest()
    np.testing.assert_allclose(corrected(mission) + 0.5, corrected(baseline), atol=1e-8)


def write_events(mission, time: pd.DataFrame, baseline, **columns: str) -> None:
    """A table of the exposures, whose times stand in these columns."""
    names = baseline.stations().select(["image", "camera"]).to_pandas()
    names.join(time).to_csv(mission.folder / "events.csv", index=False)
    columns |= {"image": "image", "camera": "camera"}
    mission.config["events"] = {"csv": {"path": "events.csv", "columns": columns}}


def exposed(baseline) -> pd.Series:
    return baseline.stations()["time_utc"].to_pandas().copy()


def in_utc(time: pd.Series) -> pd.DataFrame:
    return pd.DataFrame({"time_utc": time.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")})


def in_gps_weeks(time: pd.Series) -> pd.DataFrame:
    since = (time - pd.Timestamp("1980-01-06", tz="UTC")).astype("int64") + LEAP_NS
    return pd.DataFrame({"gps_week": since // WEEK_NS, "gps_seconds": since % WEEK_NS / 1e9})


@pytest.mark.parametrize("written", [in_utc, in_gps_weeks])
def test_exposures_from_a_table(mission, baseline, written):
    time = written(exposed(baseline))
    write_events(mission, time, baseline, **{name: name for name in time.columns})
    stations = prepared(mission).stations
    logged = baseline.stations().to_pandas()
    assert stations.image.tolist() == logged["image"].tolist()
    late_ns = stations.time_ns - logged["time_utc"].astype("int64")
    assert np.abs(late_ns).max() <= 1000
    np.testing.assert_allclose(np.degrees(stations.lat_rad), logged["lat_deg"], atol=1e-9)
    np.testing.assert_allclose(stations.h_msl_m, logged["h_msl_m"], atol=1e-4)
    np.testing.assert_allclose(stations.quaternion[:, 0], logged["q_w"], atol=1e-7)


def test_an_exposure_outside_the_log_has_no_correction(mission, baseline):
    time = exposed(baseline)
    time[0] += pd.Timedelta(days=1)
    write_events(mission, in_utc(time), baseline, time_utc="time_utc")
    manifest = mission.run_to_manifest(3)
    assert {item["role"] for item in manifest["inputs"]} == {"log", "observations", "events"}
    assert entry_of(manifest, "STATIONS-FLAGGED")["kind"] == "loss"
    assert manifest["stations"]["outside_log"] == 1
    station = mission.stations().to_pandas().iloc[0]
    assert station["status"] == "outside_log"
    assert np.isnan(station["lat_deg"])
    result = mission.results().to_pandas()
    of_station = result["image"] == station["image"]
    assert set(result.loc[of_station, "status"]) == {"no_station"}
    assert result.loc[of_station, "x_corrected_px"].isna().all()
    assert set(result.loc[~of_station, "status"]) == {"ok"}


def test_attitude_with_a_hole(mission):
    content = mission.log.read_bytes()
    first_us = min(times_us(content, "CAM"))
    mission.log.write_bytes(without(content, "ATT", first_us - 2e6, first_us + 2e6))
    status = prepared(mission).stations.status.tolist()
    assert sorted(status) == ["in_gap"] * 2 + ["ok"] * 4


def test_a_log_without_any_attitude(mission, baseline):
    content = mission.log.read_bytes()
    mission.log.write_bytes(without(content, "ATT", 0.0, np.inf))
    manifest = mission.run_to_manifest(3)
    losses = {entry["code"] for entry in manifest["ledger"] if entry["kind"] == "loss"}
    assert "CHANNEL-MISSING" in losses
    assert set(mission.stations()["status"].to_pylist()) == {"no_attitude"}
    result = mission.results()
    assert result["x_corrected_px"].null_count == result.num_rows == baseline.results().num_rows


def test_exposures_of_an_image_nobody_measured(mission):
    table = mission.measurements().to_pandas()
    others = table[table["image"] != table["image"][0]]
    mission.observe(pa.Table.from_pandas(others, preserve_index=False))
    measured = prepared(mission)
    assert with_code(measured.ledger, "STATIONS-UNUSED")
    assert not measured.ledger.has_losses
    assert len(measured.stations) == 6


def test_hectopascal_where_pascal_is_due(by_mcap):
    """What the refusal proposes gives the pressures of the right log."""
    inputs = opened(by_mcap)
    barometer = channel_of(inputs, "/outside/pressure")
    right_pa = barometer["pressure_pa"]
    columns = dict(barometer.columns) | {"pressure_pa": right_pa / 100.0}
    wrong = with_channels(inputs, replace(barometer, columns=columns))
    with refused("CHANNEL-UNIT") as refusal:
        flight_of(by_mcap, wrong)
    _, _, remedy = refusal.value.remedy.partition("log.channels.pressure: ")
    by_mcap.config["log"]["channels"]["pressure"] = yaml.safe_load(remedy)
    flight, _ = flight_of(by_mcap, wrong)
    pressure_pa = flight.channels[-1]["pressure_pa"]
    np.testing.assert_allclose(pressure_pa, right_pa, rtol=1e-9)


@pytest.mark.parametrize("kind", ["tlog", "mcap"])
def test_the_three_logs_of_one_flight_agree(mission_factory, tmp_path, baseline, kind):
    other = mission_factory(tmp_path, kind)
    other.run_to_manifest()
    assert np.abs(corrected(other) - corrected(baseline)).max() < 0.01


def test_calibration_in_flight_warns(mission):
    mission.config["cameras"]["nadir"]["calibration"] = "in_flight_uncorrected"
    mission.config["cameras"]["oblique"]["calibration"] = "in_flight_corrected"
    ended = mission.run()
    assert ended.code == 0, ended.text
    assert "warning CALIBRATION-IN-FLIGHT" in ended.out
    told = entry_of(mission.manifest(), "CALIBRATION-IN-FLIGHT")
    assert told["where"] == "cameras.nadir.calibration"


def test_windows(mission, baseline):
    """No window: no compartment. Constant air near the logged one: nearly the same."""
    mission.config["accept"] = [{"code": "PLAUSIBLE-WINDOW", "reason": "the hatch was open"}]
    for camera in mission.config["cameras"].values():
        del camera["window"]
    mission.run_to_manifest()
    assert set(mission.results()["r_cc_rad"].to_pylist()) == {0.0}
    stations = baseline.stations().to_pandas()
    cabin = {
        "pressure_hpa": float(stations["cabin_pressure_pa"].mean() / 100.0),
        "temperature_c": float(stations["cabin_temperature_k"].mean() - 273.15),
    }
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": cabin}
    mission.run_to_manifest()
    r_cc = mission.results()["r_cc_rad"].to_numpy()
    logged = baseline.results()["r_cc_rad"].to_numpy()
    assert np.abs(logged).max() > 1e-6
    np.testing.assert_allclose(r_cc, logged, rtol=0.03, atol=1e-9)


def test_standard_atmosphere_kept(mission, baseline):
    mission.config["atmosphere"]["adjust"] = False
    manifest = mission.run_to_manifest()
    assert manifest["profile"]["basis"] == "standard"
    assert entry_of(manifest, "AIR-NOT-ADJUSTED")["kind"] == "note"
    assert 1e-4 < np.abs(corrected(mission) - corrected(baseline)).max() < 0.2


def test_side_by_side_is_one_after_the_other(mission_factory, tmp_path, baseline, unbend):
    missions = [mission_factory(tmp_path / name) for name in ("a", "b")]
    ended = unbend("run", *(mission.save() for mission in missions), "--jobs", "2")
    assert ended.code == 0, ended.text
    for mission in missions:
        np.testing.assert_array_equal(corrected(mission), corrected(baseline))
