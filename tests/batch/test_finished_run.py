"""What leaves for other programs: the run as it was, on a grid and by nadir angle."""

import hashlib
import json
import shutil
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.helpers import one_line
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile, constant_series
from unbend.batch.finished_run.export import export_run, rebuild_run
from unbend.batch.finished_run.read_back import profile_of, stations_of
from unbend.batch.results import manifest_of_run, read_manifest
from unbend.batch.runs import read_mission
from unbend.errors import StorageError
from unbend.flight.stations import NO_TIME, Stations
from unbend.messages import Ledger
from unbend.tables.exports import FORMATS
from unbend.tables.writing import PROFILE_ID, table_of_profile, table_of_stations

FEW_NODES = ("--columns", 2, "--rows", 2)

pytestmark = pytest.mark.usefixtures("plain_report")


@pytest.fixture
def export(unbend, tmp_path):
    """Exports a run to a file of the test's own; the file and how it ended."""

    def make(run, name, *options):
        ending = "csv" if name.endswith("csv") else "parquet"
        out = tmp_path / f"out.{ending}"
        return out, unbend(
            "export",
            run,
            "--format",
            name,
            "--out",
            out,
            *options,
        )

    return make


@pytest.fixture
def lattice(export):
    """Exports the lattice of a run: its rows, and what was said in one line."""

    def make(run, *options, exit_code=0):
        out, ended = export(run, "lattice", "--force", *options)
        assert ended.code == exit_code, ended.text
        return pd.read_parquet(out), one_line(ended.out)

    return make


@pytest.fixture
def copied(baseline, tmp_path):
    """The results of the mission, which a test may spoil."""
    run = tmp_path / "run"
    shutil.copytree(baseline.output, run)
    return run


# -- the lattice --------------------------------------------------------------------------------


def test_at_its_nodes_the_lattice_is_what_a_run_makes_of_them(mission, lattice):
    """The nodes measured as observations, over level ground, with pixels counted from (0, 0)."""
    mission.config["observations"]["pixel_origin"] = "centre"
    images = mission.measurements()["image"].unique().to_pylist()
    camera = mission.config["cameras"]["nadir"]
    x = np.linspace(0.0, camera["width_px"], 5) - 0.5
    y = np.linspace(0.0, camera["height_px"], 4) - 0.5
    place = ["image", "x_px", "y_px"]
    nodes = pd.DataFrame(product(images, x, y), columns=place)
    nodes["point"] = nodes.index.astype(str)
    nodes["h_g_m"] = 321.0
    mission.observe_rows(nodes)
    mission.run_to_manifest()

    grid, _ = lattice(
        mission.output,
        "--columns",
        5,
        "--rows",
        4,
    )

    run = mission.result_rows().merge(grid, on=place)
    assert len(grid) == len(nodes) == len(run)
    assert set(grid["h_g_m"]) == {321.0}
    for axis in "xy":
        shift = run[f"{axis}_corrected_px"] - run[f"{axis}_px"]
        assert np.abs(run[f"d{axis}_px"] - shift).max() < 1e-9


def test_the_ground_is_the_median_of_each_image(baseline, lattice):
    rows, text = lattice(baseline.output, *FEW_NODES)
    assert f"{len(rows)} rows" in text
    heights = median_heights(baseline)
    assert heights.nunique() > 1
    assert set(rows["image"]) == set(heights.index)
    assert rows["h_g_m"].tolist() == heights[rows["image"]].tolist()


def median_heights(mission):
    """Of the ground in the observations of each image."""
    return mission.result_rows().groupby("image")["h_g_m"].median()


def test_images_without_observations_get_the_ground_of_the_others(mission, lattice):
    table = mission.measured_rows()
    left_out = table["image"][0]
    table = table[table["image"] != left_out]
    mission.observe_rows(table)
    mission.run()

    rows, text = lattice(mission.output, *FEW_NODES)

    assert "EXPORT-GROUND" in text
    nodes = rows[rows["image"] == left_out]
    assert set(nodes["h_g_m"]) == {median_heights(mission).median()}
    assert set(nodes["status"]) == {"ok"}


def test_what_has_no_lattice_is_said(mission, lattice):
    table = mission.measured_rows()
    table.loc[0, "image"] = "unknown.tif"
    mission.observe_rows(table)
    mission.run_to_manifest(3)
    rows, text = lattice(mission.output, *FEW_NODES, exit_code=3)
    assert "EXPORT-LEFT-OUT: 1 image " in text
    assert "unknown.tif" not in set(rows["image"])


