"""A folder in the place of a file is called a folder, with the file that may be meant."""

import pytest

from tests.helpers import refused
from unbend.batch.folders_as_files import folder_refusal
from unbend.batch.input_files import NamedInput
from unbend.batch.object_store import Place
from unbend.batch.plan import look_up_input, refuse_missing

LOG = NamedInput("log", "log.path", "flight/")
TABLE = NamedInput("observations", "observations.path", "tables")
SOUNDING = NamedInput("sounding 1", "atmosphere.soundings", "air")


@pytest.fixture
def folder(tmp_path):
    """A folder with files of these names."""

    def filled(*names):
        for name in names:
            (tmp_path / name).write_text("", "utf-8")
        return tmp_path

    return filled


@pytest.mark.parametrize(
    ("named", "files", "remedy"),
    [
        (LOG, ["a.BIN", "notes.txt", ".b.bin"], "perhaps log.path: flight/a.BIN"),
        (LOG, ["a.bin", "b.tlog"], "name the file in it: log.path in the mission file"),
        (TABLE, ["a.bin", "b.parquet"], "perhaps observations.path: tables/b.parquet"),
        (TABLE, ["a.csv", "b.csv"], "a block of another program needs observations.format"),
        (SOUNDING, ["20260401.edt"], "perhaps atmosphere.soundings: air/20260401.edt"),
        (SOUNDING, [], "name the file in it: atmosphere.soundings"),
    ],
)
def test_the_only_file_that_fits_is_named(folder, named, files, remedy):
    path = folder(*files)
    with refused("INPUT-FOLDER") as refusal:
        refuse_missing(named, path)
    assert "is a folder, not a file" in refusal.value.what
    assert remedy in refusal.value.remedy
    assert refusal.value.where == str(path)


def test_the_results_of_a_run_are_no_measurements(folder):
    run = folder("manifest.json", "report.html", "profile.parquet")
    parts = run / "observations"
    parts.mkdir()
    for path in (run, parts):
        refusal = folder_refusal(TABLE, path)
        assert "is the folder of the results of a run" in refusal.what
        assert "corrected already" in refusal.what
        assert "name the table of the measurements" in refusal.remedy
    of_log = folder_refusal(LOG, run)
    assert "is the folder of the results of a run" in of_log.what
    assert "name the log file: log.path" in of_log.remedy


def test_a_folder_of_object_storage_is_none_of_its_objects():
    with refused("INPUT-FOLDER"):
        look_up_input(LOG, Place.of("s3://flights/2026/"))
