"""The planted bugs can be planted: each place exists once, and what replaces it still parses."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "tests" / "planted").glob("*.toml"))
CONTENTS = {path.stem: tomllib.loads(path.read_text(encoding="utf-8")) for path in FILES}
BUGS = [
    pytest.param(bug, id=f"{room}-{number}")
    for room, content in CONTENTS.items()
    for number, bug in enumerate(content["bug"], start=1)
]


@pytest.mark.parametrize("room", CONTENTS)
def test_a_list_of_planted_bugs_names_tests_that_exist(room: str) -> None:
    content = CONTENTS[room]
    assert set(content) == {"tests", "bug"}
    assert content["tests"]
    assert all((ROOT / tests).exists() for tests in content["tests"])
    places = [(bug["file"], bug["before"], bug["after"]) for bug in content["bug"]]
    assert len(set(places)) == len(places), "a bug is planted twice"


@pytest.mark.parametrize("bug", BUGS)
def test_a_bug_can_be_planted(bug: dict[str, Any]) -> None:
    assert {"file", "before", "after", "what"} <= set(bug) <= {
        "file", "before", "after", "what", "first"}  # fmt: skip
    assert bug["file"].startswith("pipeline/unbend/")
    text = (ROOT / bug["file"]).read_text(encoding="utf-8")
    assert text.count(bug["before"]) == 1, f"'before' stands {text.count(bug['before'])} times"
    assert bug["before"] != bug["after"]
    if bug["file"].endswith(".py"):
        planted = ast.parse(text.replace(bug["before"], bug["after"]))
        assert ast.dump(planted) != ast.dump(ast.parse(text)), "nothing that runs has changed"
    assert "first" not in bug or (ROOT / bug["first"]).is_file()


def test_every_room_has_planted_bugs() -> None:
    package = ROOT / "pipeline" / "unbend"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").is_file()}
    planted = {parameters.values[0]["file"].split("/")[2] for parameters in BUGS}
    if rooms - planted:
        pytest.skip(f"no planted bugs yet in {', '.join(sorted(rooms - planted))}")
    assert len(BUGS) >= 120