def test_a_run_without_ground_heights_says_so(mission, lattice):
    table = mission.measured_rows()
    mission.observe_rows(table.assign(h_g_m=np.nan))
    mission.run_to_manifest(3)
    rows, text = lattice(mission.output, *FEW_NODES, exit_code=3)
    assert "EXPORT-NO-GROUND" in text
    assert set(rows["status"]) == {"no_ground"}
    assert rows["dx_px"].isna().all()
    rows, _ = lattice(mission.output, *FEW_NODES, "--ground-height", 123.5)
    assert set(rows["h_g_m"]) == {123.5}


def test_a_dome_comes_back_from_the_manifest(mission, lattice):
    """The manifest states the defaults of a window, which nobody gave."""
    mission.config["cameras"]["nadir"]["window"] = {"shape": "spherical"}
    mission.run_to_manifest()
    lattice(mission.output, *FEW_NODES)


# -- radial tables ------------------------------------------------------------------------------


def test_a_radial_table_agrees_with_the_observations(baseline, export):
    """R_c of the observations themselves, where the ground is within 20 m of the table's."""
    out, ended = export(baseline.output, "radial-csv")
    assert ended.code == 0
    assert "EXPORT-WINDOW" in ended.out
    stations = baseline.station_rows()
    counts = stations["camera"].value_counts()
    run = baseline.result_rows().merge(stations, on="image")
    run = run[run["status_x"] == "ok"]
    rows = pd.read_csv(out)
    assert rows[::81].groupby("camera")["images"].sum().to_dict() == counts.to_dict()
    for camera, tables in rows.groupby("camera"):
        first = tables.iloc[0]
        table = tables[tables["h_c_m"] == first["h_c_m"]]
        is_level = np.abs(run["h_g_m"] - first["h_g_m"]) < 20.0
        points = run[is_level & (run["camera"] == camera)]
        assert len(points) > 2
        angle_deg = np.degrees(points["zeta_c_rad"])
        r_c_urad = np.interp(angle_deg, table["nadir_angle_deg"], table["r_c_urad"])
        assert r_c_urad == pytest.approx(points["r_c_rad"] * 1e6, rel=0.02)


# -- what is read back --------------------------------------------------------------------------


def test_the_profile_comes_back(baseline):
    """Moist, adjusted: the refractivity, gravity and index of the run's own profile."""
    adjustment = read_mission(baseline.file).air.adjustment
    before = adjustment.profile
    after = profile_of(table_of_profile(adjustment, PROFILE_ID))
    h = np.linspace(before.bottom_m + 1.0, before.top_m - 1.0, 20_001)
    assert before.vapour_pressure(1000.0) > 100.0
    np.testing.assert_allclose(
        after.refractivity(h),
        before.refractivity(h),
        rtol=2e-15,
        equal_nan=False,
    )
    np.testing.assert_allclose(
        after.temperature(h),
        before.temperature(h),
        rtol=2e-15,
        equal_nan=False,
    )
    assert after.index == before.index
    assert after.gravity.g_phi == before.gravity.g_phi
    assert after.layers.source == before.layers.source


def test_stations_come_back():
    nan = np.nan
    values = {
        "image": np.array(["a", "b"], object),
        "camera": np.array(["nadir", ""], object),
        "time_ns": np.array([1_700_000_000_123_456_789, NO_TIME]),
        "lat_rad": np.array([0.8, nan]),
        "lon_rad": np.array([-3.1, nan]),
        "quaternion": np.array([[0.5, -0.5, 0.5, 0.5], [nan] * 4]),
        "aircraft_quaternion": np.array([[0.1, 0.7, -0.1, 0.7], [nan] * 4]),
        "suspect_reason": np.array(["a step of 77 m", ""], object),
        "accepted": np.array([True, False]),
        "status": np.array(["suspect", "unmatched"], object),
    }
    names = [field.name for field in fields(Stations)]
    for number, name in enumerate(names):
        if name != "from_boot":  # it has a default; all others are numbers
            values.setdefault(name, np.array([number + 0.5, nan]))
    before = Stations(**values)
    profile = TimedProfile(None, standard_atmosphere("us1976"))
    table = table_of_stations(before, constant_series(profile, 2))
    for axis, column in zip("wxyz", before.aircraft_quaternion.T, strict=True):
        name = f"aircraft_q_{axis}"
        if name not in table.schema.names:
            table = table.append_column(name, pa.array(column))
    after = stations_of(table)
    for name in names:
        was = getattr(before, name)
        is_now = getattr(after, name)
        assert was.dtype == is_now.dtype
        if name.endswith("_rad"):
            np.testing.assert_allclose(is_now, was, rtol=1e-15)
        else:
            np.testing.assert_array_equal(is_now, was)


