"""What a run leaves behind: columns, rows, marks, bytes; and what a second run does."""

import datetime
import hashlib
import json
import re
import shutil
import socket
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose

from tests.batch.conftest import flip_a_byte, hashes_in

approx = pytest.approx

# Columns and their types, in their order.
OBSERVATIONS = """
image string
point string
x_px double
y_px double
x_corrected_px double
y_corrected_px double
zeta_c_rad double
r_c_rad double
r_cc_rad double
sigma_r_c_rad double
sigma_air_dx_px float
sigma_air_dy_px float
sigma_station_dx_px float
sigma_station_dy_px float
sigma_ground_dx_px float
sigma_ground_dy_px float
sigma_r_cc_rad float
sigma_cabin_dx_px float
sigma_cabin_dy_px float
dx_ds_px float
dy_ds_px float
dx_dncc_px float
dy_dncc_px float
h_g_m double
status string
""".strip().splitlines()
STATIONS = """
image string
camera string
profile_id string
time_utc timestamp[ns, tz=UTC]
lat_deg double
lon_deg double
h_msl_m double
h_ellipsoid_m double
q_w double
q_x double
q_y double
q_z double
aircraft_q_w double
aircraft_q_x double
aircraft_q_y double
aircraft_q_z double
pressure_pa double
temperature_k double
vapour_pressure_pa double
cabin_pressure_pa double
cabin_temperature_k double
cabin_vapour_pressure_pa double
sigma_cabin_pressure_pa double
sigma_cabin_temperature_k double
sigma_horizontal_m double
sigma_height_m double
sigma_tilt_deg double
sigma_yaw_deg double
suspect_reason string
suspect_m double
status string
geometry binary
""".strip().splitlines()
PROFILE = """
profile_id
time_utc
h_m
geopotential_m
temperature_k
pressure_pa
vapour_pressure_pa
refractivity
layer
equation
h_base_m
t_base_k
p_base_pa
lapse_k_per_m
source
standard_temperature_k
standard_pressure_pa
sigma_temperature_k
sigma_refractivity
""".strip().splitlines()


PART = "observations/part-00000.parquet"
MEASURED_PX = ["x_px", "y_px"]
CORRECTED_PX = ["x_corrected_px", "y_corrected_px"]


def columns_of(schema):
    """The columns and their types, in their order."""
    return [f"{field.name} {field.type}" for field in schema]


def flip(path, byte):
    content = bytearray(path.read_bytes())
    content[byte] ^= 1
    path.write_bytes(content)


def profile_of(mission):
    return pq.read_table(mission.output / "profile.parquet").to_pandas()


# ---- columns and rows


def test_folder_holds_what_it_should_and_nothing_else(baseline):
    assert [path.name for path in baseline.output.glob(".*")] == [".lock"]
    assert set(hashes_in(baseline.output)) == {
        PART,
        "stations.parquet",
        "profile.parquet",
        "manifest.json",
        "report.html",
    }


def test_observation_columns(baseline):
    result = baseline.results()
    schema = result.schema
    assert columns_of(schema) == [*OBSERVATIONS, "quality int32"]
    assert schema.metadata[b"unbend.refraction"] == b"removed"
    conventions = json.loads(schema.metadata[b"unbend.conventions"])
    assert {"pixels", "camera", "frame", "signs"} <= set(conventions)
    assert schema.field("x_corrected_px").metadata[b"unit"] == b"px"
    assert schema.field("r_c_rad").metadata[b"unit"] == b"rad"
    assert schema.field("h_g_m").metadata[b"unit"] == b"m"
    measurements = baseline.measurements()
    for name in ("image", "point", "x_px", "y_px", "h_g_m", "quality"):
        assert result[name].equals(measurements[name]), name
    assert set(result["status"].to_pylist()) == {"ok"}


def test_station_columns(baseline):
    table = baseline.stations()
    assert columns_of(table.schema) == STATIONS
    stations = table.to_pandas()
    assert sorted(stations["camera"]) == ["nadir"] * 3 + ["oblique"] * 3
    assert set(stations["status"]) == {"ok"}
    quaternion = stations[["q_w", "q_x", "q_y", "q_z"]]
    assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-12)
    assert (stations["q_w"] >= 0.0).all()


def test_profile_columns(baseline):
    """That each pressure recomputes from its row is tested with the table of a profile."""
    schema = pq.read_schema(baseline.output / "profile.parquet")
    assert set(schema.names) >= set(PROFILE)
    assert 46.0 < float(schema.metadata[b"latitude"]) < 48.0
    rows = profile_of(baseline)
    assert 52 in set(rows["equation"])
    sources = set(rows["source"])
    assert "measured" in sources
    assert sources <= {"measured", "barometric", "relaxed", "standard"}


