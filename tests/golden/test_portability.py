"""The sample mission where Python has nothing that only POSIX has: see `like_windows`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from tests.logs import REPOSITORY

SAMPLE = REPOSITORY / "configs" / "sample_bin.yaml"

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/fd").is_dir(), reason="what is open is read from /proc"
)


# Commands one after the other, which end well; a form feed ends the words of each.
COMMANDS = r"""
import json, sys
from unbend.cli import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["unbend", *words]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    print(end="\f", flush=True)
"""


@pytest.fixture(scope="module")
def like_windows(tmp_path_factory):
    """Runs a Python that lacks what Windows lacks, its console in the code page 1252."""
    folder = tmp_path_factory.mktemp("like_windows")
    helper = Path(__file__).with_name("like_windows.py")
    (folder / "sitecustomize.py").write_text(
        f"import runpy\nrunpy.run_path({str(helper)!r})['install']()\n", encoding="utf-8"
    )
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(folder), str(REPOSITORY), *filter(None, inherited)]),
        "PYTHONWARNDEFAULTENCODING": "1",
        "PYTHONIOENCODING": "cp1252",
    }

    def run(*words, code=0):
        done = subprocess.run(
            [sys.executable, *map(str, words)],
            capture_output=True,
            env=environment,
            cwd=folder,
            timeout=600,
            check=False,
        )
        out = done.stdout.decode("cp1252")
        err = done.stderr.decode("cp1252", "replace")
        assert done.returncode == code, f"{done.returncode}\n{out[-3000:]}\n{err[-3000:]}"
        assert "Traceback" not in err, err
        return out

    run.folder = folder
    return run


def sample(folder, name):
    """The sample's mission file with absolute inputs and a folder of results of its own."""
    config = yaml.safe_load(SAMPLE.read_text("utf-8"))
    for section in ("log", "observations"):
        config[section]["path"] = str((SAMPLE.parent / config[section]["path"]).resolve())
    config["mission"]["name"] = name
    config["output"]["path"] = f"results/{name}"
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
    return path


@pytest.mark.parametrize(
    "code",
    [
        "import fcntl",
        "import os; os.register_at_fork(before=print)",
        "import os; os.open('.', os.O_RDONLY)",
        "import signal; signal.SIGKILL",
        "import multiprocessing; multiprocessing.get_context('fork')",
        "f = open('held', 'wb'); import os; open('new', 'wb').close(); os.replace('new', 'held')",
        "f = open('held', 'wb'); import os; os.unlink('held')",
        "f = open('held', 'wb'); import os; os.rename('.', '../other')",
        "import os; os.fsync(open(os.devnull, 'rb'))",
        "print('\\u2265')",
    ],
)
def test_what_windows_lacks_is_missing(like_windows, code):
    with pytest.raises(AssertionError):
        like_windows("-c", code)


def test_what_a_library_holds_open_is_held(like_windows):
    library = "import os\ndef held(path):\n    return open(path, 'rb')\n"
    (like_windows.folder / "holder.py").write_text(library, "utf-8")
    made = "import holder, os\nopen('read', 'wb').close()\nfile = holder.held('read')\n"
    like_windows("-c", made)
    with pytest.raises(AssertionError, match="WinError 32"):
        like_windows("-c", made + "os.unlink('read')")


def test_the_rooms_can_be_imported(like_windows):
    rooms = ("refraction", "ingest", "batch.runs", "simulate", "cli", "report.report_page")
    like_windows("-c", "import " + ", ".join(f"unbend.{room}" for room in rooms))


def test_the_sample_runs_and_is_the_same(like_windows, runs, tmp_path):
    folder = tmp_path / "Vol \u03a9"  # no letter of code page 1252
    folder.mkdir()
    like_windows("-m", "unbend", "run", sample(folder, "first"))
    results = folder / "results" / "first"
    names = [path.relative_to(results) for path in sorted(results.rglob("*"))]
    assert not [name for name in names if set(str(name)) & set('<>:"|?*\\')], names
    rows, usual = (
        pq.read_table(output / "observations") for output in (results, runs["bin"].output)
    )
    assert usual.num_rows > 1000
    assert rows.equals(usual)


def test_missions_run_again_and_side_by_side(like_windows, mission_factory, tmp_path):
    missions = [mission_factory(tmp_path / "Vol \u03a9" / name) for name in ("first", "second")]
    first, second = (mission.save() for mission in missions)
    commands = [
        ("run", first),
        ("run", first),  # finds it up to date
        ("run", first, second, "--jobs", "2", "--force"),  # replaces it
        ("verify", missions[0].output),
    ]
    words = [[str(word) for word in each] for each in commands]
    texts = like_windows("-c", COMMANDS, json.dumps(words)).split("\f")
    assert len(texts) == len(commands) + 1
    assert "nothing to do" in texts[1]
    tables = [mission.results() for mission in missions]
    assert tables[0].num_rows > 10
    assert tables[0].equals(tables[1])


def test_logs_are_inspected(like_windows):
    logs = [
        str(REPOSITORY / "sample_logs" / f"flight.{suffix}") for suffix in ("bin", "tlog", "mcap")
    ]
    words = [["inspect", log, "--json"] for log in logs] + [["inspect", logs[0]]]
    *texts, shown, _ = like_windows("-c", COMMANDS, json.dumps(words)).split("\f")
    assert len(texts) == 3
    assert all(json.loads(text)["channels"] for text in texts)
    assert "BARO" in shown
