"""The package stays easy to find one's way in: sizes, callers, parameters, and one word a thing.

`house.py` beside this file counts; run it with ``-v`` for the lists.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

import unbend

sys.path.insert(0, str(Path(__file__).parent))

from house import House, measure, report

# The same module name in several rooms, where it is the same thing seen from each.
SAME_THING = {
    "log", "records", "channels", "clock",  # formats, and of all
    "stations", "adjusted_profile", "air_samples",  # computed, and as a stage
    "image", "ray",  # for a caller, and compiled
    "sensors",  # estimated, and simulated
}  # fmt: skip

# The package was 214 files and 33,946 lines, with 355 private functions that had one caller, before
# it was rearranged (0.2.0). What is added after that has this much room.
MOST_FILES = 251
MOST_LINES = 50_027  # the aim is 40,000
MOST_WITH_ONE_CALLER = 147


@pytest.fixture(scope="module")
def house() -> House:
    return measure()


def test_there_are_few_files_of_readable_size(house):
    assert house.files <= MOST_FILES, report(house)
    assert house.lines <= MOST_LINES, report(house)


def test_functions_read_straight_down(house):
    assert house.median_length >= 10, report(house)
    assert house.p95_length <= 45, report(house)
    assert len(house.with_one_caller) <= MOST_WITH_ONE_CALLER, "\n".join(house.with_one_caller)


def test_arguments_beyond_five_have_names(house):
    assert not house.many_positional, "\n".join(house.many_positional)


def test_a_folder_fits_on_a_screen(house):
    crowded = {folder: count for folder, count in house.modules_in.items() if count > 13}
    assert not crowded, crowded


def test_no_two_public_classes_have_the_same_name(house):
    twice = {name: files for name, files in house.classes_called.items() if len(files) > 1}
    assert not twice, twice


def test_modules_of_the_same_name_are_the_same_thing(house):
    twice = {
        name: files
        for name, files in house.modules_called.items()
        if len(files) > 1 and name not in SAME_THING | {"__init__"}
    }
    assert not twice, twice


def test_what_is_allowed_twice_is_there_twice(house):
    assert all(len(house.modules_called[name]) > 1 for name in SAME_THING)


def test_the_counts_count(tmp_path):
    """One file with one of everything."""
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "thing.py").write_text(
        '"""A thing."""\n'
        "from unbend.messages import Ledger\n\n"
        "class Thing:\n    def method(self, a, b, c, d, e): ...\n\n"
        "def wide(a, b, c, d, e, f, *, g):\n    return _once(a)\n\n"
        "def _once(a):  # has one caller\n    return _twice(a) + _twice(a)\n\n"
        "def _twice(a):\n    return a\n"
    )
    counted = measure(tmp_path)
    assert (counted.files, counted.lines, counted.lines_of_code) == (1, 14, 9)
    assert [place.rpartition(":")[2] for place in counted.many_positional] == ["wide"]
    assert [place.rpartition(":")[2] for place in counted.with_one_caller] == ["_once"]
    assert max(counted.parameters.values()) == 7
    assert counted.private_functions == 2
    assert counted.importing_ledger == 1
    assert counted.modules_in == {"room": 1}
    assert counted.classes_called == {"Thing": ["room/thing.py"]}


def test_the_same_choices_stand_in_one_order() -> None:
    """Python keeps one of several ``Literal`` that are equal: the schema would follow imports."""
    orders: dict[frozenset[str], str] = {}
    for path in sorted(Path(unbend.__file__).parent.rglob("*.py")):
        for choices in re.findall(r"Literal\[([^\]]*)\]", path.read_text(encoding="utf-8")):
            names = frozenset(name.strip() for name in choices.split(","))
            assert orders.setdefault(names, choices) == choices, path
