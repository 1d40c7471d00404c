"""What leaves for other programs: the run as it was, on a grid and by nadir angle."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch.finished_run.export import export_run, rebuild_run
from unbend.batch.finished_run.read_back import profile_of, stations_of
from unbend.batch.results import read_manifest
from unbend.batch.runs import read_mission
from unbend.flight.stations import NO_TIME, Stations
from unbend.messages import Ledger
from unbend.tables.exports import FORMATS
from unbend.tables.exports.format import write_csv_stream
from unbend.tables.writing import PROFILE_ID, table_of_profile, table_of_stations

COLUMNS = ["image", "x_px", "y_px", "dx_px", "dy_px", "h_g_m", "status"]


@pytest.fixture
def export(unbend, tmp_path):
    """Exports a run to a file of the test's own; the file and how it ended."""

    def make(run: Path, name: str, *options: object):
        out = tmp_path / ("out.csv" if name.endswith("csv") else "out.parquet")
        return out, unbend("export", run, "--format", name, "--out", out, *options)

    return make


@pytest.fixture
def copied(baseline, tmp_path) -> Path:
    """The results of the mission, which a test may spoil."""
    return Path(shutil.copytree(baseline.output, tmp_path / "run"))


def rewrite(run: Path, name: str, change) -> None:
    """Change a table of a run, and the manifest with it, as another program version might."""
    table = change(pq.read_table(run / name))
    pq.write_table(table, run / name)
    manifest = json.loads((run / "manifest.json").read_text())
    for item in manifest["outputs"]:
        if item["name"] == name:
            content = (run / name).read_bytes()
            item |= {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    (run / "manifest.json").write_text(json.dumps(manifest))


def change_manifest(run: Path, change) -> None:
    manifest = json.loads((run / "manifest.json").read_text())
    change(manifest)
    (run / "manifest.json").write_text(json.dumps(manifest))


def bilinear(grid: pd.DataFrame, x, y, column: str):
    """Interpolation as another program would do it."""
    xs = np.unique(grid["x_px"])
    ys = np.unique(grid["y_px"])
    values = grid[column].to_numpy().reshape(ys.size, xs.size)
    i = np.clip(np.searchsorted(xs, x) - 1, 0, xs.size - 2)
    j = np.clip(np.searchsorted(ys, y) - 1, 0, ys.size - 2)
    s = (x - xs[i]) / (xs[i + 1] - xs[i])
    t = (y - ys[j]) / (ys[j + 1] - ys[j])
    low = values[j, i] * (1 - s) + values[j, i + 1] * s
    high = values[j + 1, i] * (1 - s) + values[j + 1, i + 1] * s
    return low * (1 - t) + high * t


# -- the lattice --------------------------------------------------------------------------------


def test_the_lattice_has_its_columns_units_and_rows(baseline, export):
    out, ended = export(baseline.output, "lattice")
    assert ended.code == 0, ended.text
    table = pq.read_table(out)
    assert table.schema.names == COLUMNS
    images = baseline.stations()["image"].to_pylist()
    assert table.num_rows == len(images) * 21 * 15
    assert f"{table.num_rows:,} rows" in " ".join(ended.out.split())  # whatever the line length
    assert table.schema.field("dx_px").metadata[b"unit"] == b"px"
    assert table.schema.metadata[b"unbend.mission"] == baseline.config["mission"]["name"].encode()
    found = table.to_pandas()
    assert set(found["image"]) == set(images)
    assert set(found["status"]) == {"ok"}
    camera = baseline.config["cameras"]["nadir"]
    nadir = found[found["image"] == baseline.stations()["image"][0].as_py()]
    assert nadir["x_px"].agg(["min", "max"]).tolist() == [0.0, camera["width_px"]]
    assert nadir["y_px"].agg(["min", "max"]).tolist() == [0.0, camera["height_px"]]
    assert np.hypot(found["dx_px"], found["dy_px"]).max() > 0.3


def test_at_its_nodes_the_lattice_is_what_a_run_makes_of_them(mission, export):
    """The nodes measured as observations, over level ground, with pixels counted from (0, 0)."""
    mission.config["observations"]["pixel_origin"] = "centre"
    first = mission.measurements()
    images = sorted(set(first["image"].to_pylist()))
    camera = mission.config["cameras"]["nadir"]
    x = np.linspace(0.0, camera["width_px"], 5) - 0.5
    y = np.linspace(0.0, camera["height_px"], 4) - 0.5
    nodes = [(image, float(a), float(b)) for image in images for b in y for a in x]
    mission.observe(
        pa.table(
            {
                "image": [n[0] for n in nodes],
                "point": [str(i) for i in range(len(nodes))],
                "x_px": [n[1] for n in nodes],
                "y_px": [n[2] for n in nodes],
                "h_g_m": [321.0] * len(nodes),
            }
        )
    )
    assert mission.run().code == 0
    options = ("--columns", 5, "--rows", 4)
    out, ended = export(mission.output, "lattice", *options)
    assert ended.code == 0, ended.text
    grid = pq.read_table(out).to_pandas().set_index(["image", "x_px", "y_px"])
    run = mission.results().to_pandas().set_index(["image", "x_px", "y_px"])
    assert len(grid) == len(run)
    assert set(grid["h_g_m"]) == {321.0}
    there = grid.loc[run.index]
    moved = run.reset_index()
    dx = moved["x_corrected_px"] - moved["x_px"]
    dy = moved["y_corrected_px"] - moved["y_px"]
    assert np.abs(there["dx_px"].to_numpy() - dx).max() < 1e-9
    assert np.abs(there["dy_px"].to_numpy() - dy).max() < 1e-9


@pytest.mark.parametrize(("columns", "rows", "limit"), [(21, 15, 0.003), (11, 8, 0.010)])
def test_between_its_nodes_the_lattice_is_nearly_what_the_run_did(
    mission, export, columns, rows, limit
):
    """Over level ground, with the distortion, attitude, window and air of the sample mission."""
    mission.config["ground"]["height"] = 300.0
    ended = mission.run()  # tie points contradict one height for a hilly ground
    assert ended.code == 3
    assert "TIES-HEIGHT" in ended.out
    out, _ = export(mission.output, "lattice", "--columns", columns, "--rows", rows)
    grids = dict(list(pq.read_table(out).to_pandas().groupby("image")))
    run = mission.results().to_pandas()
    # 0.0026 px of 1.23 px with 21 x 15 nodes
    worst = 0.0
    largest = 0.0
    for image, points in run[run["status"] == "ok"].groupby("image"):
        x = points["x_px"].to_numpy()
        y = points["y_px"].to_numpy()
        dx = bilinear(grids[image], x, y, "dx_px") - (points["x_corrected_px"] - x)
        dy = bilinear(grids[image], x, y, "dy_px") - (points["y_corrected_px"] - y)
        worst = max(worst, np.hypot(dx, dy).max())
        shift = np.hypot(points["x_corrected_px"] - x, points["y_corrected_px"] - y)
        largest = max(largest, shift.max())
    assert worst < limit
    assert largest > 1.0


def test_the_ground_is_the_median_of_each_image(baseline, export):
    out, _ = export(baseline.output, "lattice", "--columns", 2, "--rows", 2)
    run = baseline.results().to_pandas()
    expected = {
        image: float(np.median(heights)) for image, heights in run.groupby("image")["h_g_m"]
    }
    found = pq.read_table(out).to_pandas().groupby("image")["h_g_m"].agg(["min", "max"])
    assert len(set(expected.values())) > 1
    for image, height in expected.items():
        assert found.loc[image].tolist() == [height, height]


def test_one_ground_height_for_all(baseline, export):
    out, _ = export(
        baseline.output, "lattice", "--columns", 2, "--rows", 2, "--ground-height", 123.5
    )
    assert set(pq.read_table(out)["h_g_m"].to_pylist()) == {123.5}


def test_csv_holds_the_same_numbers(baseline, export):
    _, ended = export(baseline.output, "lattice-csv", "--columns", 3, "--rows", 2)
    out, _ = export(baseline.output, "lattice", "--columns", 3, "--rows", 2)
    assert ended.code == 0
    text = out.with_suffix(".csv").read_text(encoding="utf-8")
    assert text.splitlines()[0] == ",".join(COLUMNS)
    rows = list(csv.DictReader(text.splitlines()))
    table = pq.read_table(out)
    assert [row["image"] for row in rows] == table["image"].to_pylist()
    for name in ("x_px", "dx_px", "dy_px", "h_g_m"):
        assert [float(row[name]) for row in rows] == table[name].to_pylist()


def test_images_without_observations_get_the_ground_of_the_others(mission, export):
    table = mission.measurements()
    alone = table["image"][0].as_py()
    mission.observe(table.filter(pa.compute.not_equal(table["image"], alone)))
    mission.run()
    out, ended = export(mission.output, "lattice", "--columns", 2, "--rows", 2)
    assert ended.code == 0
    assert "EXPORT-GROUND" in ended.out
    run = mission.results().to_pandas().groupby("image")["h_g_m"].median()
    found = pq.read_table(out).to_pandas()
    mine = found[found["image"] == alone]
    assert set(mine["h_g_m"]) == {float(np.median(run))}
    assert set(mine["status"]) == {"ok"}


def test_what_has_no_lattice_is_said(mission, export):
    table = mission.measurements()
    names = ["unknown.tif", *table["image"].to_pylist()[1:]]
    mission.observe(table.set_column(0, "image", pa.array(names)))
    assert mission.run().code == 3
    out, ended = export(mission.output, "lattice", "--columns", 2, "--rows", 2)
    assert ended.code == 3
    assert "EXPORT-LEFT-OUT: 1 image " in " ".join(ended.out.split())
    assert "unknown.tif" not in pq.read_table(out)["image"].to_pylist()


def test_a_run_without_ground_heights_says_so(mission, export):
    table = mission.measurements()
    at = table.schema.get_field_index("h_g_m")
    mission.observe(table.set_column(at, "h_g_m", pa.nulls(table.num_rows, pa.float64())))
    assert mission.run().code == 3
    out, ended = export(mission.output, "lattice", "--columns", 2, "--rows", 2)
    assert ended.code == 3
    assert "EXPORT-NO-GROUND" in ended.out
    found = pq.read_table(out)
    assert set(found["status"].to_pylist()) == {"no_ground"}
    assert found["dx_px"].null_count == found.num_rows
    _, given = export(mission.output, "lattice", "--ground-height", 300, "--force")
    assert given.code == 0


def test_a_dome_comes_back_from_the_manifest(mission, export):
    """The manifest states the defaults of a window, which nobody gave."""
    mission.config["cameras"]["nadir"]["window"] = {"shape": "spherical"}
    assert mission.run().code == 0
    assert export(mission.output, "lattice", "--columns", 2, "--rows", 2)[1].code == 0


# -- radial tables ------------------------------------------------------------------------------


def test_radial_tables_by_flying_height(baseline, export):
    out, ended = export(baseline.output, "radial")
    assert ended.code == 0
    assert "EXPORT-WINDOW" in ended.out
    found = pq.read_table(out).to_pandas()
    stations = baseline.stations().to_pandas()
    tables = found.groupby(["camera", "h_c_m"])
    per_camera = found.drop_duplicates(["camera", "h_c_m"]).groupby("camera")["images"].sum()
    assert per_camera.to_dict() == stations.groupby("camera").size().to_dict()
    for (camera, h_c), table in tables:
        mine = stations[stations["camera"] == camera]["h_msl_m"]
        assert mine.min() <= h_c <= mine.max()
        assert table["nadir_angle_deg"].tolist() == pytest.approx(range(81))
        assert table["r_c_arcsec"].is_monotonic_increasing
        at_45 = table[table["nadir_angle_deg"].round(9) == 45.0].iloc[0]
        assert at_45["r_c_urad"] == pytest.approx(at_45["k_urad"], rel=1e-9)
        focal = baseline.config["cameras"][camera]["fx_px"]
        assert at_45["radius_px"] == pytest.approx(focal, rel=1e-12)


def test_a_radial_table_agrees_with_the_observations(baseline, export):
    """R_c of the observations themselves, where the ground is within 20 m of the table's."""
    out, _ = export(baseline.output, "radial-csv")
    with out.open(encoding="utf-8") as file:
        table = pd.read_csv(file)
    run = baseline.results().to_pandas().merge(baseline.stations().to_pandas(), on="image")
    run = run[run["status_x"] == "ok"]
    for camera, mine in table.groupby("camera"):
        first = mine[mine["h_c_m"] == mine["h_c_m"].iloc[0]]
        points = run[run["camera"] == camera]
        level = np.abs(points["h_g_m"] - first["h_g_m"].iloc[0]) < 20.0
        assert level.sum() > 2
        points = points[level]
        r_c = np.interp(
            np.degrees(points["zeta_c_rad"]), first["nadir_angle_deg"], first["r_c_urad"]
        )
        assert r_c == pytest.approx(points["r_c_rad"] * 1e6, rel=0.02)


# -- what is read back --------------------------------------------------------------------------


def test_the_profile_comes_back(baseline):
    """Moist, adjusted: the refractivity, gravity and index of the run's own profile."""
    adjustment = read_mission(baseline.file).air.adjustment
    before = adjustment.profile
    after = profile_of(table_of_profile(adjustment, PROFILE_ID))
    h = np.linspace(before.bottom_m + 1.0, before.top_m - 1.0, 20_001)
    assert before.vapour_pressure(1000.0) > 100.0
    assert np.abs(after.refractivity(h) / before.refractivity(h) - 1.0).max() < 2e-15
    assert np.abs(after.temperature(h) / before.temperature(h) - 1.0).max() < 2e-15
    assert (after.index, after.gravity.g_phi) == (before.index, before.gravity.g_phi)
    assert after.layers.source == before.layers.source


def test_stations_come_back():
    nan = np.nan
    numbers = np.array([1.0, nan])
    before = Stations(
        image=np.array(["a", "b"], object),
        camera=np.array(["nadir", ""], object),
        time_ns=np.array([1_700_000_000_123_456_789, NO_TIME]),
        lat_rad=np.array([0.8, nan]),
        lon_rad=np.array([-3.1, nan]),
        h_msl_m=1e3 * numbers,
        h_ellipsoid_m=1.1e3 * numbers,
        quaternion=np.array([[0.5, -0.5, 0.5, 0.5], [nan] * 4]),
        aircraft_quaternion=np.array([[0.1, 0.7, -0.1, 0.7], [nan] * 4]),
        pressure_pa=9e4 * numbers,
        temperature_k=280.0 * numbers,
        vapour_pressure_pa=5e2 * numbers,
        cabin_pressure_pa=8e4 * numbers,
        cabin_temperature_k=294.0 * numbers,
        cabin_vapour_pressure_pa=4e2 * numbers,
        sigma_cabin_pressure_pa=300.0 * numbers,
        sigma_cabin_temperature_k=5.0 * numbers,
        sigma_horizontal_m=numbers,
        sigma_height_m=2.0 * numbers,
        sigma_tilt_rad=0.003 * numbers,
        sigma_yaw_rad=0.01 * numbers,
        suspect_reason=np.array(["a step of 77 m", ""], object),
        suspect_m=77.0 * numbers,
        accepted=np.array([True, False]),
        status=np.array(["suspect", "unmatched"], object),
    )
    table = table_of_stations(
        before, constant_series(TimedProfile(None, standard_atmosphere("us1976")), 2)
    )
    for axis, values in zip("wxyz", before.aircraft_quaternion.T, strict=True):
        name = f"aircraft_q_{axis}"
        if name not in table.schema.names:
            table = table.append_column(name, pa.array(values))
    after = stations_of(table)
    for name in Stations.__dataclass_fields__:
        was = getattr(before, name)
        is_now = getattr(after, name)
        assert was.dtype == is_now.dtype
        if name.endswith("_rad"):
            np.testing.assert_allclose(is_now, was, rtol=1e-15)
        else:
            np.testing.assert_array_equal(is_now, was)


# -- refusals -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("latice", "perhaps lattice"),
        ("photomod", "one of lattice, lattice-csv, radial"),
        ("colmap-text", "perhaps colmap or colmap-database"),
    ],
)
def test_an_unknown_format(baseline, export, name, remedy):
    _, ended = export(baseline.output, name)
    assert ended.code == 2
    assert ended.err.startswith("EXPORT-FORMAT: ")
    assert remedy in ended.err


