"""Draw bugs blindly: mutation operators over every room of the package, by a seed.

    python tests/planted/draw.py [ROOM ...] [--drawn 60] [--seed 20261128]

prints the bugs that `run.py --drawn 60 --seed 20261128` plants. Whoever writes a list of bugs by
hand thinks of the tests while writing it; here a random number decides. First a line of code is
drawn among all that can be changed, so a room is as frequent as it is long; then one of the kinds
of change that the line allows; then one of the changes of that kind (`changes.py`).
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import sys
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.planted.changes import Change, Source, changes_of
from tests.planted.planted_bug import Bug, read_bugs

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGE = ROOT / "pipeline" / "unbend"
TOP_LEVEL = {"library": "library"}  # modules outside rooms; all others belong to `base`
NEAREST_FILES = 6  # test files that run before the others of the room
TESTS_OF_MESSAGES = "tests/contract/test_message_values.py"  # of every messages.py
LIKELY = 1.7  # score of a test file: more than a similar name in the same room


def room_of(path: Path) -> str:
    """The name of the list of planted bugs that names the tests of a module."""
    first = path.relative_to(PACKAGE).parts[0]
    return first if not first.endswith(".py") else TOP_LEVEL.get(path.stem, "base")


@cache
def test_texts() -> dict[str, str]:
    """Path and text of every test file."""
    paths = sorted((ROOT / "tests").rglob("test_*.py"))
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


@cache
def words_of(text: str) -> frozenset[str]:
    """The words of a test file."""
    return frozenset(re.findall(r"\w+", text))


def likeness(name: str, other: str) -> float:
    """Share of the words that two names of files have in common, 0 to 1."""
    words = set(name.split("_"))
    other_words = set(other.split("_"))
    return len(words & other_words) / len(words | other_words)


def nearest_tests(source: Source, line: int) -> tuple[str, ...]:
    """The module's own examples, then the test files that are likeliest to notice a bug in a line.

    Likely are files that import the module, bear its name, or name its functions.
    """
    module = source.path
    *packages, stem = module.relative_to(PACKAGE.parent).with_suffix("").parts
    package = ".".join(packages)
    imported = re.compile(rf"\b{package}\.{stem}\b|from {package} import [^\n]*\b{stem}\b")
    function = function_of(source, line)
    offered = [
        node.name
        for node in source.tree.body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and len(node.name) >= 8
    ]
    scores = {}
    for name, text in test_texts().items():
        words = words_of(text)
        score = likeness(stem, Path(name).stem.removeprefix("test_"))
        score += 2.0 * bool(imported.search(text))
        score += 2.0 * (Path(name).stem == f"test_{stem}")
        score += 1.5 * (function in words)
        score += min(1.5, 0.5 * len(words.intersection(offered)))
        score += 9.0 * (stem == "messages" and name == TESTS_OF_MESSAGES)
        scores[name] = score + 0.5 * name.startswith(f"tests/{room_of(module)}/")
    likeliest = sorted(scores, key=lambda name: -scores[name])
    likely = [name for name in likeliest if scores[name] >= LIKELY]
    return (str(module.relative_to(ROOT)), *(likely or likeliest)[:NEAREST_FILES])


def function_of(source: Source, line: int) -> str:
    """Name of the innermost function around a line, or nothing."""
    name = ""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0):
            name = node.name
    return name


def bug_of(source: Source, change: Change, index: int) -> Bug:
    """The record of a change. Its `before` takes in lines around it until it stands only once."""
    first = source.content.rfind(b"\n", 0, change.start) + 1
    end = source.content.find(b"\n", change.end)
    while source.content.count(source.content[first:end]) > 1:
        first = source.content.rfind(b"\n", 0, max(first - 1, 0)) + 1
    before = source.content[first:end].decode("utf-8")
    head = source.content[first : change.start].decode("utf-8")
    tail = source.content[change.end : end].decode("utf-8")
    shown = source.content[change.start : change.end].decode("utf-8")
    room = room_of(source.path)
    return Bug(
        room=room,
        index=index,
        tests=read_bugs(HERE / f"{room}.toml")[0].tests,
        file=str(source.path.relative_to(ROOT)),
        before=before,
        after=head + change.after + tail,
        what=f"line {change.line}, {change.kind}: {shown!r} -> {change.after!r}",
        nearest=nearest_tests(source, change.line),
    )


@cache
def changes_by_line() -> dict[tuple[Source, int], list[Change]]:
    """All changes of the package that may be drawn."""
    changes = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        source = Source(path)
        for change in changes_of(source):
            changes[source, change.line].append(change)
    return dict(changes)


def drawn_bugs(number: int, seed: int, rooms: Sequence[str] = ()) -> list[Bug]:
    """So many bugs by a seed, in all rooms or in some, sorted by file and line.

    Fewer where the rooms have fewer lines that can be changed.
    """
    lines = [
        (source, line)
        for source, line in changes_by_line()
        if not rooms or room_of(source.path) in rooms
    ]
    draw = random.Random(seed)
    drawn = draw.sample(range(len(lines)), min(number, len(lines)))
    bugs = []
    for index, place in enumerate(sorted(drawn), start=1):
        source, line = lines[place]
        changes = changes_by_line()[source, line]
        kind = draw.choice(sorted({change.kind for change in changes}))
        change = draw.choice([change for change in changes if change.kind == kind])
        bugs.append(bug_of(source, change, index))
    return bugs


def main() -> None:
    """Print the bugs that a seed draws."""
    parser = argparse.ArgumentParser(description="Draw bugs blindly and print them.")
    parser.add_argument("rooms", nargs="*")
    parser.add_argument("--drawn", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for bug in drawn_bugs(arguments.drawn, arguments.seed, arguments.rooms):
        print(f"{bug.room} {bug.index}: {bug.file}: {bug.what}")


if __name__ == "__main__":
    main()
