"""Every code of a refusal and of the ledger: named once here, raised by a test or explained."""

from __future__ import annotations

import ast
import re
import string
from collections.abc import Iterator
from pathlib import Path

import pytest

import unbend
from unbend import errors, exit_codes
from unbend.report import explanations

PACKAGE = Path(unbend.__file__).parent
TESTS = Path(__file__).resolve().parents[1]

REFUSALS = {
    name for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.UnbendError)
}  # fmt: skip
LEDGER = {"note", "fallback", "warning", "loss", "finding"}

# What no test raises, and why.
EXPLAINED = {
    "EVENTS-NONE": "the mission file cannot say that: its model asks for log or csv",
    "LOG-UNREADABLE": "a disk that fails while a log is read; tests run as any user, root too",
    "SIM-ODE": "scipy's integrator giving up; no input is known that makes it",
    "SIM-PATH": "as SIM-ODE",
    "SIM-POINTS": "a block without points; the simulator's own limits keep it away",
    "LOG-DIALECT": "a pymavlink without its dialects",
}


def first_words(call: ast.Call) -> str | None:
    first = call.args[0] if call.args else None
    return first.value if isinstance(first, ast.Constant) and isinstance(first.value, str) else None


def refuses(call: ast.Call) -> bool:
    """Whether it makes a refusal with a text of ``texts.toml``: ``InputError.of(...)``."""
    return isinstance(call.func, ast.Attribute) and call.func.attr == "of"


def name_of(call: ast.Call) -> str:
    """The function that is called; of ``InputError.of`` the class."""
    function = (
        call.func.value if isinstance(call.func, ast.Attribute) and refuses(call) else call.func
    )
    return getattr(function, "attr", getattr(function, "id", ""))


def codes(callers: set[str]) -> dict[str, str]:
    """Code -> file of every call of these functions with a literal code, and of every `Code`."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            code = (first_words(node) or "").partition("/")[0]
            if (
                name_of(node) in {*callers, "Code"}
                and code
                and code == code.upper()
                and " " not in code
            ):
                found[code] = f"{path.relative_to(PACKAGE)}:{node.lineno}"
    return found


def strings(tree: ast.Module) -> Iterator[str]:
    """The literal strings of a module that it works with: no remark, no docstring."""
    idle = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in idle:
            yield node.value


@pytest.fixture(scope="module")
def said_in_tests() -> set[str]:
    """Every whole code in a string of a test."""
    here = Path(__file__).resolve()
    return {
        code
        for path in sorted(TESTS.rglob("*.py"))
        if path.resolve() != here
        for text in strings(ast.parse(path.read_text(encoding="utf-8")))
        for code in re.findall(r"[A-Z0-9]+(?:-[A-Z0-9]+)+|\bROLE\b", text)
    }


def test_refusals_are_found():
    found = codes(REFUSALS)
    assert len(found) > 40
    for code in found:
        assert code.replace("-", "").isalnum(), code
        assert "-" in code or code == "ROLE", code


def test_every_refusal_is_raised_by_a_test_or_explained(said_in_tests):
    missing = {
        code: where for code, where in codes(REFUSALS).items()
        if code not in said_in_tests and code not in EXPLAINED
    }  # fmt: skip
    assert not missing, missing


def test_nothing_is_explained_that_does_not_exist():
    known = codes(REFUSALS) | codes(LEDGER)
    assert not set(EXPLAINED) - set(known), set(EXPLAINED) - set(known)


def test_nothing_is_explained_that_a_test_raises(said_in_tests):
    refusals_only = set(EXPLAINED) - set(codes(LEDGER))
    assert not refusals_only & said_in_tests


# Written like codes, and none: dates, hashes, encodings, numbers of tables; or made of parts.
NO_CODES = {"2026-05-14", "3-4", "SHA-256", "UTF-8"}
MADE = {"RAY-BAD-MEASUREMENT", "RAY-MISSES-GROUND", "RAY-OUTSIDE-PROFILE"}


def test_every_code_is_explained_offline_and_nothing_else_is():
    """`unbend help CODE`: what it means, what it does to the result, what to do."""
    written = {
        word
        for path in sorted(PACKAGE.rglob("*.py"))
        for word in strings(ast.parse(path.read_text(encoding="utf-8")))
        if re.fullmatch(r"[A-Z0-9]+(?:-[A-Z0-9]+)+", word)
    }
    known = (written - NO_CODES) | MADE | codes(REFUSALS).keys() | codes(LEDGER).keys()
    assert len(known) > 400
    explained = explanations.meanings()["codes"]
    assert known - set(explained) == set()
    assert set(explained) - known == set()
    meanings = [meaning.means for meaning in explained.values()]
    assert len(set(meanings)) == len(meanings)  # none is a copy of another
    for code, meaning in explained.items():
        for text in (meaning.means, meaning.effect, meaning.remedy):
            assert text.endswith("."), code
            assert text[0].isupper() or text[0] in "`0123456789" or text.split()[0] in LOWER, code
        assert 15 < len(meaning.means) < 300, code
        assert meaning.remedy == "Nothing." or len(meaning.remedy) > 10, code


LOWER = {"pip", "pressure_hpa", "time_utc", "delay_s", "direction", "lever_arm_m",
         "ppa_mm", "atmosphere.adjust", "events.first_image"}  # fmt: skip


def test_every_exit_code_is_explained():
    own = {value for name, value in vars(exit_codes).items() if name.startswith("EXIT_")}
    assert {int(code) for code in explanations.meanings()["exit"]} == own


def test_only_strings_at_work_count():
    code = ast.parse('"""A-1"""\n# B-2\ndef f():\n    "C-3"\n    return "D-4"')
    assert list(strings(code)) == ["D-4"]


def test_every_refusal_says_what_to_do():
    """A refusal of the user's input carries a remedy."""
    without = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                code = first_words(node)
                given = {keyword.arg for keyword in node.keywords}
                if node.func.id in REFUSALS and code and "remedy" not in given:
                    without.append((code, f"{path.relative_to(PACKAGE)}:{node.lineno}"))
    allowed = {"EVENTS-NONE", "SIM-ODE", "SIM-PATH"}
    assert {code for code, _ in without} <= allowed, without