def test_a_file_with_another_ending(baseline, unbend, tmp_path):
    out = tmp_path / "grid.csv"
    ended = unbend("export", baseline.output, "--format", "lattice", "--out", out)
    assert ended.code == 2
    assert ended.err.startswith("EXPORT-ENDING: ")
    assert "lattice-csv" in ended.err
    assert not out.exists()


def test_a_file_that_is_there_already(baseline, export):
    out, _ = export(baseline.output, "lattice", "--columns", 2, "--rows", 2)
    before = out.read_bytes()
    _, again = export(baseline.output, "lattice", "--columns", 3, "--rows", 2)
    assert again.code == 2
    assert again.err.startswith("EXPORT-EXISTS: ")
    assert out.read_bytes() == before
    _, forced = export(baseline.output, "lattice", "--columns", 2, "--rows", 2, "--force")
    assert forced.code == 0
    assert out.read_bytes() == before
    # Only the file and its frame: no draft is left.
    assert sorted(p.name for p in out.parent.iterdir()) == [out.name, f"{out.name}.unbend.json"]


def test_a_folder_in_the_place_of_the_file(baseline, unbend, tmp_path):
    (tmp_path / "grid.parquet").mkdir()
    for option in ((), ("--force",)):
        ended = unbend(
            "export",
            baseline.output,
            "--format",
            "lattice",
            "--out",
            tmp_path / "grid.parquet",
            *option,
        )
        assert ended.code == 2
        assert ended.err.startswith("EXPORT-EXISTS: ")


