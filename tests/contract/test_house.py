"""The package stays readable: figures of each module only fall, and one word means one thing.

`house.py` beside this file measures, explains and prints the places.
"""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.contract import house
from tests.contract.sources import PACKAGE, ROOT, text_of, trees

# The same module name in several rooms, where it is the same thing seen from each.
SAME_THING = {
    "stations", "flight_log",  # values, and the stage that makes them
    "ray", "window",  # for a caller, and compiled
    "sensors",  # estimated, and simulated
    "campaign",  # as its file states it, and its page
    "results",  # records and values, and what reads and writes them
    "messages",  # of a room
}  # fmt: skip


SHORTEST = 30  # code lines of a module whose density says anything


@pytest.fixture(scope="module")
def modules() -> dict[str, house.Module]:
    return house.measure()


@pytest.mark.parametrize("folder", ["tests", "benchmarks", "docs"])
def test_what_is_beside_the_package_is_as_plain(folder):
    too_dense = {}
    for path in (ROOT / folder).rglob("*.py"):
        name = str(path.relative_to(ROOT))
        module = house.measure_module(path, name)
        is_dense = module.tokens_a_line > house.MAX_TOKENS_A_LINE
        if is_dense and module.code_lines > SHORTEST:
            too_dense[name] = module.tokens_a_line
    assert too_dense == {}


def test_no_figure_of_a_module_grows(modules):
    """Improved figures are written down by `python tests/contract/house.py --write`."""
    worse = house.worse_than(house.read_ratchet(), house.beyond_limits(modules.values()))
    assert not worse, "\n".join(worse)


def test_the_ratchet_names_modules_that_exist(modules):
    assert set(house.read_ratchet()) <= set(modules)


def several(files):
    """The names that are in several files."""
    return {name: places for name, places in files.items() if len(places) > 1}


def test_no_two_public_classes_have_the_same_name():
    files = defaultdict(list)
    for name, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                files[node.name].append(name)
    twice = several(files)
    assert not twice, twice


def test_modules_of_the_same_name_are_the_same_thing(modules):
    files = defaultdict(list)
    for name in modules:
        files[Path(name).stem].append(name)
    twice = several(files)
    unexplained = twice.keys() - SAME_THING - {"__init__"}
    assert not unexplained, {name: twice[name] for name in unexplained}
    assert set(twice) >= SAME_THING


def test_the_same_choices_stand_in_one_order():
    """Python keeps one of several ``Literal`` that are equal: the schema would follow imports."""
    orders: dict[frozenset[str], str] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for choices in re.findall(r"Literal\[([^\]]*)\]", text_of(path)):
            names = frozenset(map(str.strip, choices.split(",")))
            assert orders.setdefault(names, choices) == choices, path


# ---------------------------------------------------------------------- what the measure sees

BROKEN = {
    "parallel_assignment": "a, b = 1, 2",
    "long_unpacking": "a, b, c, d = f()",
    "positional_arguments": "f(1, 2, 3, 4, 5, 6)",
    "alias": "import module as m",
    "empty_name": "def f(a):\n    found = a\n    return found",
    "local_names": "def f():\n" + "".join(f"    a{i} = {i}\n" for i in range(16)),
}
ALLOWED = {
    "an exchange": "a, b = b, a",
    "a known alias": "import numpy as np",
    "three values": "a, b, c = f()",
    "arguments by name": "f(1, 2, 3, 4, 5, a=6)",
    "a class under another name": "from module import Thing as OtherThing",
}


def rules_broken(source, folder):
    path = folder / "module.py"
    path.write_text(source + "\n", "utf-8")
    return {place.rule for place in house.measure_module(path, "module.py").places}


@pytest.mark.parametrize("rule", BROKEN)
def test_a_broken_rule_is_seen(rule, tmp_path):
    assert rules_broken(BROKEN[rule], tmp_path) == {rule}


@pytest.mark.parametrize("habit", ALLOWED)
def test_what_reads_well_is_allowed(habit, tmp_path):
    assert rules_broken(ALLOWED[habit], tmp_path) == set()


def test_tokens_are_those_of_code(tmp_path):
    path = tmp_path / "module.py"
    path.write_text('"""Words\nof a docstring."""\n\n# a comment\na = (\n    1\n)\n')
    module = house.measure_module(path, "module.py")
    assert (module.tokens, module.code_lines, module.lines) == (5, 3, 7)
