"""Bad input through the command line: a code, what, where and what to do; never a traceback."""

from __future__ import annotations

import re

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest

from unbend.batch.store import open_folder

pytestmark = pytest.mark.usefixtures("plain_report")


def refused(ended, code: str, exit_code: int = 6) -> str:
    """The words of a refusal, after its form was checked."""
    assert ended.code == exit_code, ended.text
    assert "Traceback" not in ended.text
    assert "Warning" not in ended.text
    assert re.search(rf"^(\S+: )?{code}: \S", ended.err, re.MULTILINE), ended.text
    assert "\n  where: " in ended.err, ended.err
    assert "\n  to do: " in ended.err, ended.err
    return ended.err


def accepted(ended, exit_code: int) -> str:
    """The summary of a mission that ran."""
    assert ended.code == exit_code, ended.text
    assert ended.err == ""
    assert "Traceback" not in ended.out
    return ended.out


def csv_text(mission) -> str:
    stream = pa.BufferOutputStream()
    pa_csv.write_csv(mission.measurements(), stream, pa_csv.WriteOptions(quoting_style="none"))
    return stream.getvalue().to_pybytes().decode()


# ---- the log


def spoil(mission, name: str, content: bytes) -> None:
    (mission.folder / name).write_bytes(content)
    mission.config["log"]["path"] = name


def test_log_of_another_kind(mission):
    spoil(mission, "log.csv", b"time,lat,lon\n1,2,3\n")
    assert ".bin" in refused(mission.run(), "LOG-FORMAT")


def test_log_that_is_not_there(mission):
    mission.config["log"]["path"] = "gone.bin"
    assert "gone.bin" in refused(mission.run(), "INPUT-MISSING")


