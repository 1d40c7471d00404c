"""What a run leaves behind: columns, rows, marks, bytes; and what a second run does."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import re
import shutil
import socket

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

OBSERVATIONS = {
    "image": "string",
    "point": "string",
    "x_px": "double",
    "y_px": "double",
    "x_corrected_px": "double",
    "y_corrected_px": "double",
    "zeta_c_rad": "double",
    "r_c_rad": "double",
    "r_cc_rad": "double",
    "sigma_r_c_rad": "double",
    "sigma_air_dx_px": "float",
    "sigma_air_dy_px": "float",
    "sigma_station_dx_px": "float",
    "sigma_station_dy_px": "float",
    "sigma_ground_dx_px": "float",
    "sigma_ground_dy_px": "float",
    "sigma_r_cc_rad": "float",
    "sigma_cabin_dx_px": "float",
    "sigma_cabin_dy_px": "float",
    "dx_ds_px": "float",
    "dy_ds_px": "float",
    "dx_dncc_px": "float",
    "dy_dncc_px": "float",
    "h_g_m": "double",
    "status": "string",
}
STATIONS = {
    "image": "string",
    "camera": "string",
    "profile_id": "string",
    "time_utc": "timestamp[ns, tz=UTC]",
    "lat_deg": "double",
    "lon_deg": "double",
    "h_msl_m": "double",
    "h_ellipsoid_m": "double",
    "q_w": "double",
    "q_x": "double",
    "q_y": "double",
    "q_z": "double",
    "aircraft_q_w": "double",
    "aircraft_q_x": "double",
    "aircraft_q_y": "double",
    "aircraft_q_z": "double",
    "pressure_pa": "double",
    "temperature_k": "double",
    "vapour_pressure_pa": "double",
    "cabin_pressure_pa": "double",
    "cabin_temperature_k": "double",
    "cabin_vapour_pressure_pa": "double",
    "sigma_cabin_pressure_pa": "double",
    "sigma_cabin_temperature_k": "double",
    "sigma_horizontal_m": "double",
    "sigma_height_m": "double",
    "sigma_tilt_deg": "double",
    "sigma_yaw_deg": "double",
    "suspect_reason": "string",
    "suspect_m": "double",
    "status": "string",
    "geometry": "binary",
}
PROFILE = {
    "profile_id",
    "time_utc",
    "h_m",
    "geopotential_m",
    "temperature_k",
    "pressure_pa",
    "vapour_pressure_pa",
    "refractivity",
    "layer",
    "equation",
    "h_base_m",
    "t_base_k",
    "p_base_pa",
    "lapse_k_per_m",
    "source",
    "standard_temperature_k",
    "standard_pressure_pa",
    "sigma_temperature_k",
    "sigma_refractivity",
}


def tree(folder) -> dict[str, str]:
    """Name -> hash of every file that can be seen."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and not p.name.startswith(".")
    }


def types_of(schema: pa.Schema) -> dict[str, str]:
    return {field.name: str(field.type) for field in schema}


def test_folder_holds_what_it_should_and_nothing_else(baseline):
    names = {p.name for p in baseline.output.iterdir()}
    assert names == {
        ".lock",
        "observations",
        "stations.parquet",
        "profile.parquet",
        "manifest.json",
        "report.html",
    }
    assert set(tree(baseline.output)) == {
        "observations/part-00000.parquet",
        "stations.parquet",
        "profile.parquet",
        "manifest.json",
        "report.html",
    }


def test_observation_columns(baseline):
    schema = baseline.results().schema
    given = baseline.measurements()
    assert types_of(schema) == OBSERVATIONS | {"quality": "int32"}
    assert schema.names == [*OBSERVATIONS, "quality"]
    assert schema.metadata[b"unbend.refraction"] == b"removed"
    conventions = json.loads(schema.metadata[b"unbend.conventions"])
    assert {"pixels", "camera", "frame", "signs"} <= set(conventions)
    assert schema.field("x_corrected_px").metadata[b"unit"] == b"px"
    assert schema.field("r_c_rad").metadata[b"unit"] == b"rad"
    assert schema.field("h_g_m").metadata[b"unit"] == b"m"
    result = baseline.results()
    for name in ("image", "point", "x_px", "y_px", "h_g_m", "quality"):
        assert result[name].equals(given[name]), name
    assert set(result["status"].to_pylist()) == {"ok"}


