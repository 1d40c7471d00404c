"""Texts for people (ledger, refusals, help, report) are in the third person and of plain words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from string import Formatter

import pytest

import unbend
from unbend import errors
from unbend.errors import LogError, in_agreement
from unbend.messages import Entry, Kind

PACKAGE = Path(unbend.__file__).parent
PERSON = re.compile(
    r"\b(?:you|your|yours|yourself|we|our|ours|ourselves|us|my|mine|myself|me)\b(?!-)|\bI\b(?!-)",
    re.IGNORECASE,
)
# "US 1976" is a standard atmosphere, "us" a microsecond after a number or in brackets.
NO_PERSON = re.compile(r"\bUS\b|\bi\b|\[[^]]*\bus\b[^]]*\]|[0-9] ?us\b")


def texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Strings of a module with a space in them that are no docstrings: what somebody may read."""
    idle = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in idle
            and " " in node.value.strip()
        ):
            yield node.lineno, node.value


def help_texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Docstrings of a module and its functions, where those are the help of commands and keys."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.FunctionDef, ast.ClassDef)):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""


def persons_in(text: str) -> list[str]:
    return PERSON.findall(NO_PERSON.sub("", text))


PRIVATE = re.compile(
    r"\b(?:told|doubtful|believ\w*|betray\w*|widened|heed\w*|feign\w*|honest\w*)\b", re.IGNORECASE
)
"""Words of this program for what has a name in the field: reported, sigma inflation factor, ..."""
ROOT = PACKAGE.parents[1]


def test_texts_have_no_private_words():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                wrong += [f"{path.name}:{node.lineno}: {w}" for w in PRIVATE.findall(node.value)]
    changes = ("changelog.md", "changelog_details.md")
    pages = [
        ROOT / "README.md",
        *(path for path in (ROOT / "docs").rglob("*.md") if path.name not in changes),
        *PACKAGE.rglob("*.toml"),
        *PACKAGE.rglob("*.j2"),
    ]
    for path in pages:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            wrong += [f"{path.name}:{number}: {word}" for word in PRIVATE.findall(line)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("text", ["is told of", "a widened sigma", "Honest thermometers"])
def test_private_words_are_noticed(text):
    assert PRIVATE.search(text)
    assert not PRIVATE.search("the field that tells instances apart; sigma inflation factor")


NO_NOUNS = re.compile(
    r"^(?:accepts|across|as|calls|changes|claims|contains|counts|differs|displaces|does|drifts|gives|"
    r"has|holds|is|its|leans|leaves|lies|looks|loss|lies|minus|microradians|misses|moves|names|needs|only|opens|others|"
    r"pandas|plays|radians|radius|reads|relates|reports|rms|says|sees|selects|spans|stands|starts|steps|takes|"
    r"this|was)$"
)
"""What may follow a name or a number in a text and is no noun in the plural."""


def after_values() -> Iterator[tuple[str, str]]:
    """The place and the text of what follows a value that is filled in, in code and in data."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            parts = node.values if isinstance(node, ast.JoinedStr) else []
            for value, after in pairwise(parts):
                if isinstance(value, ast.FormattedValue) and isinstance(after, ast.Constant):
                    yield f"{path.name}:{node.lineno}", str(after.value)
    for key, text in errors.texts().items():
        for part in text.values():
            for value, after in fields(part):
                yield f"texts.toml {key} {value}", after


def fields(text: str) -> Iterator[tuple[str, str]]:
    """The name of each field of a text, and what stands after it."""
    parsed = list(Formatter().parse(text))
    for (_, name, _, _), (after, *_) in pairwise([*parsed, ("", None, None, None)]):
        if name is not None:
            yield name, after


def test_every_count_agrees_with_its_noun():
    """In all texts with a value and a noun in the plural after it, a 1 turns that to singular."""
    counted, wrong = 0, []
    for place, text in after_values():
        found = re.match(r" (?:[a-z]+ )?([a-z]{3,}s)\b", text)
        unit = re.match(r" (?:m|s|px|deg|K|ms|if|in|of|with|under|at|the) ", text)
        if not found or unit or NO_NOUNS.match(found[1]) or NO_NOUNS.match(text.split()[0]):
            continue
        counted += 1
        if in_agreement(f"1{text}").startswith(f"1{found[0]}"):
            wrong.append(f"{place}: {found[0]}")
    assert counted > 150
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 exposures of nadir", "1 exposure of nadir"),
        ("after 1 keys, 21 keys", "after 1 key, 21 keys"),
        ("all 1 control points are used", "all 1 control point is used"),
        ("0.1 hours, CAM-1 images, 1,001 rows, 1 of the images", None),
        ("1 rows do not fit, 1 have none", "1 row does not fit, 1 has none"),
        ("6746 messages of system 1, component 1 are missing; flight 1 images.csv", None),
    ],
)
def test_one_is_singular(text, expected):
    assert Entry(Kind.NOTE, "A-B", text).what == (expected or text)
    assert LogError("A-B", text).what == (expected or text)


def test_texts_have_no_first_or_second_person():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        room = path.relative_to(PACKAGE).parts[0]
        shown = [*texts(tree), *(help_texts(tree) if room in ("cli", "config") else ())]
        wrong += [
            f"{path.relative_to(PACKAGE)}:{line}: {words} in {text.strip()[:80]!r}"
            for line, text in shown
            if (words := persons_in(text))
        ]
    for key, text in errors.texts().items():
        wrong += [
            f"texts.toml, {key}: {words}" for part in text.values() if (words := persons_in(part))
        ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name the sensor in your file", ["your"]),
        ("We took what I found", ["We", "I"]),
        ("did you mean x", ["you"]),
        ("US 1976 errs by 0.3 K; the column i is in us [us]", ["us"]),
        ("1500 us late, time [us], minerals", []),
    ],
)
def test_persons_are_noticed(text, words):
    assert persons_in(text) == words
