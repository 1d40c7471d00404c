"""Bad input through the command line: a code, what, where and what to do; never a traceback."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from tests.batch.test_rehearsal import config
from tests.conftest import assert_refused
from tests.helpers import entry_of

pytestmark = pytest.mark.usefixtures("plain_report")


def refused(ended, code, exit_code=6):
    """The words of a refusal that says where, after its form was checked."""
    text = assert_refused(ended, code, exit_code)
    assert "\n  where: " in text
    return text


def accepted(ended, exit_code):
    """The summary of a mission that ran."""
    assert ended.code == exit_code, ended.text
    assert ended.err == ""
    assert "Traceback" not in ended.out
    return ended.out


# ---- values of the mission file

VALUES = {
    "log missing": (config(log__path="gone.bin"), "INPUT-MISSING", "gone.bin"),
    "observations missing": (
        config(observations__path="gone.parquet"),
        "INPUT-MISSING",
        "check observations.path",
    ),
    "exposures of one name": (
        config(events__log__nadir__image="{index}", events__log__oblique__image="{index}"),
        "EVENTS-REPEATED",
        "",
    ),
    "column of ground heights": (
        config(ground__height={"column": "h_g"}),
        "OBS-COLUMN",
        "ground.height.column",
    ),
    "its likely name": (config(ground__height={"column": "h_g"}), "OBS-COLUMN", "'h_g_m'"),
    "one column for two quantities": (
        config(observations__columns={"x_px": "y_px"}),
        "OBS-COLUMN",
        "y_px",
    ),
}


@pytest.mark.parametrize(("change", "code", "words"), VALUES.values(), ids=VALUES)
def test_a_value_that_does_not_fit_the_inputs(mission, change, code, words):
    change(mission)
    assert words in refused(mission.run(), code)


# ---- the log


def test_log_that_is_a_folder(mission):
    (mission.folder / "folder.bin").mkdir()
    mission.config["log"]["path"] = "folder.bin"
    refused(mission.run(), "INPUT-FOLDER")


def test_log_that_has_no_possible_name(mission):
    mission.config["log"]["path"] = "x" * 300 + ".bin"
    refused(mission.run(), "CONFIG-INVALID", 2)
    # Within the limits of a name and a path, and beyond them with the folder of the mission.
    mission.config["log"]["path"] = "a/" * 2045 + "f.bin"
    refused(mission.run(), "INPUT-UNREADABLE")


@pytest.mark.parametrize("kind", ["bin", "mcap"])
def test_truncated_log_runs_and_says_so(mission_factory, tmp_path, kind):
    """The record that a power cut left unfinished is a loss as a chunk of messages is."""
    mission = mission_factory(tmp_path, kind)
    content = mission.log.read_bytes()
    mission.log.write_bytes(content[: len(content) * 99 // 100 + 1])
    text = accepted(mission.run(), 3)
    assert "LOG-TRUNCATED" in text
    again = accepted(mission.run(), 3)
    assert "nothing to do" in again
    assert "LOG-TRUNCATED" in again


# ---- channels


def test_exposures_of_a_camera_that_is_not_there(mission):
    (mission.folder / "e.csv").write_text(
        "image,time_utc,camera\na,2025-06-12T09:40:00Z,thermal\nb,2025-06-12T09:40:01Z\n"
    )
    mission.config["events"] = {
        "csv": {"path": "e.csv", "columns": {"time_utc": "time_utc", "camera": "camera"}}
    }
    words = refused(mission.run(), "EVENTS-CAMERA")
    assert "nadir, oblique" in words
    mission.config["events"]["csv"]["path"] = "gone.csv"
    assert "events.csv.path" in refused(mission.run(), "INPUT-MISSING")


# ---- observations


def test_parquet_that_was_cut(mission):
    whole = (mission.folder / "observations.parquet").read_bytes()
    mission.observe_text(whole[:-200], "own.parquet")
    refused(mission.run(), "OBS-PARQUET")


def test_parquet_with_a_damaged_page(mission):
    file = mission.folder / "own.parquet"
    pq.write_table(mission.measurements(), file, compression="zstd", use_dictionary=False)
    content = bytearray(file.read_bytes())
    chunk = pq.ParquetFile(file).metadata.row_group(0).column(2)
    begin = chunk.data_page_offset
    content[begin : begin + chunk.total_compressed_size] = bytes(chunk.total_compressed_size)
    mission.observe_text(bytes(content), file.name)
    refused(mission.run(), "OBS-DAMAGED")


HEADS = "image,point,x_px,y_px,h_g_m\n"


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("own.xlsx", "image,point\n", "OBS-FORMAT"),
        ("own.parquet", "", "OBS-PARQUET"),
        ("own.parquet", "PAR1", "OBS-PARQUET"),
        ("own.parquet", "random" * 99, "OBS-PARQUET"),
        ("own.csv", "", "OBS-CSV"),
        ("own.csv", HEADS, "OBS-EMPTY"),
        ("own.csv", "image\tpoint\tx_px\ty_px\th_g_m\na\tb\t1\t2\n", "OBS-CSV"),
        ("own.csv", HEADS + "a,b,1,2,3\na,b,1,2,3,4\n", "OBS-CSV"),
        ("own.csv", "image,point,x_px,x_px,y_px,h_g_m\na,b,1,1,2,3\n", "OBS-REPEATED-COLUMN"),
        ("own.csv", "image,point,x_px,y_px\na,b,1,2\n", "OBS-COLUMN"),
        ("own.csv", "\0\0\0\0", "OBS-[A-Z-]+"),
        ("own.csv", (HEADS + "ä,b,1,2,3\n").encode("utf-16-le"), "OBS-(CSV|COLUMN)"),
    ],
)
def test_a_file_that_is_no_table(mission, name, content, code):
    mission.observe_text(content, name)
    refused(mission.run(), code)


def test_parquet_without_rows(mission):
    mission.observe(mission.measurements().slice(0, 0))
    refused(mission.run(), "OBS-EMPTY")


def test_parquet_with_a_repeated_column(mission):
    table = mission.measurements()
    mission.observe(table.append_column("x_px", table["x_px"]))
    refused(mission.run(), "OBS-REPEATED-COLUMN")


@pytest.mark.parametrize(
    ("column", "kind"),
    [
        ("x_px", pa.bool_()),
        ("y_px", pa.list_(pa.float64())),
        ("h_g_m", pa.timestamp("s")),
        ("image", pa.list_(pa.string())),
        ("image", pa.timestamp("s")),
    ],
)
def test_columns_of_a_wrong_type(mission, column, kind):
    table = mission.measurements()
    place = table.schema.get_field_index(column)
    mission.observe(table.set_column(place, column, pa.nulls(table.num_rows, kind)))
    assert column in refused(mission.run(), "OBS-TYPE")


SPOILT_CELLS = yaml.safe_load("""
- [x_px, .nan, bad_measurement]
- [y_px, null, bad_measurement]
- [x_px, .inf, bad_measurement]
- [h_g_m, null, no_ground]
- [h_g_m, .nan, no_ground]
- [h_g_m, -6000.0, no_ground]
- [h_g_m, 40000.0, no_ground]
- [image, null, no_station]
- [image, nowhere_01, no_station]
- [image, "", no_station]
- [x_px, 3000000000.0, outside_camera]
- [x_px, -100000.0, outside_camera]
- [h_g_m, 9000.0, misses_ground]
- [x_px, -.inf, bad_measurement]
- [y_px, .nan, bad_measurement]
- [y_px, .inf, bad_measurement]
- [y_px, -.inf, bad_measurement]
- [x_px, 1.0e+308, bad_measurement]
- [x_px, -1.0e+308, bad_measurement]
- [x_px, 18446744073709551616.0, bad_measurement]
- [y_px, 1.0e+308, bad_measurement]
- [y_px, -1.0e+308, bad_measurement]
- [y_px, -9223372036854775808.0, bad_measurement]
- [y_px, 1.0e+19, bad_measurement]
- [h_g_m, .inf, no_ground]
- [h_g_m, -.inf, no_ground]
- [h_g_m, 1.0e+308, no_ground]
- [h_g_m, -1.0e+308, no_ground]
- [h_g_m, 18446744073709551616.0, no_ground]
""")
"""Column, value, and the status of the row."""


def test_rows_that_cannot_be_corrected_stay(mission, baseline):
    """One of each kind, and all others as in a run without them."""
    table = mission.measurements()
    for row, (column, value, _) in enumerate(SPOILT_CELLS):
        cells = table[column].to_pylist()
        cells[row] = value
        place = table.schema.get_field_index(column)
        field = table.schema.field(column)
        table = table.set_column(place, field, pa.array(cells, field.type))
    mission.observe(table)
    text = accepted(mission.run(), 3)
    results = mission.results()
    count = len(SPOILT_CELLS)
    statuses = [status for _, _, status in SPOILT_CELLS]
    assert results["point"].to_pylist() == table["point"].to_pylist()
    assert results["status"].to_pylist() == statuses + ["ok"] * (table.num_rows - count)
    for name in ("x_corrected_px", "y_corrected_px", "r_c_rad"):
        assert np.flatnonzero(results[name].is_null()).tolist() == list(range(count))
        assert results[name].slice(count).equals(baseline.results()[name].slice(count))
    manifest = mission.manifest()
    for status in set(statuses):
        assert status in text
        assert manifest["observations"]["status"][status] == statuses.count(status)
    # An image that the log does not know is one loss, which stands for its rows.
    assert "IMAGES-UNMATCHED" in text
    assert entry_of(manifest, "OBS-GROUND-RANGE")["count"] == 2


# ---- the output folder


def test_a_file_in_the_place_of_the_output_folder(mission):
    (mission.folder / "results").write_text("a file")
    refused(mission.run(), "STORAGE-WRITE", 5)


@pytest.mark.parametrize(
    ("section", "name"),
    [
        ("observations", "observations/own.parquet"),
        ("observations", "stations.parquet"),
        ("log", "observations/deeper/flight.bin"),
        ("log", ".staging/flight.bin"),
    ],
)
def test_an_input_among_the_results_is_not_replaced(mission, unbend, section, name):
    file = mission.output / name
    file.parent.mkdir(parents=True)
    (mission.output / ".lock").touch()
    (mission.folder / mission.config[section]["path"]).rename(file)
    content = file.read_bytes()
    mission.config[section]["path"] = f"results/{name}"
    assert name in refused(mission.run(), "OUTPUT-OVER-INPUT", 2)
    refused(unbend("check", mission.save()), "OUTPUT-OVER-INPUT", 2)
    refused(mission.run("--force"), "OUTPUT-OVER-INPUT", 2)
    assert file.read_bytes() == content


@pytest.mark.parametrize("path", ["results/observations/link.parquet", "link.parquet"])
def test_links_to_and_from_the_results(mission, path):
    """The link among the results would be lost, and what the other leads to, too."""
    results = mission.output / "observations"
    results.mkdir(parents=True)
    (mission.output / ".lock").touch()
    table = mission.folder / "observations.parquet"
    real = table.rename(results / "real.parquet")
    (results / "link.parquet").symlink_to(mission.folder / "outside.parquet")
    (mission.folder / "outside.parquet").write_bytes(real.read_bytes())
    (mission.folder / "link.parquet").symlink_to(real)
    mission.config["observations"]["path"] = path
    assert path in refused(mission.run(), "OUTPUT-OVER-INPUT", 2)
    assert real.is_file()


def test_a_mission_file_among_its_results(mission, unbend):
    folder = mission.folder / "observations"
    folder.mkdir()
    for key in ("log", "observations"):
        mission.config[key]["path"] = "../" + mission.config[key]["path"]
    mission.config["output"]["path"] = ".."
    moved = folder / "mission.yaml"
    mission.save().rename(moved)
    (mission.folder / ".lock").touch()
    refused(unbend("run", moved), "OUTPUT-OVER-INPUT", 2)
    assert moved.is_file()


def test_inputs_beside_the_results_stay(mission):
    """The results may go into the folder of the inputs, as long as no name is both."""
    mission.config["output"]["path"] = "."
    before = {p.name: p.read_bytes() for p in mission.folder.iterdir() if p.is_file()}
    accepted(mission.run(), 0)
    for name, content in before.items():
        assert (mission.folder / name).read_bytes() == content


def test_results_are_not_written_through_a_link(mission, tmp_path):
    target = tmp_path / "elsewhere"
    target.mkdir()
    mission.output.mkdir()
    (mission.output / ".lock").touch()
    (mission.output / "observations").symlink_to(target)
    refused(mission.run(), "STORAGE-SYMLINK", 5)
    assert list(target.iterdir()) == []


def test_an_input_that_changes_meanwhile(mission, monkeypatch):
    from unbend.batch import runs

    def write_report(path, *_):
        path.write_text("report")
        with mission.log.open("ab") as log:
            log.write(b"more")

    monkeypatch.setattr(runs, "write_report", write_report)
    assert "log" in refused(mission.run(), "INPUT-CHANGED")
    assert not (mission.output / "manifest.json").exists()
    assert not (mission.output / "observations").exists()


# ---- several missions


def test_one_mission_is_refused_and_the_other_done(mission_factory, tmp_path, unbend):
    good = mission_factory(tmp_path / "good")
    bad = mission_factory(tmp_path / "bad")
    bad.config["log"]["path"] = "gone.bin"
    ended = unbend("run", bad.save(), good.save())
    refused(ended, "INPUT-MISSING", 6)
    assert (good.output / "manifest.json").is_file()
    bad.file.write_text("mission: [")
    refused(unbend("run", good.save(), bad.file), "CONFIG-YAML", 6)
    refused(unbend("check", good.save(), bad.file), "CONFIG-YAML", 6)


def test_two_missions_with_one_folder(mission, unbend):
    first = mission.save()
    second = first.with_name("second.yaml")
    second.write_text(first.read_text("utf-8").replace("simulated_bin", "other"))
    for command in ("check", "run"):
        assert "mission.yaml" in refused(unbend(command, first, second), "OUTPUT-SHARED", 6)
    assert mission.manifest()["mission"] == "simulated_bin"


def test_an_error_of_ours_costs_one_mission_only(mission_factory, tmp_path, unbend, monkeypatch):
    from unbend.stages import story

    good = mission_factory(tmp_path / "good")
    bad = mission_factory(tmp_path / "bad")
    bad.config["mission"]["name"] = "unlucky"
    original = story.flight_log

    def flight_log(mission, *arguments):
        if mission.mission.name == "unlucky":
            raise KeyError("never thought of")
        return original(mission, *arguments)

    monkeypatch.setattr(story, "flight_log", flight_log)
    ended = unbend("run", bad.save(), good.save())
    assert ended.code == 1
    assert "Traceback" in ended.err
    assert "this is a bug in unbend" in ended.err
    assert (good.output / "manifest.json").is_file()


# ---- URLs where paths are taken


@pytest.mark.parametrize(
    "words",
    [
        "simulate s3://bucket/flown",
        "inspect s3://bucket/flight.bin",
        "init az://bucket/flight.bin",
        "profile --csv=s3://bucket/profile.csv",
        "schema --out s3://bucket/s.json",
        "simulate s3://bucket/a?sig=hunter2",
    ],
)
def test_urls_where_paths_are_taken(words, unbend, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "hunter2" not in refused(unbend(*words.split()), "URL-INVALID", 2)
    assert list(tmp_path.iterdir()) == []