def test_a_refusal_survives_the_way_between_processes():
    import pickle

    for name in sorted(REFUSALS):
        error = getattr(errors, name)("SOME-CODE", "what", where="where", remedy="remedy")
        back = pickle.loads(pickle.dumps(error))
        assert type(back) is type(error)
        assert str(back) == str(error)
        assert back.exit_code == error.exit_code


def test_every_text_gets_the_values_that_it_asks_for():
    """Of ``texts.toml``: a refusal has a remedy, no text is idle, and no call names another."""
    texts, used, wrong = errors.texts(), set(), []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            key, name = (
                (first_words(node), name_of(node)) if isinstance(node, ast.Call) else ("", "")
            )
            if (
                name not in REFUSALS | LEDGER | {"entry", "failed"}
                or not key
                or len(node.args) > 1 + refuses(node)
            ):
                continue
            place = f"{path.relative_to(PACKAGE)}:{node.lineno}: {key}"
            given = {word.arg for word in node.keywords}
            if name not in REFUSALS:
                given |= {"where", "count"}
            elif not refuses(node):
                continue
            if key not in texts:
                wrong.append(f"{place} is no text")
                continue
            used.add(key)
            parts = (string.Formatter().parse(part) for part in texts[key].values())
            asked = {field.partition(".")[0] for part in parts for _, field, _, _ in part if field}
            if asked ^ given > {"where", "count"} or (asked ^ given) - {"where", "count"}:
                wrong.append(f"{place} asks for {sorted(asked)}, given are {sorted(given)}")
            if refuses(node) != ("remedy" in texts[key]):
                wrong.append(f"{place}: a remedy belongs to refusals")
    assert not wrong, "\n".join(wrong)
    assert set(texts) == used
