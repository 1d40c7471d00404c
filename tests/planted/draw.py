"""Draw bugs blindly: mutation operators over every room of the package, by a seed.

    python tests/planted/draw.py [ROOM ...] [--drawn 60] [--seed 20261128]

prints the bugs that `run.py --drawn 60 --seed 20261128` plants. Whoever writes a list of bugs by
hand thinks of the tests while writing it; here a random number decides. First a line of code is
drawn among all that can be changed, so a room is as frequent as it is long; then one of the kinds
of change that the line allows; then one of the changes of that kind (`changes.py`).
"""

import argparse
import ast
import random
import re
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
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


def room_of(path: Path) -> str:
    """The name of the list of planted bugs that names the tests of a module."""
    room, *below = path.relative_to(PACKAGE).parts
    if below:
        return room
    return TOP_LEVEL.get(path.stem, "base")


@dataclass(frozen=True)
class FileOfTests:
    """A file of tests, and its words."""

    name: str
    text: str
    words: frozenset[str]

    @property
    def subject(self) -> str:
        return Path(self.name).stem.removeprefix("test_")


@cache
def files_of_tests() -> list[FileOfTests]:
    """Every file of tests."""
    files = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        name = str(path.relative_to(ROOT))
        text = path.read_text("utf-8")
        words = frozenset(re.findall(r"\w+", text))
        files.append(FileOfTests(name, text, words))
    return files


def nearest_tests(source: Source, line: int) -> tuple[str, ...]:
    """The module's own examples, then the test files that are likeliest to notice a bug in a line.

    Likeliest is the file with most signs: it is of the module's room, imports the module, has its
    name, names the function, or another function or class of it.
    """
    module = source.path
    *packages, stem = module.relative_to(PACKAGE.parent).with_suffix("").parts
    package = ".".join(packages)
    imported = re.compile(rf"\b{package}\.{stem}\b|from {package} import [^\n]*\b{stem}\b")
    folder = f"tests/{room_of(module)}/"
    function = function_of(source, line)
    long_names = set()
    for node in source.tree.body:
        name = getattr(node, "name", "")  # of functions and classes
        if len(name) >= 8:
            long_names.add(name)
    signs_of_file = {}
    for file in files_of_tests():
        signs = [
            file.name.startswith(folder),
            imported.search(file.text) is not None,
            file.subject == stem,
            function in file.words,
            not long_names.isdisjoint(file.words),
        ]
        signs_of_file[file.name] = sum(signs), signs
    files = sorted(signs_of_file, key=signs_of_file.__getitem__, reverse=True)
    nearest = [str(module.relative_to(ROOT)), *files[:NEAREST_FILES]]
    if stem == "messages":
        nearest.append(TESTS_OF_MESSAGES)
    return tuple(dict.fromkeys(nearest))


def function_of(source: Source, line: int) -> str:
    """Name of the innermost function around a line, or nothing."""
    name = ""
    for node in ast.walk(source.tree):
        if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0):
            name = node.name
    return name


def bug_of(source: Source, change: Change, index: int) -> Bug:
    """The record of a change. Its `before` takes in lines around it until it stands only once."""
    content = source.content
    first = content.rfind(b"\n", 0, change.start) + 1
    end = content.find(b"\n", change.end)
    while content.count(content[first:end]) > 1:
        first = content.rfind(b"\n", 0, max(first - 1, 0)) + 1
    head = content[first : change.start].decode()
    shown = content[change.start : change.end].decode()
    tail = content[change.end : end].decode()
    room = room_of(source.path)
    return Bug(
        room=room,
        index=index,
        tests=read_bugs(HERE / f"{room}.toml")[0].tests,
        file=str(source.path.relative_to(ROOT)),
        before=head + shown + tail,
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
    lines = []
    for source, line in changes_by_line():
        if not rooms or room_of(source.path) in rooms:
            lines.append((source, line))
    draw = random.Random(seed)
    drawn = draw.sample(range(len(lines)), min(number, len(lines)))
    bugs = []
    for index, place in enumerate(sorted(drawn), start=1):
        source, line = lines[place]
        changes = changes_by_line()[source, line]
        kinds = {change.kind for change in changes}
        kind = draw.choice(sorted(kinds))
        change = draw.choice([change for change in changes if change.kind == kind])
        bugs.append(bug_of(source, change, index))
    return bugs


def main():
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