@pytest.mark.parametrize(
    "place", ["grid.parquet", "observations/part-00000.parquet", "a/b.parquet"]
)
def test_nothing_is_written_among_the_results(copied, unbend, place):
    before = {p: p.read_bytes() for p in copied.rglob("*") if p.is_file()}
    ended = unbend("export", copied, "--format", "lattice", "--out", copied / place, "--force")
    assert ended.code == 2
    assert ended.err.startswith("EXPORT-INSIDE-RUN: ")
    assert {p: p.read_bytes() for p in copied.rglob("*") if p.is_file()} == before


def test_nor_through_a_link(copied, unbend, tmp_path):
    (tmp_path / "elsewhere").symlink_to(copied)
    out = tmp_path / "elsewhere" / "grid.parquet"
    ended = unbend("export", copied, "--format", "lattice", "--out", out)
    assert ended.err.startswith("EXPORT-INSIDE-RUN: ")


def test_a_folder_that_is_no_run(export, tmp_path):
    (tmp_path / "empty").mkdir()
    _, ended = export(tmp_path / "empty", "lattice")
    assert ended.code == 5
    assert ended.err.startswith("VERIFY-NO-MANIFEST: ")


def test_a_damaged_run(copied, export):
    (copied / "stations.parquet").write_bytes(b"PAR1")
    out, ended = export(copied, "lattice")
    assert ended.code == 5
    assert ended.err.startswith("VERIFY-DAMAGED: ")
    assert not out.exists()


