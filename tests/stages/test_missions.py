"""Missions told in other ways: other heights, pixels, tables, units; the same answer."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal

from tests.helpers import (
    codes_of,
    entry_of,
    one_line,
    refused,
    with_code,
)
from tests.stages.flown_files import gps_time
from tests.stages.other_logs import (
    channel_of,
    flight_of,
    message_of,
    opened,
    read_folder,
    with_channels,
)
from tests.stages.terrain_models import gtx
from unbend.tables.geodata.geoid import package_geoid

UNDULATION_M = 47.6


def corrected(mission):
    table = mission.result_rows()
    return table[["x_corrected_px", "y_corrected_px"]].to_numpy()


def assert_near(mission, baseline, atol):
    """The corrected observations of two missions are the same to some pixels."""
    assert_allclose(corrected(mission), corrected(baseline), atol=atol)


def move_ground(mission, by_m):
    """The observations with other heights of the ground."""
    table = mission.measured_rows()
    table["h_g_m"] += by_m
    mission.observe_rows(table)


ABOVE_HOME = {"reference": "relative", "home_h_msl_m": 600.0}


@pytest.mark.parametrize(
    ("level_m", "section", "atol"),
    [
        (-UNDULATION_M, {"reference": "ellipsoid"}, 1e-6),
        (600.0, ABOVE_HOME, 1e-9),
    ],
    ids=["ellipsoid", "take-off"],
)
def test_ground_above_another_level(mission, baseline, level_m, section, atol):
    move_ground(mission, -level_m)
    mission.config["ground"] |= section

    mission.run_to_manifest()

    assert_near(mission, baseline, atol)
    height_m = mission.results()["h_g_m"]
    assert_allclose(height_m, baseline.results()["h_g_m"], atol=1e-6)


def test_ground_above_the_ellipsoid_when_the_log_knows_the_undulation(mission, baseline):
    move_ground(mission, UNDULATION_M)
    mission.config["ground"]["reference"] = "ellipsoid"
    del mission.config["mission"]["undulation_m"]

    manifest = mission.run_to_manifest()

    assert entry_of(manifest, "HEIGHT-UNDULATION")["kind"] == "note"
    assert_near(mission, baseline, 1e-3)


@pytest.fixture
def by_mcap(mission_factory, tmp_path):
    """The mission by its MCAP log; NavSatFix has heights above the ellipsoid alone."""
    return mission_factory(tmp_path / "mcap", "mcap")


def test_the_geoid_gives_the_undulation_that_the_log_lacks(by_mcap):
    """EGM96 has 47.2 m there, at each place."""
    by_number = read_folder(by_mcap)
    message = message_of(by_number, "HEIGHT-UNDULATION")
    assert "by mission.undulation_m" in message.what

    del by_mcap.config["mission"]["undulation_m"]
    by_geoid = read_folder(by_mcap)

    message = message_of(by_geoid, "HEIGHT-UNDULATION")
    assert "EGM96" in message.what
    stations = by_geoid.stations
    undulation_m = package_geoid().undulation(stations.lat_rad, stations.lon_rad)
    assert np.ptp(undulation_m) > 0.02
    higher_m = stations.h_msl_m - by_number.stations.h_msl_m
    assert_allclose(higher_m, UNDULATION_M - undulation_m, atol=1e-3)


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_an_undulation_of_the_wrong_sign_is_a_finding(mission_factory, tmp_path, kind):
    mission = mission_factory(tmp_path, kind)
    section = mission.config["mission"]
    section["undulation_m"] = -UNDULATION_M
    findings = with_code(read_folder(mission).ledger, "HEIGHT-GEOID")
    assert {finding.kind for finding in findings} == {"finding"}
    texts = [finding.what for finding in findings if "other sign" in finding.what]
    assert any("-94.8 m from EGM96" in text for text in texts)

    section["undulation_m"] = UNDULATION_M - 5.0
    messages = with_code(read_folder(mission).ledger, "HEIGHT-GEOID")
    assert {message.kind for message in messages} == {"warning"}


def with_geoid(mission, content):
    """The mission with a grid of the geoid, read."""
    (mission.folder / "national.gtx").write_bytes(content)
    mission.config["mission"] = {"name": "grid", "geoid": "national.gtx"}
    return read_folder(mission)


def grid(south_deg, undulation_m):
    undulations_m = np.full((3, 3), undulation_m)
    return gtx(
        south_deg,
        8.0,  # west [deg]
        0.5,  # between rows, and between columns [deg]
        undulations_m,
    )


def test_a_grid_of_the_mission_file_and_its_mistakes(by_mcap):
    by_number = with_geoid(by_mcap, grid(47.0, 47.5))
    message = message_of(by_number, "HEIGHT-UNDULATION")
    assert message.what == "undulation of 47.50 m, by national.gtx"

    of_other_sign = with_geoid(by_mcap, grid(47.0, -47.5))
    finding = message_of(of_other_sign, "HEIGHT-GEOID")
    assert finding.kind == "finding"
    assert "other sign" in finding.what

    with refused("GEOID-GRID"):
        with_geoid(by_mcap, b"not a grid")

    (by_mcap.folder / "national.gtx").unlink()
    with refused("INPUT-MISSING", says="mission.geoid"):
        read_folder(by_mcap)


def test_stations_outside_the_grid_have_no_height(by_mcap, mission):
    outside = with_geoid(by_mcap, grid(49.0, 47.5))
    loss = message_of(outside, "GEOID-OUTSIDE")
    assert loss.kind == "loss"
    assert "6 of 6 stations are outside national.gtx" in loss.what
    assert outside.stations.status.tolist() == ["height_reference_unknown"] * 6

    with_both_heights = with_geoid(mission, grid(49.0, 47.5))
    message = message_of(with_both_heights, "GEOID-OUTSIDE")
    assert "are outside national.gtx" in message.what


def test_heights_above_an_unknown_take_off_point(by_mcap):
    by_mcap.config["ground"]["reference"] = "relative"
    printed = by_mcap.refusal("HEIGHT-REFERENCE")
    (proposed_m,) = re.findall(r"write ground\.home_h_msl_m: ([\d.]+)", printed)
    # The simulated field is at 450 m; the geoid of the package differs from the simulator's.
    assert float(proposed_m) == pytest.approx(450.0, abs=3.0)


@pytest.mark.parametrize("kind", ["bin", "tlog"])
def test_inspect_init_and_check_give_one_take_off(mission_factory, tmp_path, unbend, kind):
    """With the home of an autopilot, and with none: the height where the log begins."""
    mission = mission_factory(tmp_path, kind)
    observations = mission.folder / "observations.parquet"

    as_json = unbend("inspect", mission.log, "--json")
    flight = json.loads(as_json.out)["flight"]
    inspected = unbend("inspect", mission.log)
    proposed = unbend("init", mission.log, observations, "--out", "-")
    checked = unbend("check", mission.save())

    assert flight["take_off_reference"] == "sea level"
    assert round(flight["take_off_m"]) == 450
    assert "take-off 450 m above sea level" in one_line(inspected.out)
    assert "take-off 450 m above the sea" in one_line(proposed.out)
    assert "take-off 450 m," in one_line(checked.out)


def test_constant_ground_height(mission):
    """One height for a hilly ground is 112 m from where rays of its points meet."""
    mission.config["ground"]["height"] = 650.0
    assert "TIES-HEIGHT" in codes_of(mission.run_to_manifest(3))
    constant = mission.results()
    by_number = corrected(mission)
    assert set(constant["h_g_m"].to_pylist()) == {650.0}
    assert constant["h_g_m_input"].equals(mission.measurements()["h_g_m"])

    table = mission.measured_rows()
    mission.observe_rows(table.assign(h_g_m=650.0))
    mission.config["ground"]["height"] = {"column": "h_g_m"}
    assert "TIES-HEIGHT" in codes_of(mission.run_to_manifest(3))
    assert_array_equal(corrected(mission), by_number)


def write_events(mission, events, delay_s=0.0):
    """A table of the exposures, whose columns are called as in the mission file."""
    events.to_csv(mission.folder / "events.csv", index=False)
    section = {
        "path": "events.csv",
        "columns": {name: name for name in events.columns},
        "delay_s": delay_s,
    }
    mission.config["events"] = {"csv": section}


@pytest.fixture
def exposures(baseline):
    columns = ["image", "camera", "time_utc"]
    return baseline.stations().select(columns).to_pandas()


def in_utc(events):
    time = events["time_utc"].dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return events.assign(time_utc=time)


def in_gps_weeks(events):
    table = events.drop(columns="time_utc")
    table["gps_week"], table["gps_seconds"] = gps_time(events["time_utc"])
    return table


@pytest.mark.parametrize(("written", "delay_s"), [(in_utc, 0.25), (in_gps_weeks, -0.125)])
def test_exposures_from_a_table(mission, baseline, exposures, written, delay_s):
    """A camera whose clock is a quarter of a second slow writes times that much too early."""
    exposures["time_utc"] -= pd.Timedelta(seconds=delay_s)
    write_events(mission, written(exposures), delay_s)

    stations = read_folder(mission).stations

    logged = baseline.station_rows()
    assert stations.image.tolist() == logged["image"].tolist()
    late_ns = stations.time_ns - logged["time_utc"].astype("int64")
    assert np.abs(late_ns).max() <= 1000
    lat_deg = np.degrees(stations.lat_rad)
    assert_allclose(lat_deg, logged["lat_deg"], atol=1e-9)
    assert_allclose(stations.h_msl_m, logged["h_msl_m"], atol=1e-4)
    q_w = stations.quaternion[:, 0]
    assert_allclose(q_w, logged["q_w"], atol=1e-7)


def test_an_exposure_outside_the_log_has_no_correction(mission, exposures):
    exposures.loc[0, "time_utc"] += pd.Timedelta(days=1)
    write_events(mission, in_utc(exposures))

    manifest = mission.run_to_manifest(3)

    roles = {item["role"] for item in manifest["inputs"]}
    assert roles == {"log", "observations", "events"}
    assert entry_of(manifest, "STATIONS-FLAGGED")["kind"] == "loss"
    assert manifest["stations"]["outside_log"] == 1
    station = mission.station_rows().iloc[0]
    assert station["status"] == "outside_log"
    assert np.isnan(station["lat_deg"])
    result = mission.result_rows()
    is_of_station = result["image"] == station["image"]
    lost = result[is_of_station]
    assert set(lost["status"]) == {"no_station"}
    assert lost["x_corrected_px"].isna().all()
    assert set(result[~is_of_station]["status"]) == {"ok"}


def test_empty_cells_in_the_column_of_images_are_counted_apart(mission):
    table = mission.measured_rows()
    table["image"] = table["image"].astype(object)
    points = table.loc[[4, 9], "point"].tolist()
    table.loc[[4, 9], "image"] = None
    mission.observe_rows(table)

    manifest = mission.run_to_manifest(3)

    entry = entry_of(manifest, "OBS-NO-IMAGE")
    assert entry["count"] == 2
    assert f"row 4 (point {points[0]})" in entry["what"]
    assert entry["where"] == "observations.columns.image"
    assert "OBS-FLAGGED" not in codes_of(manifest)
    assert "None" not in json.dumps(manifest["ledger"])


def test_a_column_of_images_that_is_empty(mission):
    table = mission.measured_rows()
    table["image"] = ""
    mission.observe_rows(table)

    manifest = mission.checked().manifest.values

    assert entry_of(manifest, "OBS-NO-IMAGE")["count"] == len(table)
    flagged = entry_of(manifest, "PLAUSIBLE-FLAGGED")["what"]
    assert flagged.endswith("the name of the image is missing (observations.columns.image)")


def test_hectopascal_where_pascal_is_due(by_mcap):
    """What the refusal proposes gives the pressures of the right log."""
    inputs = opened(by_mcap)
    barometer = channel_of(inputs, "/outside/pressure")
    pressure_pa = barometer["pressure_pa"]
    columns = dict(barometer.columns) | {"pressure_pa": pressure_pa / 100.0}
    wrong = with_channels(inputs, replace(barometer, columns=columns))
    with refused("CHANNEL-UNIT") as refusal:
        flight_of(by_mcap, wrong)

    _, _, remedy = refusal.value.remedy.partition("log.channels.pressure: ")
    channels = by_mcap.config["log"]["channels"]
    channels["pressure"] = yaml.safe_load(remedy)
    flight, _ = flight_of(by_mcap, wrong)

    corrected_pa = flight.channels[-1]["pressure_pa"]
    assert_allclose(corrected_pa, pressure_pa, rtol=1e-9)


def test_calibration_in_flight_warns(mission, obeyed):
    cameras = mission.config["cameras"]
    cameras["nadir"]["calibration"] = "in_flight_uncorrected"
    cameras["oblique"]["calibration"] = "in_flight_corrected"

    text = obeyed("run", mission.save())

    assert "warning CALIBRATION-IN-FLIGHT" in text
    entry = entry_of(mission.manifest(), "CALIBRATION-IN-FLIGHT")
    assert entry["where"] == "cameras.nadir.calibration"


def test_pixels_counted_from_the_centre_of_the_first(mission, baseline):
    table = mission.measured_rows()
    table[["x_px", "y_px"]] -= 0.5
    mission.observe_rows(table)
    mission.config["observations"]["pixel_origin"] = "centre"
    expected = corrected(baseline) - 0.5

    mission.run_to_manifest()

    assert_allclose(corrected(mission), expected, atol=1e-8)
    assert_array_equal(mission.results()["x_px"], table["x_px"])

    for camera in mission.config["cameras"].values():
        camera["pixel_origin"] = "centre"
        camera["cx_px"] -= 0.5
        camera["cy_px"] -= 0.5
    mission.run_to_manifest()
    assert_allclose(corrected(mission), expected, atol=1e-8)