def own_columns(count):
    """Columns of a user, of every type, some of them called like columns of the results."""
    number = np.arange(count)
    second = pd.date_range("2025-06-01", periods=count, freq="s", tz="UTC", unit="us")
    return {
        "row": pa.array(number),
        "zulu": pa.array([f"text {i}" for i in number]),
        "status": pa.array(number % 3, pa.int8()),
        "big": pa.array(2**60 + number),
        "seen": pa.array(second),
        "flag": pa.array(number % 2 == 0),
        "holes": pa.array(number / 7, mask=number % 5 == 0),
        "list": pa.array([[i, i + 1] for i in number]),
        "code": pa.array(["abcd"[i % 4] for i in number]).dictionary_encode(),
        "r_c_rad_input": pa.array(["taken"] * count),
        "r_c_rad": pa.array(["mine"] * count),
    }


RENAMED = {"status": "status_input", "r_c_rad": "r_c_rad_input_input"}
"""Columns of the user, and their names in the results."""


def test_rows_and_columns_of_the_user_pass_through_batches(mission, baseline):
    table = mission.measured_often(45)
    count = table.num_rows
    assert count > 2500
    order = np.random.default_rng(3).permutation(count)
    table = table.take(pa.array(order))
    columns = own_columns(count)
    for name, values in columns.items():
        table = table.append_column(name, values)
    pq.write_table(table, mission.folder / "own.parquet", row_group_size=777)
    mission.config["observations"]["path"] = "own.parquet"
    mission.config["output"]["batch_rows"] = 1000

    manifest = mission.run_to_manifest()

    parts = sorted((mission.output / "observations").iterdir())
    sizes = [pq.read_metadata(part).num_rows for part in parts]
    assert sizes == [1000, 1000, count - 2000]
    result = mission.results()
    names = [RENAMED.get(name, name) for name in columns]
    assert result.schema.names == [*baseline.results().schema.names, *names]
    for name, values in columns.items():
        passed = result[RENAMED.get(name, name)]
        assert passed.to_pylist() == values.to_pylist(), name
        if name != "code":
            assert passed.type == values.type
    renamed = [entry for entry in manifest["ledger"] if entry["code"] == "OBS-RENAMED"]
    assert len(renamed) == 2
    # The correction of a row does not depend on its batch.
    once = baseline.result_rows().set_index(["image", "point"])
    often = result.to_pandas()
    often["point"] = often["point"].str.rpartition("-")[0]
    rows_of_once = pd.MultiIndex.from_frame(often[["image", "point"]])
    expected = once[CORRECTED_PX].reindex(rows_of_once)
    assert_allclose(often[CORRECTED_PX], expected, atol=1e-9, rtol=0)


# ---- bytes, and a second run


def test_manifest_knows_inputs_and_outputs_but_not_where_or_when(baseline):
    text = (baseline.output / "manifest.json").read_text("utf-8")
    manifest = json.loads(text)
    for item in manifest["inputs"]:
        content = (baseline.folder / item["name"]).read_bytes()
        assert item["sha256"] == hashlib.sha256(content).hexdigest()
    assert {item["role"] for item in manifest["inputs"]} == {"log", "observations"}
    outputs = {item["name"]: item["sha256"] for item in manifest["outputs"]}
    written = hashes_in(baseline.output)
    del written["manifest.json"]
    assert outputs == written
    assert manifest["config"]["cameras"]["nadir"]["calibration"] == "laboratory"
    assert manifest["observations"]["rows"] == baseline.measurements().num_rows
    assert str(baseline.folder) not in text
    # As a word: a host called vm is not meant by "llvmlite".
    host = re.escape(socket.gethostname())
    assert not re.search(rf"\b{host}\b", text)
    today = datetime.datetime.now(datetime.UTC).date()
    assert str(today) not in text
    report = (baseline.output / "report.html").read_text("utf-8")
    assert str(baseline.folder) not in report


@pytest.mark.usefixtures("whole_report", "settled_inputs")
def test_same_inputs_elsewhere_give_the_same_bytes(baseline, mission_factory, tmp_path):
    other = mission_factory(tmp_path / "Données Ω" / "a longer path")
    assert other.run_to_manifest() == baseline.manifest()
    assert hashes_in(other.output) == hashes_in(baseline.output)