def test_a_mission_file_that_is_not_understood(copied, export):
    change_manifest(copied, lambda m: m["config"]["cameras"]["nadir"].update(warp=1))
    out, ended = export(copied, "lattice")
    assert ended.code == 6
    assert ended.err.startswith("EXPORT-CONFIG: ")
    assert not out.exists()


def test_a_manifest_without_mission_file(copied, export):
    change_manifest(copied, lambda m: m.pop("config"))
    assert export(copied, "lattice")[1].err.startswith("EXPORT-CONFIG: ")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda run: change_manifest(
            run, lambda m: m["config"]["cameras"]["nadir"]["distortion"].update(k1=0.01)
        ),
        lambda run: change_manifest(
            run, lambda m: m["config"]["refraction"].update(method="manual")
        ),
        lambda run: rewrite(
            run,
            "stations.parquet",
            lambda t: t.set_column(
                t.schema.get_field_index("h_msl_m"),
                t.schema.field("h_msl_m"),
                pa.compute.add(t["h_msl_m"], 1.0),
            ),
        ),
    ],
    ids=["camera", "method", "height"],
)
def test_a_run_that_does_not_come_out_again(copied, export, spoil):
    spoil(copied)
    out, ended = export(copied, "lattice")
    assert ended.code == 6
    assert ended.err.startswith("EXPORT-NOT-REPRODUCED: ")
    assert not out.exists()