def test_station_columns(baseline):
    table = baseline.stations()
    assert types_of(table.schema) == STATIONS
    assert table.schema.names == list(STATIONS)
    assert table.num_rows == 6
    assert sorted(table["camera"].to_pylist()) == ["nadir"] * 3 + ["oblique"] * 3
    assert set(table["status"].to_pylist()) == {"ok"}
    q = np.stack([table[f"q_{k}"].to_numpy() for k in "wxyz"])
    np.testing.assert_allclose(np.linalg.norm(q, axis=0), 1.0, atol=1e-12)
    assert (q[0] >= 0.0).all()


def test_every_pressure_of_the_profile_recomputes_from_its_row(baseline):
    table = pq.read_table(baseline.output / "profile.parquet")
    assert set(table.schema.names) >= PROFILE
    meta = {k.decode(): v.decode() for k, v in table.schema.metadata.items()}
    g_phi = float(meta["g_phi"])
    r_phi = float(meta["r_phi"])
    assert 46.0 < float(meta["latitude"]) < 48.0
    assert g_phi == pytest.approx(9.80665, abs=0.03)
    assert r_phi == pytest.approx(6.36e6, rel=0.01)
    c = {name: table[name].to_numpy() for name in table.schema.names if name != "time_utc"}
    # Geopotential metres carry G = 9.80665; the constant of Eq. 52 and 53 is G M0 / R*.
    constant = 9.80665 * 28.9644 / 8314.32
    geopotential = r_phi * c["h_m"] * g_phi / ((r_phi + c["h_m"]) * 9.80665)
    np.testing.assert_allclose(c["geopotential_m"], geopotential, atol=1e-6)
    base = r_phi * c["h_base_m"] * g_phi / ((r_phi + c["h_base_m"]) * 9.80665)
    rise = geopotential - base
    gradient = c["equation"] == 52
    assert gradient.any()
    lapse = np.where(gradient, c["lapse_k_per_m"], 1.0)
    eq52 = c["p_base_pa"] * (c["t_base_k"] / (c["t_base_k"] + lapse * rise)) ** (constant / lapse)
    eq53 = c["p_base_pa"] * np.exp(-constant * rise / c["t_base_k"])
    np.testing.assert_allclose(c["pressure_pa"], np.where(gradient, eq52, eq53), rtol=1e-9)
    assert set(c["source"]) <= {"measured", "barometric", "relaxed", "standard"}
    assert "measured" in set(c["source"])


def test_manifest_knows_inputs_and_outputs_but_not_where_or_when(baseline):
    text = (baseline.output / "manifest.json").read_text(encoding="utf-8")
    manifest = json.loads(text)
    for item in manifest["inputs"]:
        content = (baseline.folder / item["name"]).read_bytes()
        assert item["sha256"] == hashlib.sha256(content).hexdigest()
    assert {item["role"] for item in manifest["inputs"]} == {"log", "observations"}
    made = {k: v for k, v in tree(baseline.output).items() if k != "manifest.json"}
    assert {item["name"]: item["sha256"] for item in manifest["outputs"]} == made
    assert manifest["config"]["cameras"]["nadir"]["calibration"] == "laboratory"
    assert manifest["observations"]["rows"] == baseline.measurements().num_rows
    assert str(baseline.folder) not in text
    # As a word: a host called vm is not meant by "llvmlite".
    assert not re.search(rf"\b{re.escape(socket.gethostname())}\b", text)
    assert str(dt.datetime.now(dt.UTC).date()) not in text
    report = (baseline.output / "report.html").read_text(encoding="utf-8")
    assert str(baseline.folder) not in report


def test_same_inputs_elsewhere_give_the_same_bytes(
    baseline, mission_factory, tmp_path, whole_report
):
    other = mission_factory(tmp_path / "quite" / "another place")
    assert other.run().code == 0
    manifests = [
        json.loads((folder.output / "manifest.json").read_text(encoding="utf-8"))
        for folder in (other, baseline)
    ]
    assert manifests[0] == manifests[1]
    assert tree(other.output) == tree(baseline.output)