def test_pages_carry_checksums(baseline, tmp_path):
    damaged = tmp_path / "damaged.parquet"
    shutil.copy(baseline.output / PART, damaged)
    chunk = pq.read_metadata(damaged).row_group(0).column(4)
    assert chunk.path_in_schema == "x_corrected_px"
    flip(damaged, chunk.data_page_offset + chunk.total_compressed_size // 2)
    with pytest.raises(OSError, match=r"CRC|checksum"):
        pq.read_table(damaged, page_checksum_verification=True)


def changes_of_entries(folder):
    """When each file and folder was changed, but for the lock."""
    changes = {}
    for path in folder.rglob("*"):
        if path.name != ".lock":
            changes[str(path.relative_to(folder))] = path.stat().st_mtime_ns
    return changes


@pytest.mark.usefixtures("settled_inputs")
def test_a_second_run_does_nothing_and_a_forced_one_mends_what_verify_finds(mission, unbend):
    """Both repeat the code of the first."""
    table = mission.measurements()
    names = ["nowhere", *table["image"].to_pylist()[1:]]
    mission.observe(table.set_column(0, "image", pa.array(names)))
    first = mission.run()
    assert first.code == 3, first.text
    assert "nothing to do" not in first.out
    hashes = hashes_in(mission.output)
    changes = changes_of_entries(mission.output)

    second = mission.run()
    assert second.code == 3
    assert "nothing to do" in second.out
    assert changes_of_entries(mission.output) == changes

    flip(mission.output / PART, 100)
    assert unbend("verify", mission.output).code == 5
    forced = mission.run("--force")
    assert forced.code == 3
    assert "nothing to do" not in forced.out
    assert hashes_in(mission.output) == hashes
    assert changes_of_entries(mission.output) != changes
    assert unbend("verify", mission.output).code == 0


def test_other_times_and_a_remark_change_nothing(mission, unbend):
    """What does is in `batch/test_differences.py`."""
    mission.run_to_manifest()
    mission.file.touch()
    mission.log.touch()
    assert "nothing to do" in mission.run().out
    mission.file.write_text("# a remark\n" + mission.file.read_text())
    assert "nothing to do" in unbend("run", mission.file).out


# ---- damage


def cut(path):
    path.write_bytes(path.read_bytes()[:-1])


def add_a_part(path):
    shutil.copy(path.with_name("part-00000.parquet"), path)


def empty(path):
    path.write_text("")


def without_entries(path):
    path.write_text("{}")


@pytest.mark.parametrize(
    ("name", "harm", "code"),
    [
        (PART, flip_a_byte, "VERIFY-DAMAGED"),
        ("stations.parquet", flip_a_byte, "VERIFY-DAMAGED"),
        ("profile.parquet", cut, "VERIFY-DAMAGED"),
        ("report.html", flip_a_byte, "VERIFY-DAMAGED"),
        (PART, Path.unlink, "VERIFY-DAMAGED"),
        ("observations/part-00001.parquet", add_a_part, "VERIFY-DAMAGED"),
        ("manifest.json", Path.unlink, "VERIFY-NO-MANIFEST"),
        ("manifest.json", empty, "MANIFEST-UNREADABLE"),
        ("manifest.json", without_entries, "MANIFEST-UNREADABLE"),
    ],
)
def test_verify_finds_damage(baseline, tmp_path, unbend, name, harm, code):
    copy = tmp_path / "results"
    shutil.copytree(baseline.output, copy)
    assert "whole" in unbend("verify", copy).out

    harm(copy / name)
    ended = unbend("verify", copy)

    assert ended.code == 5
    assert "Traceback" not in ended.text
    assert ended.err.startswith(f"{code}: ")
    assert name in ended.err or "manifest" in ended.err


# ---- figures of the manifest


def test_the_departure_is_the_adjusted_minus_the_standard_temperature(baseline):
    level_m = baseline.station_rows()["h_msl_m"].median()
    table = profile_of(baseline)

    def at_the_cameras(name):
        return np.interp(level_m, table["h_m"], table[name])

    adjusted_k = at_the_cameras("temperature_k")
    departure_k = adjusted_k - at_the_cameras("standard_temperature_k")
    sigma_k = at_the_cameras("sigma_temperature_k")
    assert abs(departure_k) > 0.5
    profile = baseline.manifest()["profile"]
    assert profile["departure_at_cameras_k"] == approx(departure_k, abs=0.1)
    assert profile["sigma_departure_at_cameras_k"] == approx(sigma_k, rel=0.2)


@pytest.fixture
def rows_of_camera(baseline, camera):
    stations = baseline.station_rows().set_index("image")
    rows = baseline.result_rows().join(stations["camera"], on="image")
    return rows[rows["camera"] == camera]


def assert_sizes(shift_px, shift):
    """The quantiles of a manifest are those of the corrections; their sizes [px]."""
    size_px = np.linalg.norm(shift, axis=1)
    assert shift_px["median"] == approx(np.median(size_px), rel=0.1)
    assert shift_px["p95"] == approx(np.percentile(size_px, 95.0), rel=0.1)
    return size_px


def shift_of(rows):
    return rows[CORRECTED_PX].to_numpy() - rows[MEASURED_PX]


@pytest.mark.parametrize("camera", ["nadir", "oblique"])
def test_the_manifest_has_the_sizes_of_the_corrections(baseline, rows_of_camera, camera):
    shift = shift_of(rows_of_camera)
    correction = baseline.manifest()["correction"]["cameras"][camera]
    size_px = assert_sizes(correction["shift_px"], shift)
    bins = correction["histogram_px"]
    counts = bins["counts"]
    in_steps = size_px / bins["step"]
    counted, _ = np.histogram(in_steps, np.arange(len(counts) + 1))
    # Edges are good to 0.25 %: a size that is nearer to one may be counted in either bin.
    at_an_edge = np.abs(in_steps - np.round(in_steps)) < 0.0025 * in_steps
    assert at_an_edge.mean() < 0.3
    assert np.abs(counted - counts).sum() <= 2 * at_an_edge.sum()
    counts_m = correction["histogram_m"]["counts"]
    assert sum(counts) == sum(counts_m) == len(rows_of_camera)
    field = correction["field"]
    size_of_field_px = np.hypot(field["dx_px"], field["dy_px"])
    assert size_of_field_px.max() <= size_px.max() * 1.001
    medians = [np.median(field["dx_px"]), np.median(field["dy_px"])]
    assert np.sign(medians).tolist() == np.sign(shift.median()).tolist()


@pytest.mark.parametrize("camera", ["nadir", "oblique"])
def test_the_manifest_has_the_sigmas_of_the_corrections(baseline, rows_of_camera, camera):
    manifest = baseline.manifest()
    correction = manifest["correction"]["cameras"][camera]
    # Sigmas are as large on the ground, beside the shift there, as in the image, beside the shift.
    metres_per_px = correction["shift_ground_m"]["median"] / correction["shift_px"]["median"]
    budget = manifest["sigma_budget"][camera]
    variance = 0.0
    for part in ("air", "station", "cabin"):
        sigma_x = rows_of_camera[f"sigma_{part}_dx_px"]
        sigma_y = rows_of_camera[f"sigma_{part}_dy_px"]
        sigma = np.hypot(sigma_x, sigma_y)
        variance = variance + sigma**2
        px = budget[part]["px"]
        assert px["median"] == approx(sigma.median(), rel=0.1), part
        assert px["p95"] == approx(sigma.quantile(0.95), rel=0.1), part
        median_m = budget[part]["m"]["median"]
        assert median_m / px["median"] == approx(metres_per_px, rel=0.35)
    together = np.sqrt(variance)
    assert budget["all"]["px"]["median"] == approx(together.median(), rel=0.1)
    assert "ground" not in budget  # no sigma of the ground is known


def test_the_manifest_has_the_heights_of_the_ground(baseline):
    h_g_m = baseline.results()["h_g_m"].to_numpy()
    ground = baseline.manifest()["ground_heights"]
    assert ground["lowest_m"] == approx(h_g_m.min(), abs=0.5)
    assert ground["median_m"] == approx(np.median(h_g_m), abs=0.5)
    assert ground["highest_m"] == approx(h_g_m.max(), abs=0.5)
    assert sum(ground["histogram"]["counts"]) == h_g_m.size


CENTRE_PX = (7000.0, 5300.0)


def test_the_manifest_has_the_flight_and_where_its_cameras_look(baseline):
    manifest = baseline.manifest()
    stations = baseline.station_rows()
    flight = manifest["flight"]
    times = stations["time_utc"]
    assert flight["begin_utc"] == f"{times.min():%Y-%m-%dT%H:%M:%SZ}"
    assert flight["end_utc"] == f"{times.max():%Y-%m-%dT%H:%M:%SZ}"
    assert flight["h_msl_m"][1] == approx(stations["h_msl_m"].median(), abs=0.1)
    # One looks down within 2 degrees: 700 px; the other 45 degrees to its side: 20,000 px.
    nadir = flight["cameras"]["nadir"]
    oblique = flight["cameras"]["oblique"]
    assert np.linalg.norm(np.subtract(nadir["nadir_px"], CENTRE_PX)) < 1000.0
    assert nadir["axis_nadir_angle_deg"] < 3.0
    of_nadir = baseline.config["cameras"]["nadir"]
    assert nadir["principal_point_px"] == [of_nadir["cx_px"], of_nadir["cy_px"]]
    assert oblique["axis_nadir_angle_deg"] == approx(45.0, abs=2.0)
    to_nadir = np.subtract(oblique["nadir_px"], CENTRE_PX)
    assert np.linalg.norm(to_nadir) == approx(20_000.0, rel=0.1)
    # Refraction lets points appear farther from the nadir: the correction is towards it.
    field = manifest["correction"]["cameras"]["oblique"]["field"]
    shift = [np.median(field["dx_px"]), np.median(field["dy_px"])]
    assert np.dot(to_nadir, shift) > 0.0
    lowest_m, median_m, *_ = nadir["height_above_ground_m"]
    assert lowest_m <= median_m