@pytest.mark.parametrize("name", ["lattice", "radial-csv"])
def test_a_run_that_displaced_observations(mission, export, plain_report, name):
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]
    assert mission.run().code == 0
    out, ended = export(mission.output, name)
    assert ended.code == 2
    assert ended.err.startswith("EXPORT-DIRECTION: ")
    assert "refraction.direction" in ended.err
    assert not out.exists()


@pytest.mark.parametrize("ground", ["nan", "-700", "12000"])
def test_a_ground_height_that_is_none(baseline, export, ground):
    out, ended = export(baseline.output, "lattice", "--ground-height", ground)
    assert ended.code == 2
    assert ended.err.startswith("EXPORT-GROUND: ")
    assert not out.exists()


def test_a_folder_that_is_not_there(baseline, unbend, tmp_path):
    ended = unbend(
        "export", baseline.output, "--format", "lattice", "--out", tmp_path / "no" / "grid.parquet"
    )
    assert ended.code == 5
    assert ended.err.startswith("STORAGE-WRITE: ")


def test_a_disk_that_fills_up_leaves_nothing(baseline, export, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    out, ended = export(baseline.output, "lattice")
    assert ended.code == 5
    assert "No space left on device" in ended.err
    assert list(out.parent.iterdir()) == []


def test_names_with_commas_and_quotes_survive_csv(tmp_path):
    words = ["plain.tif", 'a,b "c".tif', None]
    table = pa.table({"image": pa.array(words), "dx_px": [0.1, None, 1e-17]})
    for some in (table.slice(0, 1), table):
        out = tmp_path / "names.csv"
        assert write_csv_stream(out, some.schema, [some]) == some.num_rows
        found = list(csv.reader(out.read_text(encoding="utf-8").splitlines()))
        assert found[0] == ["image", "dx_px"]
        assert [row[0] for row in found[1:]] == [word or "" for word in words][: some.num_rows]
        assert float(found[1][1]) == 0.1
    assert found[2][1] == ""
    assert float(found[3][1]) == 1e-17


class Steps:
    """Progress that keeps its steps: name, total, and what was finished of it."""

    def __init__(self) -> None:
        self.done: list[list] = []

    def start(self, step: str, total: int | None = None) -> None:
        self.done.append([step, total, 0])

    def advance(self, count: int) -> None:
        self.done[-1][2] += count


@pytest.mark.parametrize("form", sorted(set(FORMATS) - {"colmap-database"}))
def test_every_export_has_a_share_that_reaches_the_end(form, baseline, tmp_path):
    """Each pass over observations or images says how much there is, and comes to its end."""
    steps = Steps()
    out = tmp_path / f"out{FORMATS[form].ending}"
    needed = {"pixel_um": 4.0}  # some programs count in millimetres
    names = {option.name for option in FORMATS[form].options}
    options = {name: value for name, value in needed.items() if name in names}
    export_run(baseline.output, form, out, options, progress=steps)
    shares = [finished / total for _, total, finished in steps.done if total]
    assert shares
    assert all(0.9 <= share <= 1.2 for share in shares), steps.done


def test_a_share_counts_the_rows_that_a_sample_stands_for(baseline):
    steps = Steps()
    run = rebuild_run(baseline.output, read_manifest(baseline.output), None, Ledger(), steps)
    list(run.observations(["h_g_m"], 20))
    name, total, finished = steps.done[-1]
    assert (name, total) == ("reading observations", 59)
    assert 59 <= finished < 59 + 3  # every third row of 59


def test_a_file_in_the_place_of_a_run_is_named(unbend, baseline, tmp_path):
    for file, folder in (("manifest.json", baseline.output), ("report.html", baseline.output)):
        ended = unbend("verify", baseline.output / file)
        assert ended.code == 5
        assert f"name the folder of the results: {folder}" in ended.err
    ended = unbend("export", baseline.file, "--format", "opk", "--out", tmp_path / "opk.csv")
    assert ended.code == 5
    assert "output.path of the mission file" in ended.err