def test_pages_carry_checksums(baseline):
    part = baseline.output / "observations" / "part-00000.parquet"
    content = bytearray(part.read_bytes())
    chunk = pq.ParquetFile(part).metadata.row_group(0).column(4)
    assert chunk.path_in_schema == "x_corrected_px"
    content[chunk.data_page_offset + chunk.total_compressed_size // 2] ^= 1
    with pytest.raises(OSError, match=r"CRC|checksum"):
        pq.ParquetFile(pa.BufferReader(bytes(content)), page_checksum_verification=True).read()


def own_columns(n: int) -> dict[str, pa.Array]:
    start = dt.datetime(2025, 6, 1, tzinfo=dt.UTC)
    return {
        "zulu": pa.array([f"text {i}" for i in range(n)]),
        "status": pa.array([i % 3 for i in range(n)], pa.int8()),
        "big": pa.array([2**60 + i for i in range(n)], pa.int64()),
        "seen": pa.array(
            [start + dt.timedelta(seconds=i) for i in range(n)], pa.timestamp("us", "UTC")
        ),
        "flag": pa.array([i % 2 == 0 for i in range(n)]),
        "holes": pa.array([None if i % 5 == 0 else i / 7 for i in range(n)]),
        "list": pa.array([[i, i + 1] for i in range(n)]),
        "code": pa.array(["a", "b", "c", "d"])
        .take(pa.array([i % 4 for i in range(n)]))
        .dictionary_encode(),
        "r_c_rad_input": pa.array(["taken"] * n),
        "r_c_rad": pa.array(["mine"] * n),
    }


def many_rows(mission, copies: int) -> pa.Table:
    """The observations over and over, numbered, in an order of their own."""
    table = mission.measured_often(copies)
    order = np.random.default_rng(3).permutation(table.num_rows)
    return table.take(pa.array(order)).append_column("row", pa.array(np.arange(table.num_rows)))


@pytest.mark.usefixtures("plain_report")
def test_rows_and_columns_of_the_user_pass_through_batches(mission, baseline):
    table = many_rows(mission, 45)
    n = table.num_rows
    assert n > 2500
    for name, values in own_columns(n).items():
        table = table.append_column(name, values)
    pq.write_table(table, mission.folder / "own.parquet", row_group_size=777)
    mission.config["observations"]["path"] = "own.parquet"
    mission.config["output"]["batch_rows"] = 1000
    ended = mission.run()
    assert ended.code == 0, ended.text
    parts = sorted((mission.output / "observations").iterdir())
    sizes = [pq.ParquetFile(part).metadata.num_rows for part in parts]
    assert sizes == [1000, 1000, n - 2000]
    result = mission.results()
    assert result.schema.names == [
        *OBSERVATIONS,
        "quality",
        "row",
        "zulu",
        "status_input",
        "big",
        "seen",
        "flag",
        "holes",
        "list",
        "code",
        "r_c_rad_input",
        "r_c_rad_input_input",
    ]
    assert result["row"].to_pylist() == list(range(n))
    for name in ("image", "x_px", "zulu", "big", "seen", "flag", "holes", "list"):
        assert result[name].to_pylist() == table[name].to_pylist(), name
        assert result.schema.field(name).type == table.schema.field(name).type
    assert result["status_input"].to_pylist() == table["status"].to_pylist()
    assert result["code"].to_pylist() == table["code"].to_pylist()
    assert result["r_c_rad_input"].to_pylist() == ["taken"] * n
    assert result["r_c_rad_input_input"].to_pylist() == ["mine"] * n
    manifest = json.loads((mission.output / "manifest.json").read_text(encoding="utf-8"))
    renamed = [e["what"] for e in manifest["ledger"] if e["code"] == "OBS-RENAMED"]
    assert len(renamed) == 2
    # What became of a row does not depend on the batch it came in.
    key = {
        (i, p): (x, y)
        for i, p, x, y in zip(
            *(
                baseline.results()[c].to_pylist()
                for c in ("image", "point", "x_corrected_px", "y_corrected_px")
            ),
            strict=True,
        )
    }
    want = [
        key[i, p.rsplit("-", 1)[0]]
        for i, p in zip(table["image"].to_pylist(), table["point"].to_pylist(), strict=True)
    ]
    got = np.stack([result["x_corrected_px"].to_numpy(), result["y_corrected_px"].to_numpy()], 1)
    np.testing.assert_allclose(got, np.array(want), atol=1e-9, rtol=0)


def test_a_second_run_does_nothing_and_repeats_the_code(mission):
    mission.observe(
        mission.measurements().set_column(
            0, "image", pa.array(["nowhere", *mission.measurements()["image"].to_pylist()[1:]])
        )
    )
    first = mission.run()
    assert first.code == 3, first.text
    before = tree(mission.output)
    stamps = {p: p.stat().st_mtime_ns for p in mission.output.iterdir() if p.name != ".lock"}
    second = mission.run()
    assert second.code == 3
    assert "nothing to do" in second.out
    assert "nothing to do" not in first.out
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps
    forced = mission.run("--force")
    assert forced.code == 3
    assert "nothing to do" not in forced.out
    assert tree(mission.output) == before
    assert {p: p.stat().st_mtime_ns for p in stamps} != stamps


@pytest.mark.usefixtures("plain_report")
def test_a_run_is_repeated_when_and_only_when_something_changed(mission):
    assert mission.run().code == 0
    before = tree(mission.output)
    mission.file.touch()
    mission.log.touch()
    assert "nothing to do" in mission.run().out
    mission.file.write_text("# a remark\n" + mission.file.read_text())
    assert "nothing to do" in mission.run().out
    mission.config["atmosphere"]["co2_ppm"] = 451.0
    ended = mission.run()
    assert "nothing to do" not in ended.out
    assert tree(mission.output) != before
    with mission.log.open("r+b") as log:
        log.seek(-3, 2)
        byte = log.read(1)
        log.seek(-3, 2)
        log.write(bytes([byte[0] ^ 1]))
    assert "nothing to do" not in mission.run().out
    (mission.output / "stations.parquet").unlink()
    assert "nothing to do" not in mission.run().out
    (mission.output / "manifest.json").unlink()
    assert "nothing to do" not in mission.run().out


@pytest.mark.usefixtures("plain_report")
def test_fewer_parts_leave_none_of_the_old_ones(mission):
    mission.observe(many_rows(mission, 20))
    mission.config["output"]["batch_rows"] = 1000
    assert mission.run().code == 0
    assert len(list((mission.output / "observations").iterdir())) == 2
    mission.config["output"]["batch_rows"] = 100_000
    mission.config["ground"]["sigma_m"] = 1.5
    assert mission.run().code == 0
    assert len(list((mission.output / "observations").iterdir())) == 1


@pytest.mark.parametrize(
    ("name", "harm", "code"),
    [
        ("observations/part-00000.parquet", "flip", "VERIFY-DAMAGED"),
        ("stations.parquet", "flip", "VERIFY-DAMAGED"),
        ("profile.parquet", "cut", "VERIFY-DAMAGED"),
        ("report.html", "flip", "VERIFY-DAMAGED"),
        ("observations/part-00000.parquet", "remove", "VERIFY-DAMAGED"),
        ("observations/part-00001.parquet", "add", "VERIFY-DAMAGED"),
        ("manifest.json", "remove", "VERIFY-NO-MANIFEST"),
        ("manifest.json", "empty", "MANIFEST-UNREADABLE"),
        ("manifest.json", "foreign", "MANIFEST-UNREADABLE"),
    ],
)
def test_verify_finds_damage(baseline, tmp_path, unbend, name, harm, code):
    copy = tmp_path / "results"
    shutil.copytree(baseline.output, copy)
    whole = unbend("verify", copy)
    assert whole.code == 0
    assert "whole" in whole.out
    file = copy / name
    if harm == "flip":
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 4
        file.write_bytes(content)
    elif harm == "cut":
        file.write_bytes(file.read_bytes()[:-1])
    elif harm == "remove":
        file.unlink()
    elif harm == "add":
        shutil.copy(copy / "observations/part-00000.parquet", file)
    else:
        file.write_text("" if harm == "empty" else "{}")
    ended = unbend("verify", copy)
    assert ended.code == 5
    assert "Traceback" not in ended.text
    assert ended.err.startswith(f"{code}: ")
    assert name in ended.err or "manifest" in ended.err


def test_a_run_mends_what_verify_finds(mission, unbend):
    assert mission.run().code == 0
    before = tree(mission.output)
    part = mission.output / "observations" / "part-00000.parquet"
    content = bytearray(part.read_bytes())
    content[100] ^= 1
    part.write_bytes(content)
    assert unbend("verify", mission.output).code == 5
    assert mission.run("--force").code == 0
    assert tree(mission.output) == before
    assert unbend("verify", mission.output).code == 0


def test_the_departure_is_the_adjusted_minus_the_standard_temperature(baseline):
    manifest = json.loads((baseline.output / "manifest.json").read_text(encoding="utf-8"))
    level = baseline.stations().to_pandas()["h_msl_m"].median()
    table = pq.read_table(baseline.output / "profile.parquet").to_pandas()
    ours, standard = (
        np.interp(level, table["h_m"], table[f"{name}temperature_k"]) for name in ("", "standard_")
    )
    assert abs(ours - standard) > 0.5
    assert manifest["profile"]["departure_at_cameras_k"] == pytest.approx(ours - standard, abs=0.1)
    sigma = np.interp(level, table["h_m"], table["sigma_temperature_k"])
    assert manifest["profile"]["sigma_departure_at_cameras_k"] == pytest.approx(sigma, rel=0.2)


def test_the_manifest_has_the_numbers_of_the_figures(baseline):
    """Sigma budget, ground heights, histograms, field and nadir points, from the tables alone."""
    manifest = json.loads((baseline.output / "manifest.json").read_text(encoding="utf-8"))
    stations = baseline.stations().to_pandas().set_index("image")
    rows = baseline.results().to_pandas().join(stations[["camera"]], on="image")
    ground = manifest["ground_heights"]
    limits = rows["h_g_m"].agg(["min", "median", "max"])
    found = [ground[key] for key in ("lowest_m", "median_m", "highest_m")]
    assert found == pytest.approx(list(limits), abs=0.5)
    edges = ground["histogram"]["first_m"] + ground["histogram"]["step"] * np.arange(
        len(ground["histogram"]["counts"]) + 1
    )
    assert ground["histogram"]["counts"] == np.histogram(rows["h_g_m"], edges)[0].tolist()
    for name, of in rows.groupby("camera"):
        sizes = manifest["correction"]["cameras"][name]
        shift = np.stack([of["x_corrected_px"] - of["x_px"], of["y_corrected_px"] - of["y_px"]])
        size = np.hypot(*shift)
        bins = sizes["histogram_px"]
        assert sum(bins["counts"]) == sum(sizes["histogram_m"]["counts"]) == len(of)
        in_steps = size / bins["step"]
        counted = np.histogram(in_steps, np.arange(len(bins["counts"]) + 1))[0]
        # Edges are good to 0.25 %: a size that is nearer to one may be counted in either bin.
        at_an_edge = np.abs(in_steps - np.round(in_steps)) < 0.0025 * in_steps
        assert np.abs(counted - bins["counts"]).sum() <= 2 * at_an_edge.sum()
        assert at_an_edge.mean() < 0.3
        budget = manifest["sigma_budget"][name]
        together = np.zeros(len(of))
        for part in ("air", "station", "cabin"):
            sigma = np.hypot(of[f"sigma_{part}_dx_px"], of[f"sigma_{part}_dy_px"])
            together += sigma**2
            px = budget[part]["px"]
            metres = budget[part]["m"]
            assert sigma.sort_values().iloc[(len(of) - 1) // 2] <= px["median"] * 1.001
            assert px["median"] <= sigma.sort_values().iloc[(len(of) + 1) // 2] * 1.001
            assert px["median"] <= px["p95"] <= sigma.max() * 1.001
            # As large on the ground, beside the shift there, as in the image, beside the shift.
            scale = sizes["shift_ground_m"]["median"] / sizes["shift_px"]["median"]
            assert metres["median"] / px["median"] == pytest.approx(scale, rel=0.35)
        assert budget["all"]["px"]["median"] == pytest.approx(np.median(np.sqrt(together)), rel=0.1)
        assert "ground" not in budget  # no sigma of the ground is known
        field = sizes["field"]
        assert np.max(np.hypot(field["dx_px"], field["dy_px"])) <= size.max() * 1.001
        toward = np.sign(np.median(shift, axis=1))
        assert np.sign(
            np.median([field["dx_px"], field["dy_px"]], axis=1)
        ).tolist() == pytest.approx(toward)
    flight = manifest["flight"]
    time = stations["time_utc"].agg(["min", "max"])
    assert [flight["begin_utc"], flight["end_utc"]] == [f"{t:%Y-%m-%dT%H:%M:%SZ}" for t in time]
    # The camera looks down within 2 degrees: 700 px; the other 45 degrees to its side: 20,000 px.
    nadir, oblique = (flight["cameras"][name] for name in ("nadir", "oblique"))
    assert np.hypot(nadir["nadir_px"][0] - 7000.0, nadir["nadir_px"][1] - 5300.0) < 1000.0
    assert nadir["axis_nadir_angle_deg"] < 3.0
    assert oblique["axis_nadir_angle_deg"] == pytest.approx(45.0, abs=2.0)
    off = oblique["nadir_px"][0] - 7000.0, oblique["nadir_px"][1] - 5300.0
    assert np.hypot(*off) == pytest.approx(20_000.0, rel=0.1)
    # Refraction lets points appear farther from the nadir: the correction is towards it.
    field = manifest["correction"]["cameras"]["oblique"]["field"]
    assert np.dot(off, [np.median(field["dx_px"]), np.median(field["dy_px"])]) > 0.0
    assert flight["h_msl_m"][1] == pytest.approx(stations["h_msl_m"].median(), abs=0.1)
    assert nadir["height_above_ground_m"][0] <= nadir["height_above_ground_m"][1]
