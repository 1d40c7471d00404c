"""Several missions: which folders are one, in which order they run, and the exit code of all."""

import contextlib
from pathlib import Path

import pytest

from unbend.batch.campaigns import select_missions
from unbend.batch.execute import exit_code_of_command, run_many, shard_of
from unbend.batch.executors import Bug, Inline, Outcome
from unbend.config.campaign import MissionRef
from unbend.errors import InputError


def test_folders_that_links_make_one_are_one(mission_factory, tmp_path):
    first, linked, up_and_down, other = (mission_factory(tmp_path / name) for name in "abcd")
    first.output.mkdir()
    (tmp_path / "link").symlink_to(first.output)
    (tmp_path / "up").symlink_to(tmp_path)
    linked.config["output"]["path"] = "../link"
    up_and_down.config["output"]["path"] = "../up/d/../a/results"
    files = [mission.save() for mission in (first, linked, up_and_down, other)]

    refusals = select_missions(files).refused

    assert [ref.path for ref in refusals] == [linked.file, up_and_down.file]
    for error in refusals.values():
        assert error.code == "OUTPUT-SHARED"
        assert str(first.file) in str(error)


def missions_named(*names) -> list[MissionRef]:
    return [MissionRef(Path(f"{name}.yaml")) for name in names]


def test_the_receipt_of_a_receipt_keeps_the_fingerprint():
    receipt = Outcome("a", Path("a"), None, 3, True, fingerprint="5eed")
    assert receipt.receipt() == receipt


def test_missions_run_in_the_order_given_and_no_end_stops_the_rest():
    begun = []

    def run_mission(mission: MissionRef, /, *, progress=None) -> Outcome:
        path = mission.path
        begun.append((path.stem, progress))
        if path.stem == "buggy":
            raise KeyError("buggy")
        if path.stem == "refused":
            raise InputError("OBS-EMPTY", "no rows", where=str(path))
        return Outcome(path.stem, path, None, 0, False)

    @contextlib.contextmanager
    def bar(name):
        yield f"bar of {name}"

    missions = missions_named("buggy", "refused", "b", "a")

    ends = dict(run_many(run_mission, missions, Inline(bar)))

    assert begun == [
        ("buggy", "bar of buggy"),
        ("refused", "bar of refused"),
        ("b", "bar of b"),
        ("a", "bar of a"),
    ]
    assert list(ends) == missions
    bug, refusal, b, a = ends.values()
    assert isinstance(bug, Bug)
    assert "KeyError" in bug.traceback
    assert isinstance(refusal, InputError)
    assert b.name == "b"
    assert a.name == "a"


def test_an_interrupt_ends_all_missions():
    begun = []

    def run_mission(mission: MissionRef, /, *, progress=None) -> Outcome:
        begun.append(mission.path.stem)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(run_many(run_mission, missions_named("a", "b"), Inline(contextlib.nullcontext)))
    assert begun == ["a"]


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (1, ["abcdefg"]),
        (3, ["adg", "be", "cf"]),
        (9, [*"abcdefg", "", ""]),
    ],
)
def test_shards_are_all_missions_once(count, expected):
    shards = ["abcdefg"[shard_of(f"{number}/{count}")] for number in range(count)]
    assert shards == expected


@pytest.mark.parametrize("shard", ["3/3", "1", "-1/3", "a/b", "1/0", "0/", "1.0/3", "4/3"])
def test_what_is_no_shard_is_refused(refusal_of, tmp_path, shard):
    text = refusal_of("RUN-SHARD", 2, "run", tmp_path / "none.yaml", f"--shard={shard}")
    assert f"RUN-SHARD: {shard} is not a part" in text


def test_a_shard_may_be_empty(unbend, tmp_path):
    ended = unbend(
        "run",
        tmp_path / "none.yaml",
        "--shard",
        "1/2",
        "--json",
    )
    assert ended.code == 0
    assert ended.out == "[]\n"
    assert ended.err == ""


def test_a_scheduler_and_processes_do_not_go_together(refusal_of, tmp_path):
    words = ("--jobs", "2", "--scheduler", "tcp://127.0.0.1:9")
    refusal_of("RUN-ARGUMENTS", 2, "run", tmp_path / "none.yaml", *words)


def test_a_scheduler_that_is_not_there_is_said_once(unbend, mission_factory, tmp_path):
    missions = [mission_factory(tmp_path / name).save() for name in "ab"]
    ended = unbend("run", *missions, "--scheduler", tmp_path / "none.json")
    assert ended.code == 2
    assert ended.err.count("SCHEDULER-FILE") == 1
    assert not (tmp_path / "a" / "results").exists()


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        ([0], 0),
        ([0, 0], 0),
        ([1], 1),
        ([6, 1], 1),
        ([1, 0], 1),
        ([2], 2),
        ([3], 3),
        ([0, 3], 3),
        ([3, 0], 3),
        ([5], 5),
        ([0, 2], 6),
        ([3, 4], 6),
        ([5, 0], 6),
    ],
)
def test_the_exit_code_of_several(codes, expected):
    assert exit_code_of_command(codes) == expected
