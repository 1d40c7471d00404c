"""Several missions: which folders are one, in which order they run, and the exit code of all."""

from __future__ import annotations

import contextlib
from itertools import chain
from pathlib import Path

import pytest

from unbend.batch.campaigns import select_missions
from unbend.batch.execute import exit_code_of_command, run_many, shard_of
from unbend.batch.executors import Bug, Inline, Outcome
from unbend.config.campaign import MissionRef
from unbend.errors import InputError


def test_folders_that_links_make_one_are_one(mission_factory, tmp_path):
    first, second, third, fourth = (mission_factory(tmp_path / name) for name in "abcd")
    first.output.mkdir()
    (tmp_path / "link").symlink_to(first.output)
    (tmp_path / "up").symlink_to(tmp_path)
    second.config["output"]["path"] = "../link"
    third.config["output"]["path"] = "../up/d/../a/results"
    files = [mission.save() for mission in (first, second, third, fourth)]
    refused = select_missions(files).refused
    assert [ref.path for ref in refused] == files[1:3]
    for error in refused.values():
        assert error.code == "OUTPUT-SHARED"
        assert str(files[0]) in str(error)


def test_a_broken_mission_file_shares_nothing(mission_factory, tmp_path):
    first, second = (mission_factory(tmp_path / name) for name in "ab")
    files = [first.save(), second.save()]
    files[0].write_text("mission: [")
    assert select_missions(files).refused == {}


def silent(_: str) -> contextlib.AbstractContextManager[None]:
    return contextlib.nullcontext()


def test_missions_run_in_the_order_given_and_no_end_stops_the_rest():
    begun = []

    def run_mission(mission: MissionRef, /, *, progress: object = None) -> Outcome:
        path = mission.path
        begun.append((path.stem, progress))
        if path.stem == "buggy":
            raise KeyError("buggy")
        if path.stem == "refused":
            raise InputError("OBS-EMPTY", "no rows", where=str(path))
        return Outcome(path.stem, path, None, 0, False)

    @contextlib.contextmanager
    def bar(name: str):
        yield f"bar of {name}"

    missions = [MissionRef(Path(f"{name}.yaml")) for name in ("buggy", "refused", "b", "a")]
    ends = dict(run_many(run_mission, missions, Inline(bar)))
    names = [mission.path.stem for mission in missions]
    assert begun == [(name, f"bar of {name}") for name in names]
    assert list(ends) == missions
    bug, refused, *done = ends.values()
    assert isinstance(bug, Bug)
    assert "KeyError" in bug.traceback
    assert isinstance(refused, InputError)
    assert [end.name for end in done if isinstance(end, Outcome)] == ["b", "a"]


def test_shards_are_all_missions_once():
    missions = [MissionRef(Path(f"{name}.yaml")) for name in "abcdefg"]
    for count in (1, 3, 9):
        run = [missions[shard_of(f"{i}/{count}")] for i in range(count)]
        assert sorted(chain(*run), key=missions.index) == missions
        assert max(map(len, run)) - min(map(len, run)) <= 1


def test_what_is_no_shard_is_refused(unbend, tmp_path):
    for shard in ("3/3", "1", "-1/3", "a/b", "1/0", "0/", "1.0/3", "4/3"):
        ended = unbend("run", tmp_path / "none.yaml", f"--shard={shard}")
        assert ended.code == 2, shard
        assert f"RUN-SHARD: {shard} is not a part" in ended.err
    ended = unbend("run", tmp_path / "none.yaml", "--shard", "1/2", "--json")
    assert (ended.code, ended.out, ended.err) == (0, "[]\n", "")


def test_a_scheduler_and_processes_do_not_go_together(unbend, tmp_path):
    ended = unbend("run", tmp_path / "none.yaml", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:9")
    assert ended.code == 2
    assert ended.err.startswith("RUN-ARGUMENTS: ")


def test_a_scheduler_that_is_not_there_is_said_once(unbend, mission_factory, tmp_path):
    missions = [mission_factory(tmp_path / name).save() for name in "ab"]
    ended = unbend("run", *missions, "--scheduler", tmp_path / "none.json")
    assert ended.code == 2
    assert ended.err.count("SCHEDULER-FILE") == 1
    assert not (tmp_path / "a" / "results").exists()


def test_interrupts_of_the_user_pass_through():
    def run_mission(mission: MissionRef, /, *, progress: object = None) -> Outcome:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(run_many(run_mission, [MissionRef(Path("a.yaml"))], Inline(silent)))


@pytest.mark.parametrize(
    ("codes", "code"),
    [([0], 0), ([3], 3), ([2], 2), ([5], 5), ([0, 0], 0), ([0, 3], 3), ([3, 0], 3), ([0, 2], 6),
     ([3, 4], 6), ([5, 0], 6), ([6, 1], 1), ([1, 0], 1), ([1], 1)],
)  # fmt: skip
def test_the_exit_code_of_several(codes, code):
    assert exit_code_of_command(codes) == code