# -- refusals -----------------------------------------------------------------------------------

REQUESTS = {
    "format misspelt": ("latice o.parquet", "EXPORT-FORMAT", "perhaps lattice"),
    "format unknown": ("photomod o.csv", "EXPORT-FORMAT", "one of lattice, lattice-csv, radial"),
    "format of a program": ("Metashape o.csv", "EXPORT-FORMAT", "for Metashape: bundler"),
    "format like two": ("colmap-text o.csv", "EXPORT-FORMAT", "perhaps colmap or colmap-database"),
    "ending": ("lattice grid.csv", "EXPORT-ENDING", "lattice-csv"),
    "a folder is there": ("lattice folder.parquet", "EXPORT-EXISTS", "folder.parquet"),
    "a folder, forced": ("lattice folder.parquet --force", "EXPORT-EXISTS", "folder.parquet"),
    "no folder": ("lattice no/grid.parquet", "STORAGE-WRITE", "no"),
    "ground nan": ("lattice o.parquet --ground-height nan", "EXPORT-GROUND", "nan"),
    "ground low": ("lattice o.parquet --ground-height -700", "EXPORT-GROUND", "-700"),
    "ground high": ("lattice o.parquet --ground-height 12000", "EXPORT-GROUND", "12000"),
}


@pytest.mark.parametrize(
    ("words", "code", "remedy"),
    REQUESTS.values(),
    ids=REQUESTS,
)
def test_a_request_that_is_refused_writes_nothing(
    baseline, refusal_of, tmp_path, monkeypatch, words, code, remedy
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.parquet").mkdir()
    name, out, *options = words.split()
    request = ["export", baseline.output, "--format", name, "--out", out, *options]
    exit_code = 5 if code == "STORAGE-WRITE" else 2

    text = refusal_of(code, exit_code, *request)

    assert remedy in text
    assert [path.name for path in tmp_path.rglob("*")] == ["folder.parquet"]


def test_a_file_that_is_there_already(baseline, export):
    out, _ = export(baseline.output, "lattice", *FEW_NODES)
    before = out.read_bytes()

    _, again = export(
        baseline.output,
        "lattice",
        "--columns",
        3,
        "--rows",
        2,
    )
    assert again.code == 2
    assert again.err.startswith("EXPORT-EXISTS: ")
    assert out.read_bytes() == before

    _, forced = export(
        baseline.output,
        "lattice",
        *FEW_NODES,
        "--force",
    )
    assert forced.code == 0
    assert out.read_bytes() == before
    # Only the file and its frame: no draft is left.
    assert {path.name for path in out.parent.iterdir()} == {out.name, f"{out.name}.unbend.json"}


@pytest.mark.parametrize(
    "place",
    [
        "run/grid.parquet",
        "run/observations/part-00000.parquet",
        "run/a/b.parquet",
        "link/grid.parquet",
    ],
)
def test_nothing_is_written_among_the_results(copied, refusal_of, tmp_path, place):
    (tmp_path / "link").symlink_to(copied)
    before = contents(copied)
    request = ["export", copied, "--format", "lattice", "--out", tmp_path / place, "--force"]

    refusal_of("EXPORT-INSIDE-RUN", 2, *request)

    assert contents(copied) == before


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def export_refused(export):
    """Exports a run, which must be refused and write nothing; what is said."""

    def make(run, name, code, exit_code):
        out, ended = export(run, name)
        assert ended.code == exit_code
        assert ended.err.startswith(f"{code}: ")
        assert not out.exists()
        return ended.err

    return make


def test_a_folder_without_a_manifest_is_no_run(copied, export_refused):
    (copied / "manifest.json").unlink()
    export_refused(copied, "lattice", "VERIFY-NO-MANIFEST", 5)


def test_a_folder_that_no_run_has_written_to_is_called_so(tmp_path):
    with pytest.raises(StorageError, match="is not the folder of the results") as refusal:
        manifest_of_run(tmp_path)
    assert refusal.value.code == "VERIFY-NO-MANIFEST"
    assert "output.path" in refusal.value.remedy
    (tmp_path / ".lock").touch()
    with pytest.raises(StorageError, match="no run has finished here"):
        manifest_of_run(tmp_path)


def test_a_damaged_run_is_not_exported(copied, export_refused):
    (copied / "stations.parquet").write_bytes(b"PAR1")
    export_refused(copied, "lattice", "VERIFY-DAMAGED", 5)


def warp_camera(manifest, run):
    manifest["config"]["cameras"]["nadir"]["warp"] = 1


def remove_mission(manifest, run):
    del manifest["config"]


def distort_camera(manifest, run):
    manifest["config"]["cameras"]["nadir"]["distortion"]["k1"] = 0.01


def change_method(manifest, run):
    manifest["config"]["refraction"]["method"] = "manual"


def raise_stations(manifest, run):
    """Stations 1 m higher, and the manifest with them: as of another version of the program."""
    stations = run / "stations.parquet"
    table = pq.read_table(stations)
    place = table.schema.get_field_index("h_msl_m")
    raised = pa.compute.add(table["h_msl_m"], 1.0)
    pq.write_table(table.set_column(place, table.schema.field(place), raised), stations)
    (output,) = (output for output in manifest["outputs"] if output["name"] == stations.name)
    output["sha256"] = hashlib.sha256(stations.read_bytes()).hexdigest()
    output["bytes"] = stations.stat().st_size


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (warp_camera, "EXPORT-CONFIG"),
        (remove_mission, "EXPORT-CONFIG"),
        (distort_camera, "EXPORT-NOT-REPRODUCED"),
        (change_method, "EXPORT-NOT-REPRODUCED"),
        (raise_stations, "EXPORT-NOT-REPRODUCED"),
    ],
)
def test_a_run_that_cannot_be_read_back(copied, export_refused, change, code):
    file = copied / "manifest.json"
    manifest = json.loads(file.read_text())
    change(manifest, copied)
    file.write_text(json.dumps(manifest))
    export_refused(copied, "lattice", code, 6)