def test_log_that_is_a_folder_or_has_no_possible_name(mission):
    (mission.folder / "folder.bin").mkdir()
    mission.config["log"]["path"] = "folder.bin"
    refused(mission.run(), "INPUT-MISSING")
    mission.config["log"]["path"] = "x" * 300 + ".bin"
    refused(mission.run(), "CONFIG-INVALID", 2)
    # Within the limits of a name and a path, and beyond them with the folder of the mission.
    mission.config["log"]["path"] = "a/" * 2045 + "f.bin"
    refused(mission.run(), "INPUT-UNREADABLE")


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_empty_log(mission, kind):
    spoil(mission, f"empty.{kind}", b"")
    refused(mission.run(), "LOG-EMPTY")


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_random_bytes(mission, kind):
    noise = bytes((i * i * 31 + i // 7) % 256 for i in range(20_000))
    spoil(mission, f"noise.{kind}", noise)
    ended = mission.run()
    refused(ended, "LOG-[A-Z-]+")
    assert f"noise.{kind}" in ended.err


def test_log_with_the_name_of_another_format(mission):
    spoil(mission, "flight.tlog", mission.log.read_bytes())
    assert "DataFlash" in refused(mission.run(), "LOG-FORMAT")


@pytest.mark.parametrize("kind", ["bin", "mcap"])
def test_truncated_log_runs_and_says_so(mission_factory, tmp_path, kind):
    """The record that a power cut left unfinished is a loss as a chunk of messages is."""
    mission = mission_factory(tmp_path, kind)
    content = mission.log.read_bytes()
    spoil(mission, f"cut.{kind}", content[: len(content) * 99 // 100 + 1])
    text = accepted(mission.run(), 3)
    assert "LOG-TRUNCATED" in text
    again = accepted(mission.run(), 3)
    assert "nothing to do" in again
    assert "LOG-TRUNCATED" in again


# ---- channels


def test_a_named_channel_that_is_missing(mission, unbend):
    channels = mission.config["log"]["channels"]
    channels["cabin_pressure"] = "BARO[7]"
    words = refused(mission.run(), "CHANNEL-MISSING")
    assert "BARO[7]" in words
    assert "BARO[1]" in words
    channels["cabin_pressure"] = "BARO[1]"
    channels["humidity"] = "HYGR[5]"
    text = accepted(mission.run(), 3)
    assert "loss CHANNEL-MISSING" in text
    assert "HYGR[5]" in text
    assert "fallback AIR-HUMIDITY-EXPECTED" in text


def test_a_channel_without_the_column_of_its_role(mission):
    mission.config["log"]["channels"]["temperature"] = "ATT"
    text = accepted(mission.run(), 3)
    assert "temperature_k" in text


def test_a_unit_of_another_quantity(mission):
    mission.config["log"]["channels"]["pressure"] = {"name": "BARO[0]", "unit": "degC"}
    assert "degC" in refused(mission.run(), "CHANNEL-UNIT")


def test_event_channel_that_is_missing(mission):
    mission.config["events"]["log"]["nadir"]["channel"] = "CAM[4]"
    words = refused(mission.run(), "EVENTS-CHANNEL")
    assert "CAM[0] (3)" in words


def test_two_exposures_of_one_name(mission):
    for camera in ("nadir", "oblique"):
        mission.config["events"]["log"][camera]["image"] = "{index}"
    refused(mission.run(), "EVENTS-REPEATED")


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


def test_observations_that_are_not_there(mission):
    mission.config["observations"]["path"] = "gone.parquet"
    refused(mission.run(), "INPUT-MISSING")


def test_observations_of_another_kind(mission):
    mission.observe_text("image,point\n", "own.xlsx")
    refused(mission.run(), "OBS-FORMAT")


@pytest.mark.parametrize("content", [b"", b"PAR1", b"random" * 99])
def test_parquet_that_is_none(mission, content):
    mission.observe_text(content, "own.parquet")
    refused(mission.run(), "OBS-PARQUET")


def test_parquet_that_was_cut(mission):
    whole = (mission.folder / "observations.parquet").read_bytes()
    mission.observe_text(whole[:-200], "own.parquet")
    refused(mission.run(), "OBS-PARQUET")


def test_parquet_with_a_damaged_page(mission):
    pq.write_table(
        mission.measurements(),
        mission.folder / "own.parquet",
        compression="zstd",
        use_dictionary=False,
    )
    content = bytearray((mission.folder / "own.parquet").read_bytes())
    chunk = pq.ParquetFile(mission.folder / "own.parquet").metadata.row_group(0).column(2)
    begin = chunk.data_page_offset
    content[begin : begin + chunk.total_compressed_size] = bytes(chunk.total_compressed_size)
    mission.observe_text(bytes(content), "own.parquet")
    refused(mission.run(), "OBS-DAMAGED")


def test_observation_column_with_another_name(mission):
    table = mission.measurements()
    mission.observe(table.rename_columns(["image", "point", "x_pix", "y_px", "h_g_m", "quality"]))
    words = refused(mission.run(), "OBS-COLUMN")
    assert "perhaps 'x_pix'" in words
    assert "observations.columns.x_px" in words
    mission.config["observations"]["columns"] = {"x_px": "x_pix"}
    accepted(mission.run(), 0)


def test_ground_column_with_another_name(mission):
    mission.config["ground"]["height"] = {"column": "h_g"}
    words = refused(mission.run(), "OBS-COLUMN")
    assert "'h_g_m'" in words
    assert "ground.height.column" in words


def test_one_column_for_two_quantities(mission):
    mission.config["observations"]["columns"] = {"x_px": "y_px"}
    assert "y_px" in refused(mission.run(), "OBS-COLUMN")


def test_observations_already_corrected(mission, baseline, tmp_path):
    part = baseline.output / "observations" / "part-00000.parquet"
    mission.observe_text(part.read_bytes(), "own.parquet")
    assert "refraction removed" in refused(mission.run(), "OBS-ALREADY-CORRECTED")
    # The mark alone is enough, and so are the columns without the mark.
    marked = mission.measurements().replace_schema_metadata({"unbend.refraction": "removed"})
    mission.observe(marked)
    refused(mission.run(), "OBS-ALREADY-CORRECTED")
    pa_csv.write_csv(pq.read_table(part).replace_schema_metadata(None), tmp_path / "mission/o.csv")
    mission.config["observations"]["path"] = "o.csv"
    refused(mission.run(), "OBS-ALREADY-CORRECTED")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "OBS-CSV"),
        ("image,point,x_px,y_px,h_g_m\n", "OBS-EMPTY"),
        ("image;point;x_px;y_px;h_g_m\na;b;1,5;2\n", "OBS-CSV"),
        ("image\tpoint\tx_px\ty_px\th_g_m\na\tb\t1\t2\n", "OBS-CSV"),
        ("image,point,x_px,y_px,h_g_m\na,b,1,2,3\na,b,1,2\n", "OBS-CSV"),
        ("image,point,x_px,y_px,h_g_m\na,b,1,2,3\na,b,1,2,3,4\n", "OBS-CSV"),
        ("image,point,x_px,x_px,y_px,h_g_m\na,b,1,1,2,3\n", "OBS-REPEATED-COLUMN"),
        ("image,point,x_px,y_px\na,b,1,2\n", "OBS-COLUMN"),
        ("\0\0\0\0", "OBS-"),
    ],
)
def test_csv_that_is_no_table(mission, text, code):
    mission.observe_text(text)
    refused(mission.run(), code + "[A-Z-]*")


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16-le"])
def test_csv_in_an_encoding_that_it_does_not_state(mission, encoding):
    mission.observe_text("image,point,x_px,y_px,h_g_m\nä,b,1,2,3\n".encode(encoding))
    refused(mission.run(), "OBS-(CSV|COLUMN)")


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
    i = table.schema.get_field_index(column)
    mission.observe(table.set_column(i, column, pa.nulls(table.num_rows, kind)))
    words = refused(mission.run(), "OBS-TYPE")
    assert column in words


def spoil_cells(mission, column: str, rows: list[int], value) -> pa.Table:
    table = mission.measurements()
    values = table[column].to_pylist()
    for row in rows:
        values[row] = value
    i = table.schema.get_field_index(column)
    changed = table.set_column(i, column, pa.array(values, table.schema.field(column).type))
    mission.observe(changed)
    return changed


@pytest.mark.parametrize(
    ("column", "value", "status"),
    [
        ("x_px", float("nan"), "bad_measurement"),
        ("y_px", None, "bad_measurement"),
        ("x_px", float("inf"), "bad_measurement"),
        ("h_g_m", None, "no_ground"),
        ("h_g_m", float("nan"), "no_ground"),
        ("h_g_m", -6000.0, "no_ground"),
        ("h_g_m", 40_000.0, "no_ground"),
        ("image", None, "no_station"),
        ("image", "nowhere_01", "no_station"),
        ("image", "", "no_station"),
        ("x_px", 3e9, "outside_camera"),
        ("x_px", -1e5, "outside_camera"),
        ("h_g_m", 9000.0, "misses_ground"),
    ],
)
def test_a_row_that_cannot_be_corrected_stays(mission, baseline, column, value, status):
    given = spoil_cells(mission, column, [0, 7], value)
    text = accepted(mission.run(), 3)
    result = mission.results()
    assert result.num_rows == given.num_rows
    flagged = [i for i, s in enumerate(result["status"].to_pylist()) if s != "ok"]
    assert flagged == [0, 7]
    assert {result["status"][i].as_py() for i in flagged} == {status}
    for name in ("x_corrected_px", "y_corrected_px", "r_c_rad"):
        assert [i for i, v in enumerate(result[name].to_pylist()) if v is None] == [0, 7]
        left = pc.filter(result[name], pc.equal(result["status"], "ok"))
        want = pc.filter(baseline.results()[name], pc.equal(result["status"], "ok"))
        assert left.equals(want)
    # An image that the log does not know is one loss, which stands for its rows.
    is_unknown_image = column == "image" and value is not None
    assert ("IMAGES-UNMATCHED" if is_unknown_image else "2 of") in text
    assert status in text
    of_no_ground = column == "h_g_m" and value in (-6000.0, 40_000.0)
    assert ("OBS-GROUND-RANGE" in text) == of_no_ground
    assert result["point"].to_pylist() == given["point"].to_pylist()


def test_text_among_the_pixels_of_a_csv(mission):
    lines = csv_text(mission).splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([*cells[:2], "n/a", *cells[3:]])
    mission.observe_text("\n".join(lines) + "\n")
    accepted(mission.run(), 3)
    status = mission.results()["status"].to_pylist()
    assert status[2] == "bad_measurement"
    assert status.count("ok") == len(status) - 1


# ---- the output folder


def test_a_file_in_the_place_of_the_output_folder(mission):
    (mission.folder / "results").write_text("a file")
    refused(mission.run(), "STORAGE-WRITE", 5)
    mission.config["output"]["path"] = "results/deeper"
    refused(mission.run(), "STORAGE-WRITE", 5)


def test_a_folder_with_files_of_others_is_left_alone(mission):
    own = mission.folder / "observations"
    own.mkdir()
    (own / "mine.csv").write_text("do not lose this")
    mission.config["output"]["path"] = "."
    refused(mission.run(), "STORAGE-NOT-OURS", 5)
    assert (own / "mine.csv").read_text() == "do not lose this"


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
    given = mission.folder / mission.config[section]["path"]
    mine = mission.output / name
    mine.parent.mkdir(parents=True)
    (mission.output / ".lock").touch()
    given.rename(mine)
    content = mine.read_bytes()
    mission.config[section]["path"] = f"results/{name}"
    assert name in refused(mission.run(), "OUTPUT-OVER-INPUT", 2)
    refused(unbend("check", mission.save()), "OUTPUT-OVER-INPUT", 2)
    refused(mission.run("--force"), "OUTPUT-OVER-INPUT", 2)
    assert mine.read_bytes() == content


def test_links_to_and_from_the_results(mission, tmp_path):
    """The link among the results would be lost, and what the link leads to among them, too."""
    results = mission.output / "observations"
    results.mkdir(parents=True)
    (mission.output / ".lock").touch()
    table = (mission.folder / "observations.parquet").read_bytes()
    (results / "real.parquet").write_bytes(table)
    (mission.folder / "link.parquet").symlink_to(results / "real.parquet")
    (results / "link.parquet").symlink_to(mission.folder / "observations.parquet")
    for name in ("link.parquet", "results/observations/link.parquet"):
        mission.config["observations"]["path"] = name
        refused(mission.run(), "OUTPUT-OVER-INPUT", 2)
    alias = tmp_path / "alias"
    alias.symlink_to(mission.output)
    mission.config["output"]["path"] = str(alias)
    mission.config["observations"]["path"] = "results/observations/real.parquet"
    refused(mission.run(), "OUTPUT-OVER-INPUT", 2)
    assert (results / "real.parquet").read_bytes() == table


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


def test_a_folder_in_use(mission):
    with open_folder(mission.output):
        refused(mission.run(), "OUTPUT-IN-USE", 4)
    accepted(mission.run(), 0)


def test_a_full_disk(mission, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    assert "No space left" in refused(mission.run(), "STORAGE-WRITE", 5)
    assert [p.name for p in mission.output.iterdir()] == [".lock"]
    monkeypatch.undo()
    accepted(mission.run(), 0)


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
    second.write_text(first.read_text(encoding="utf-8").replace("simulated_bin", "other"))
    ended = unbend("run", first, second)
    assert "mission.yaml" in refused(ended, "OUTPUT-SHARED", 6)
    assert '"mission": "simulated_bin"' in (mission.output / "manifest.json").read_text()


def test_an_error_of_ours_costs_one_mission_only(mission_factory, tmp_path, unbend, monkeypatch):
    from unbend.stages import story

    good = mission_factory(tmp_path / "good")
    bad = mission_factory(tmp_path / "bad")
    bad.config["mission"]["name"] = "unlucky"
    real = story.flight_log

    def flight_log(mission, *arguments):
        if mission.mission.name == "unlucky":
            raise KeyError("never thought of")
        return real(mission, *arguments)

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
        ["simulate", "s3://bucket/flown"],
        ["inspect", "s3://bucket/flight.bin"],
        ["init", "az://bucket/flight.bin"],
        ["profile", "--csv=s3://bucket/profile.csv"],
        ["schema", "--out", "s3://bucket/s.json"],
        ["simulate", "s3://bucket/a?sig=hunter2"],
    ],
)
def test_urls_where_paths_are_taken(words, unbend, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = refused(unbend(*words), "URL-INVALID", 2)
    assert "hunter2" not in said
    assert list(tmp_path.iterdir()) == []
