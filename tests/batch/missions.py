"""Missions that are named for what they do, and write down every beginning.

No mission file is read, so the rooms that read them, a second and a half of each process, are not
imported. As a program: runs some in so many processes, or on a cluster, and prints how each ended.
"""

import json
import os
import signal
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from unbend.batch.execute import run_many
from unbend.batch.executors import Bug, Outcome
from unbend.batch.store import open_folder, read_manifest
from unbend.errors import InputError
from unbend.tables.manifest.whole import Manifest


@dataclass(frozen=True)
class Unread:
    """A reference to a mission whose file nobody reads."""

    path: Path

    @property
    def run_arguments(self):
        return (str(self.path),)


class KillsWhoLooks(type(Path())):
    """The path of a mission file; the first worker whose process looks for the file dies."""

    def is_file(self):
        if self.suffix != ".yaml":  # what is derived from the path is of this class too
            return super().is_file()
        try:
            self.with_suffix(".looked").touch(exist_ok=False)
        except FileExistsError:
            return super().is_file()
        os.kill(os.getppid(), signal.SIGKILL)
        return True


def gone(process):
    """Whether a process has ended."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def wait_until(happened, seconds=200.0):
    """Wait for what another process does; fail where it has not happened by then."""
    limit = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < limit
        time.sleep(0.02)


def run_mission(mission, *, progress=None):
    """Run a mission as its name says: deadly ones kill their process, buggy ones raise."""
    name = mission.path.stem
    here = mission.path.parent
    output = here / f"results of {name}"
    with open_folder(output) as folder:  # as `run_plan`: removes what a killed run left
        if (finished := read_manifest(output)) is not None:
            return Outcome(name, output, finished, 3, True)
        with (here / "begun").open("a") as file:
            print(name, os.getpid(), file=file)
        mark = here / name
        has_died = mark.exists()
        if name.startswith("deadly") or (name.startswith("unlucky") and not has_died):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if name.startswith("leaving"):
            os._exit(0)
        if name.startswith("buggy"):
            raise KeyError(name)
        if name.startswith("refused"):
            raise InputError("OBS-EMPTY", "nothing", where=str(mission.path))
        folder.place("stations.parquet").write_bytes(name.encode() * 1000)
        time.sleep(float((here / "pace").read_text()))
        os.write(1, b"what a library prints\n")
        folder.seal("stations.parquet")
        manifest = Manifest(
            {
                "fingerprint": name,
                "mission": name,
                "exit_code": 3,
                "outputs": [asdict(output) for output in folder.outputs()],
            }
        )
        if not name.startswith("elsewhere"):
            folder.commit(manifest)
    return Outcome(name, output, manifest, 3, False)


def lose_patience(folder):
    """Wait less long for answers once a worker was stopped: before, a busy machine may be slow."""
    from unbend.batch import dask_answers

    while not (folder / "frozen").exists():
        time.sleep(0.1)
    dask_answers.ANSWER_S = 15.0


def main():
    from unbend.batch import dask_executor
    from unbend.batch.dask_executor import DaskExecutor
    from unbend.batch.processes import Processes

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # as the command line has it
    workers, folder, *names = sys.argv[1:]
    if "--impatient" in names:
        names.remove("--impatient")
        dask_executor._LOOK_S = 1.0
        threading.Thread(target=lose_patience, args=(Path(folder),), daemon=True).start()
    executor = Processes(int(workers)) if workers.isdecimal() else DaskExecutor(workers)
    missions = [Unread(Path(folder) / f"{name}.yaml") for name in names]
    for mission, end in run_many(run_mission, missions, executor):
        if isinstance(end, Outcome):
            assert end.exit_code == 3
            assert end.manifest.run.fingerprint == end.name
            word = "repeated" if end.repeated else "done"
        elif isinstance(end, Bug):
            word = "bug"
        else:
            word = end.code
        print(json.dumps([mission.path.stem, word, str(end)]), flush=True)


if __name__ == "__main__":
    # As any program would that is not this one: what is sent to others is of the module `missions`.
    import missions

    missions.main()
