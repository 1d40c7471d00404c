"""What has lost its refraction is not corrected again: sidecars, marks in databases, columns."""

import hashlib
import json
import sqlite3
from contextlib import closing

import pytest

from tests.helpers import refused
from unbend.tables.refraction_mark import refuse_marked, sidecar_text

TEXT = "image,point,x_px,y_px\na,p,1,2\n"


@pytest.fixture
def exported(tmp_path):
    """A folder with tracks.csv, its sidecar, and cameras.json that the sidecar does not name."""
    (tmp_path / "tracks.csv").write_text(TEXT)
    (tmp_path / "cameras.json").write_text("{}")
    text = sidecar_text({"tracks.csv": tmp_path / "tracks.csv"}, {"frame": "east, north, up"})
    (tmp_path / "tracks.csv.unbend.json").write_text(text)
    return tmp_path


def test_the_sidecar_says_what_it_is_about(exported):
    content = json.loads((exported / "tracks.csv.unbend.json").read_text())
    assert content == {
        "unbend.refraction": "removed",
        "files": [{"name": "tracks.csv", "sha256": hashlib.sha256(TEXT.encode()).hexdigest()}],
        "frame": "east, north, up",
    }


def test_a_file_that_a_sidecar_names_is_refused_under_any_name(exported):
    with refused("OBS-ALREADY-CORRECTED"):
        refuse_marked(exported / "tracks.csv")
    renamed = (exported / "tracks.csv").rename(exported / "measured.csv")
    with refused("OBS-ALREADY-CORRECTED"):
        refuse_marked(renamed)
    with refused("OBS-ALREADY-CORRECTED"):  # the folder, by the file in it
        refuse_marked(exported)
    refuse_marked(renamed, "apply")  # ideal observations may be displaced


def test_other_files_beside_it_are_read(exported):
    refuse_marked(exported / "cameras.json")
    (exported / "other.csv").write_text(TEXT + "a,q,3,4\n")
    refuse_marked(exported / "other.csv")
    (exported / "tracks.csv").rename(exported.parent / "tracks.csv")
    refuse_marked(exported)
    refuse_marked(exported.parent / "tracks.csv")  # away from its sidecar nothing is known


def test_a_file_that_was_written_to_since(exported):
    """A line added by an editor does not wash it clean."""
    (exported / "tracks.csv").write_text(TEXT + "\n")
    with refused("OBS-MARK-CHANGED"):
        refuse_marked(exported / "tracks.csv")
    with refused("OBS-MARK-CHANGED"):
        refuse_marked(exported)


@pytest.mark.parametrize(("listed", "other"), [("images.bin", "txt"), ("images.txt", "bin")])
def test_a_model_of_colmap_in_its_other_form_keeps_its_mark(tmp_path, listed, other):
    exported = tmp_path / listed
    exported.write_text("1 2 3")
    (tmp_path / f"{listed}.unbend.json").write_text(sidecar_text({listed: exported}, {}))
    exported.rename(tmp_path / f"images.{other}").write_text("the same, written by COLMAP")
    with refused("OBS-MARK-CHANGED"):
        refuse_marked(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"files": [{"name": "a"}]}', '{"files": 3}'])
def test_a_damaged_sidecar_says_nothing_and_nothing_passes(exported, text):
    (exported / "tracks.csv.unbend.json").write_text(text)
    with refused("OBS-MARK-UNREADABLE"):
        refuse_marked(exported / "cameras.json")


def test_a_database_carries_its_mark(tmp_path):
    for value in ("removed", "applied", None):
        path = tmp_path / f"{value}.db"
        with closing(sqlite3.connect(path)) as database:
            database.execute("CREATE TABLE keypoints (image_id INTEGER)")
            if value is not None:
                database.execute("CREATE TABLE unbend (key TEXT, value TEXT)")
                database.execute("INSERT INTO unbend VALUES ('unbend.refraction', ?)", (value,))
            database.commit()
    with refused("OBS-ALREADY-CORRECTED"):
        refuse_marked(tmp_path / "removed.db")
    refuse_marked(tmp_path / "applied.db")
    refuse_marked(tmp_path / "None.db")
    (tmp_path / "torn.db").write_bytes((tmp_path / "removed.db").read_bytes()[:3000])
    refuse_marked(tmp_path / "torn.db")  # no mark can be read; its reader refuses it


def test_run_refuses_a_table_that_a_sidecar_names(unbend, mission):
    path = mission.folder / mission.config["observations"]["path"]
    (mission.folder / "else.unbend.json").write_text(sidecar_text({path.name: path}, {}))
    assert "else.unbend.json" in mission.refusal("OBS-ALREADY-CORRECTED")
    checked = unbend("check", mission.file)
    assert checked.code == 6, checked.text
    assert "OBS-ALREADY-CORRECTED" in checked.err