def test_a_run_that_displaced_observations(mission, export_refused):
    mission.config["refraction"] = {"direction": "apply"}
    mission.config["accept"] = [{"code": "PLAUSIBLE-APPLY", "reason": "there and back"}]
    mission.run_to_manifest()
    for name in ("lattice", "radial-csv"):
        text = export_refused(mission.output, name, "EXPORT-DIRECTION", 2)
        assert "refraction.direction" in text


def test_a_disk_that_fills_up_leaves_nothing(baseline, export, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    out, ended = export(baseline.output, "lattice")
    assert ended.code == 5
    assert "No space left on device" in ended.err
    assert list(out.parent.iterdir()) == []


@dataclass
class Step:
    name: str
    total: int | None
    finished: int = 0


class Steps:
    """Progress that keeps its steps."""

    def __init__(self):
        self.done: list[Step] = []

    def start(self, step, total=None):
        self.done.append(Step(step, total))

    def advance(self, count):
        self.done[-1].finished += count


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"colmap-database"}))
def test_every_export_has_a_share_that_reaches_the_end(name, baseline, tmp_path):
    """Each pass over observations or images says how much there is, and comes to its end."""
    form = FORMATS[name]
    is_metric = "pixel_um" in {option.name for option in form.options}
    values = {"pixel_um": 4.0} if is_metric else {}
    steps = Steps()

    export_run(
        baseline.output,
        name,
        tmp_path / f"out{form.ending}",
        values,
        progress=steps,
    )

    counted = [step for step in steps.done if step.total]
    assert counted
    for step in counted:
        assert 0.9 <= step.finished / step.total <= 1.2, step


def test_a_share_counts_the_rows_that_a_sample_stands_for(baseline):
    steps = Steps()
    manifest = read_manifest(baseline.output)
    run = rebuild_run(
        baseline.output,
        manifest,
        None,
        Ledger(),
        steps,
    )

    list(run.observations(["h_g_m"], 20))

    step = steps.done[-1]
    assert step.name == "reading observations"
    assert step.total == 59
    assert 59 <= step.finished < 59 + 3  # every third row of 59


@pytest.mark.parametrize("name", ["manifest.json", "report.html"])
def test_a_file_in_the_place_of_a_run_is_named(unbend, baseline, name):
    ended = unbend("verify", baseline.output / name)
    assert ended.code == 5
    assert f"name the folder of the results: {baseline.output}" in ended.err


def test_a_mission_file_in_the_place_of_a_run_is_named(unbend, baseline, tmp_path):
    ended = unbend(
        "export",
        baseline.file,
        "--format",
        "opk",
        "--out",
        tmp_path / "opk.csv",
    )
    assert ended.code == 5
    assert "output.path of the mission file" in ended.err
