"""What a run may take away in its folder, and what not."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.helpers import refused
from unbend.batch import store
from unbend.batch.store import (
    RunFolder,
    find_damage,
    open_folder,
    read_manifest,
    rehearse_folder,
)
from unbend.errors import StorageError
from unbend.tables.manifest.whole import Manifest

PART = "observations/part-00000.parquet"


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def manifest_of(run: RunFolder) -> Manifest:
    """The shortest manifest of the results in a folder."""
    return Manifest(
        {
            "fingerprint": "f",
            "mission": "m",
            "exit_code": 0,
            "outputs": [asdict(output) for output in run.outputs()],
        }
    )


def place_files(run: RunFolder, *names):
    """Results of a run, each with its own name in it."""
    for name in names:
        run.place(name).write_text(name, "utf-8")
        run.seal(name)


def commit(folder, *names):
    with open_folder(folder) as run:
        place_files(run, *names)
        run.commit(manifest_of(run))


def damage_of(folder, *, read=True):
    """What is damaged of the results in a folder, which have a manifest."""
    manifest = read_manifest(folder)
    assert manifest is not None
    return find_damage(folder, manifest, hash_all=read)


def test_files_of_the_user_stay(tmp_path):
    folder = tmp_path / "observations"
    commit(tmp_path, PART, "observations/part-00001.parquet")
    (folder / "notes.txt").write_text("mine", "utf-8")
    (folder / "sub").mkdir()
    commit(tmp_path, PART)
    assert names_in(folder) == {"notes.txt", "part-00000.parquet", "sub"}


@pytest.mark.parametrize("name", ["stations.parquet", "observations/mine.csv"])
def test_a_refused_run_does_not_make_a_folder_ours(tmp_path, name):
    with open_folder(tmp_path):
        pass  # refused before anything was committed
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("the user's", "utf-8")
    with refused("STORAGE-NOT-OURS"), open_folder(tmp_path):
        pass
    assert path.read_text("utf-8") == "the user's"


@pytest.mark.parametrize("name", ["stations.parquet", PART])
def test_a_flipped_byte_is_seen_by_a_rerun(tmp_path, name):
    commit(tmp_path, "stations.parquet", PART)
    assert damage_of(tmp_path, read=False) == []
    (tmp_path / name).write_text(name[:-1] + "T", "utf-8")
    assert damage_of(tmp_path, read=False) == [f"{name}: its content has changed"]


def test_a_file_has_no_manifest(tmp_path):
    file = tmp_path / "manifest.json"
    file.write_text("{}", "utf-8")
    assert read_manifest(file) is None
    file.chmod(0o777)
    with refused("STORAGE-WRITE") as refusal:
        rehearse_folder(file)
    refusal.match("Not a directory")


@pytest.mark.parametrize("outputs", [5, [5], "x"])
def test_a_manifest_of_somebody_else_is_refused(tmp_path, outputs):
    text = {"fingerprint": "", "mission": "", "exit_code": 0, "outputs": outputs}
    (tmp_path / "manifest.json").write_text(json.dumps(text), "utf-8")
    with refused("MANIFEST-UNREADABLE"):
        read_manifest(tmp_path)


# ---- what a power cut may leave: the order in which names and contents reach the disk


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    """Every flush, rename and removal below the folder, in order."""
    steps = []

    def record(owner, function):
        original = getattr(owner, function)

        def recorded(*arguments, **options):
            paths = [path for path in arguments if isinstance(path, Path)]
            names = [path.relative_to(tmp_path).as_posix() for path in paths]
            steps.append((function, *names))
            return original(*arguments, **options)

        monkeypatch.setattr(owner, function, recorded)

    record(store, "sync_file")
    record(store, "sync_folder")
    record(Path, "replace")
    record(Path, "unlink")
    return steps


def test_the_order_in_which_a_second_commit_reaches_the_disk(tmp_path, recorded):
    commit(tmp_path, PART, "stations.parquet")
    recorded.clear()
    commit(tmp_path, PART, "stations.parquet")
    assert recorded == [
        # What is staged is on the disk, content and names, before anything visible changes ...
        ("sync_file", f".staging/{PART}"),
        ("sync_file", ".staging/stations.parquet"),
        ("sync_file", ".staging/manifest.json"),
        ("sync_folder", ".staging"),
        ("sync_folder", ".staging/observations"),
        # ... the old manifest is gone from the disk before the first old result is replaced ...
        ("unlink", "manifest.json"),
        ("sync_folder", "."),
        ("replace", f".staging/{PART}", PART),
        ("replace", ".staging/stations.parquet", "stations.parquet"),
        ("sync_folder", "."),
        ("sync_folder", "observations"),
        # ... and the new one appears when all it names is there.
        ("replace", ".staging/manifest.json", "manifest.json"),
        ("sync_folder", "."),
    ]


def test_files_and_folders_are_really_flushed(tmp_path, monkeypatch):
    flushed = []
    original = os.fsync

    def fsync(handle):
        flushed.append(os.fstat(handle).st_ino)
        original(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    file = tmp_path / "file"
    file.write_text("content")
    store.sync_file(file)
    store.sync_folder(tmp_path)
    assert flushed == [file.stat().st_ino, tmp_path.stat().st_ino]
    with store.atomic_write(file) as draft:
        draft.write_text("other")
    assert flushed[2:] == [file.stat().st_ino]
    monkeypatch.delattr(os, "O_DIRECTORY")
    store.sync_folder(tmp_path)  # on Windows a folder cannot be opened
    assert len(flushed) == 3


@pytest.mark.parametrize("step", range(4))
@pytest.mark.parametrize("killed", [True, False], ids=["killed", "failed"])
def test_a_commit_that_ends_half_way_leaves_no_manifest_and_can_be_repeated(
    tmp_path, monkeypatch, step, killed
):
    """Stopped at each rename and at the removal of the staging folder."""
    names = (PART, "profile.parquet", "stations.parquet")
    commit(tmp_path, *names)
    count = 0

    def stop(source, target):
        nonlocal count
        if count == step:
            raise KeyboardInterrupt if killed else OSError(28, "No space left on device")
        count += 1
        source.replace(target)

    monkeypatch.setattr(store, "replace_file", stop)

    def commit_and_stop():
        with open_folder(tmp_path) as run:
            place_files(run, *names)
            if killed:  # a killed process does not clean up
                monkeypatch.setattr(store, "_clear_interrupted", lambda path, resumable: None)
            run.commit(manifest_of(run))

    with pytest.raises(KeyboardInterrupt if killed else StorageError):
        commit_and_stop()
    assert (tmp_path / ".staging").exists() is killed
    assert read_manifest(tmp_path) is None
    monkeypatch.undo()
    commit(tmp_path, *names)
    assert damage_of(tmp_path) == []
    assert not (tmp_path / ".staging").exists()


@pytest.mark.parametrize("killed", [True, False], ids=["killed", "failed"])
def test_a_file_of_the_user_among_interrupted_results_does_not_stop_the_next_run(
    tmp_path, monkeypatch, killed
):
    """A full disk in the middle of a commit, a run that is refused, and one that succeeds."""
    commit(tmp_path, PART, "stations.parquet")
    folder = tmp_path / "observations"
    notes = folder / "notes.txt"
    notes.write_text("mine", "utf-8")

    def full(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "replace_file", full)
    if killed:
        monkeypatch.setattr(store.shutil, "rmtree", lambda path: None)
    with refused("STORAGE-WRITE"):
        commit(tmp_path, PART, "stations.parquet")
    monkeypatch.undo()
    for _ in range(2):  # ends before it commits anything
        with open_folder(tmp_path):
            assert names_in(tmp_path / ".staging") == {"manifest.json"}
    assert names_in(folder) == {"notes.txt"}
    commit(tmp_path, PART, "stations.parquet")
    assert damage_of(tmp_path) == []
    assert notes.read_text("utf-8") == "mine"
    assert not (tmp_path / ".staging").exists()


def test_a_target_that_a_viewer_has_open_is_replaced_a_moment_later(tmp_path, monkeypatch):
    """Windows answers with PermissionError until the other program closes the file."""
    source = tmp_path / "new"
    target = tmp_path / "old"
    source.write_text("new")
    target.write_text("old")
    original = Path.replace
    refused = []

    def replace(self, other):
        if len(refused) < 3:
            refused.append(other)
            raise PermissionError(13, "in use")
        return original(self, other)

    monkeypatch.setattr(Path, "replace", replace)
    monkeypatch.setattr(store, "_REPLACE_PAUSE_S", 0.0)
    monkeypatch.setattr(store, "_REPLACE_ATTEMPTS", 3)
    with pytest.raises(PermissionError):
        store.replace_file(source, target)
    refused.clear()
    monkeypatch.setattr(store, "_REPLACE_ATTEMPTS", 4)
    store.replace_file(source, target)
    assert target.read_text() == "new"


# ---- the lock


def test_one_writer_at_a_time_also_through_a_link(tmp_path):
    results = tmp_path / "results"
    alias = tmp_path / "alias"
    alias.symlink_to(results)
    with open_folder(results):
        for folder in (results, alias):
            with refused("OUTPUT-IN-USE"), open_folder(folder):
                pass
    with open_folder(alias):
        pass


def test_a_lock_that_is_a_link_is_refused(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    (results / ".lock").symlink_to(tmp_path / "elsewhere")
    with refused("STORAGE-SYMLINK"), open_folder(results):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_the_lock_of_a_process_that_died_is_free(tmp_path):
    code = (
        "import os, sys; from pathlib import Path\n"
        "from unbend.batch.store import open_folder\n"
        "with open_folder(Path(sys.argv[1])): os._exit(9)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert done.returncode == 9
    assert names_in(tmp_path) == {".lock", ".staging"}
    commit(tmp_path, "stations.parquet")
    assert read_manifest(tmp_path) is not None


def refusing_lock(error):
    """Locks that nobody gets, for the error that the system would give."""

    class Refusing:
        def __init__(self, path, timeout):
            assert (path.name, timeout) == (".lock", 0)

        def acquire(self):
            raise error

    return Refusing


def test_a_disk_without_locks_is_refused_with_its_words(tmp_path, monkeypatch):
    no_locks = OSError(errno.ENOLCK, "No locks available")
    monkeypatch.setattr(store, "FileLock", refusing_lock(no_locks))
    with refused("STORAGE-LOCK") as refusal, open_folder(tmp_path):
        pass
    refusal.match("No locks available")


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM, errno.EROFS])
def test_a_folder_that_may_not_be_written_to_is_not_taken_for_a_disk_without_locks(
    tmp_path, monkeypatch, number
):
    lock = str(tmp_path / ".lock")
    read_only = OSError(number, os.strerror(number), lock)
    monkeypatch.setattr(store, "FileLock", refusing_lock(read_only))
    with refused("STORAGE-WRITE") as refusal, open_folder(tmp_path):
        pass
    refusal.match(os.strerror(number))
    assert refusal.value.where == lock


@pytest.mark.parametrize(
    ("path", "is_result"),
    [
        ("results/stations.parquet", True),
        ("link.parquet", True),
        ("results/observations/out.parquet", True),
        ("alias/manifest.json", True),
        ("results/../results/report.html", True),
        ("results/.lock", True),
        ("results/.staging/flight.bin", True),
        ("results/flight.bin", False),
        ("elsewhere.parquet", False),
        ("observations/own.parquet", False),
    ],
)
def test_files_among_the_results_by_any_path(tmp_path, path, is_result):
    results = tmp_path / "results"
    observations = results / "observations"
    observations.mkdir(parents=True)
    (observations / "real.parquet").touch()
    (tmp_path / "link.parquet").symlink_to(observations / "real.parquet")
    (observations / "out.parquet").symlink_to(tmp_path / "elsewhere.parquet")
    (tmp_path / "alias").symlink_to(results)
    assert store.would_replace(results, tmp_path / path) is is_result
    assert store.would_replace(tmp_path / "alias", observations / "real.parquet")


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    def make(folder):
        (folder / "inner").mkdir(parents=True)
        (folder / "inner" / "first.txt").touch()

    with refused("STORAGE-WRITE"), store.atomic_write(tmp_path / "made") as draft:
        make(draft)
        raise OSError(28, "no space")
    assert names_in(tmp_path) == set()

    with store.atomic_write(tmp_path / "made") as draft:
        make(draft)
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert names == {"made", "made/inner", "made/inner/first.txt"}
