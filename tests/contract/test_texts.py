"""Texts for people (ledger, refusals, help, report) are in the third person and of plain words."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import unbend

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
