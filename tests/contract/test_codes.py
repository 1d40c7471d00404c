"""Every code stands once, is explained and raised by a test."""

import ast
import pickle
import re
from collections import Counter
from pathlib import Path

import pytest

from tests.contract.sources import nodes, strings, text_of
from unbend import errors, exit_codes
from unbend.report import explanations

TESTS = Path(__file__).resolve().parents[1]

REFUSALS = {
    name
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.UnbendError)
}
# What no test raises, and why.
EXPLAINED = {
    "EVENTS-NONE": "the mission file cannot say that: its model asks for log or csv",
    "LOG-UNREADABLE": "a disk that fails while a log is read; tests run as any user, root too",
    "SIM-ODE": "scipy's integrator giving up; no input is known that makes it",
    "SIM-PATH": "as SIM-ODE",
    "SIM-POINTS": "a block without points; the simulator's own limits keep it away",
}


def defined_codes():
    """Name and place of every ``Code("NAME", ...)``."""
    codes = []
    for module, node in nodes():
        is_code = isinstance(node, ast.Call) and ast.unparse(node.func) == "Code"
        if is_code and node.args and isinstance(node.args[0], ast.Constant):
            codes.append((str(node.args[0].value), f"{module}:{node.lineno}"))
    return codes


@pytest.fixture(scope="module")
def said_in_tests():
    """Every whole code in a string of a test."""
    here = Path(__file__).resolve()
    return {
        code
        for path in sorted(TESTS.rglob("*.py"))
        if path.resolve() != here
        for _, text in strings(ast.parse(text_of(path)))
        for code in re.findall(r"\b(?:[A-Z0-9]+(?:-[A-Z0-9]+)+|ROLE)\b", text)
    }


def test_every_code_stands_once():
    names = Counter(name for name, _ in defined_codes())
    assert len(names) > 400
    assert {name: count for name, count in names.items() if count > 1} == {}
    for name in names:
        assert re.fullmatch(r"[A-Z0-9]+(?:-[A-Z0-9]+)+|ROLE", name), name


def test_every_code_is_used():
    """By the constant that holds it, which is named after it."""
    used = {
        node.id if isinstance(node, ast.Name) else node.attr
        for _, node in nodes()
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load)
    }
    idle = {name for name, _ in defined_codes() if name.replace("-", "_") not in used}
    assert idle == set()


def test_every_code_is_raised_by_a_test_or_explained(said_in_tests):
    missing = {
        name: place
        for name, place in defined_codes()
        if name not in said_in_tests and name not in EXPLAINED
    }
    assert not missing, missing


def test_nothing_is_explained_that_does_not_exist_or_that_a_test_raises(said_in_tests):
    assert set(EXPLAINED) <= {name for name, _ in defined_codes()}
    assert not set(EXPLAINED) & said_in_tests


def test_every_code_is_explained_offline():
    """`unbend help CODE`: what it means, what it does to the result, what to do."""
    explained = explanations.meanings()["codes"]
    assert set(explained) == {name for name, _ in defined_codes()}
    meanings = [meaning.means for meaning in explained.values()]
    assert len(set(meanings)) == len(meanings)  # none is a copy of another
    for code, meaning in explained.items():
        for text in (meaning.means, meaning.effect, meaning.remedy):
            assert text.endswith("."), code
            assert text[0].isupper() or text[0] in "`0123456789" or text.split()[0] in LOWER, code
        assert 15 < len(meaning.means) < 300, code
        assert meaning.remedy == "Nothing." or len(meaning.remedy) > 10, code


LOWER = {
    "pip",
    "pressure_hpa",
    "time_utc",
    "delay_s",
    "direction",
    "lever_arm_m",
    "ppa_mm",
    "atmosphere.adjust",
    "events.first_image",
}


def test_every_exit_code_is_explained():
    own = {value for name, value in vars(exit_codes).items() if name.startswith("EXIT_")}
    assert {int(code) for code in explanations.meanings()["exit"]} == own


def test_only_strings_at_work_count():
    code = ast.parse('"""A-1"""\n# B-2\ndef f():\n    "C-3"\n    return "D-4"')
    assert list(strings(code)) == [(5, "D-4")]


def test_a_refusal_survives_the_way_between_processes():
    code = errors.Code("SOME-CODE", means="It happened.", effect="None.", remedy="Nothing.")
    for name in sorted(REFUSALS):
        error = getattr(errors, name)(
            code, "{count} of {n}", where="where", remedy="mend {n}", count=2, n=3
        )
        back = pickle.loads(pickle.dumps(error))
        assert type(back) is type(error)
        assert str(back) == str(error) == "SOME-CODE: 2 of 3\n  where: where\n  to do: mend 3"
        assert (back.exit_code, back.values, back.count) == (error.exit_code, {"n": 3}, 2)
