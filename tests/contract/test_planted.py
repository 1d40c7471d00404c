"""The planted bugs can be planted: each place exists once, and what replaces it still parses."""

import ast
import tomllib

import pytest

from tests.contract.sources import ROOT, text_of
from tests.planted.changes import Source, changes_of
from tests.planted.draw import drawn_bugs

FILES = sorted((ROOT / "tests" / "planted").glob("*.toml"))
CONTENTS = {path.stem: tomllib.loads(text_of(path)) for path in FILES}
BUGS = [
    pytest.param(bug, id=f"{room}-{number}")
    for room, content in CONTENTS.items()
    for number, bug in enumerate(content["bug"], start=1)
]


@pytest.mark.parametrize("room", CONTENTS)
def test_a_list_of_planted_bugs_names_tests_that_exist(room):
    content = CONTENTS[room]
    assert set(content) == {"tests", "bug"}
    assert content["tests"]
    assert all((ROOT / tests).exists() for tests in content["tests"])
    places = [(bug["file"], bug["before"], bug["after"]) for bug in content["bug"]]
    assert len(set(places)) == len(places), "a bug is planted twice"


def assert_planted(file, before, after):
    """A place of a bug exists once, and what replaces it still parses and changes the code."""
    text = text_of(ROOT / file)
    assert text.count(before) == 1, f"'before' stands {text.count(before)} times"
    assert before != after
    if file.endswith(".py"):
        planted = ast.parse(text.replace(before, after))
        assert ast.dump(planted) != ast.dump(ast.parse(text)), "nothing that runs has changed"


@pytest.mark.parametrize("bug", BUGS)
def test_a_bug_can_be_planted(bug):
    assert (
        {"file", "before", "after", "what"}
        <= set(bug)
        <= {"file", "before", "after", "what", "first"}
    )
    assert bug["file"].startswith("pipeline/unbend/")
    assert_planted(bug["file"], bug["before"], bug["after"])
    assert "first" not in bug or (ROOT / bug["first"]).is_file()


def test_every_room_has_planted_bugs():
    package = ROOT / "pipeline" / "unbend"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").is_file()}
    planted = {parameters.values[0]["file"].split("/")[2] for parameters in BUGS}
    if rooms - planted:
        pytest.skip(f"no planted bugs yet in {', '.join(sorted(rooms - planted))}")
    assert len(BUGS) >= 120


def test_a_seed_draws_bugs_that_can_be_planted():
    bugs = drawn_bugs(12, seed=1)
    assert bugs == drawn_bugs(12, seed=1) != drawn_bugs(12, seed=2)
    for bug in bugs:
        assert_planted(bug.file, bug.before, bug.after)
        assert all((ROOT / name).exists() for name in (*bug.nearest, *bug.tests))


def test_changes_are_those_of_code_that_decides(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(
        '''"""A text: 1 < 2."""
import numpy as np
__all__ = ["a", "b"]
_BUFFER_BYTES = 1024


def area(a_m: float, turn: float = 0.5) -> float:
    """Not 3 either."""
    if a_m < 0 and not turn:
        raise ValueError(f"{a_m} of 7")
    return np.abs(a_m * turn)
''',
        encoding="utf-8",
    )
    source = Source(path)
    changes = [
        (source.content[change.start : change.end].decode(), change.after)
        for change in changes_of(source)
    ]
    numbers = [("0.5", "1.0"), ("0.5", "5.0"), ("0.5", "-0.5"), ("0.5", "1.5"), ("0", "1")]
    assert sorted(changes) == sorted(
        [
            *numbers,
            ("<", "<="),
            ("<", ">"),
            ("and", "or"),
            ("not turn", "(turn)"),
            ("np.abs(a_m * turn)", "(a_m * turn)"),
            ("*", "/"),
        ]
    )
