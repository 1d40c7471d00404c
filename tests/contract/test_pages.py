"""Every `>>>` on a page of the documentation gives what is printed there."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^```pycon\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PAGES = [
    path for path in sorted((ROOT / "docs").rglob("*.md")) if FENCE.search(path.read_text("utf-8"))
]


def examples(page: str) -> str:
    """The fences of a page, at the lines where they stand; one follows from another."""
    kept = [""] * page.count("\n")
    for fence in FENCE.finditer(page):
        first = page.count("\n", 0, fence.start(1))
        for number, line in enumerate(fence[1].splitlines(), start=first):
            kept[number] = line
    return "\n".join(kept) + "\n"


def failures(text: str, name: str) -> str:
    """What does not come out as printed."""
    test = doctest.DocTestParser().get_doctest(text, {}, name, name, 0)
    report: list[str] = []
    doctest.DocTestRunner(verbose=False).run(test, out=report.append)
    return "".join(report)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_prints_what_comes_out(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    wrong = failures(examples(path.read_text(encoding="utf-8")), path.name)
    assert not wrong, wrong


def test_a_wrong_number_is_noticed() -> None:
    page = "text\n\n```pycon\n>>> 1 + 1\n3\n```\n\n```pycon\n>>> 2\n2\n```\n"
    assert "line 4" in failures(examples(page), "page")


QUOTED = re.compile(r"`([\w/]+\.py|test_\w+)`")


def test_modules_and_tests_that_pages_name_exist() -> None:
    files = [
        f"/{path.relative_to(ROOT).as_posix()}"
        for folder in ("pipeline", "tests", "docs", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
    ]
    tests = "".join(path.read_text("utf-8") for path in (ROOT / "tests").rglob("*.py"))
    lost = [
        f"{page.name}: {name}"
        for page in (*(ROOT / "docs" / "pages").rglob("*.md"), ROOT / "docs" / "decisions.md")
        for name in QUOTED.findall(page.read_text(encoding="utf-8"))
        if not (
            any(file.endswith(f"/{name}") for file in files)
            if name.endswith(".py")
            else f"def {name}(" in tests
        )
    ]
    assert not lost, "\n".join(sorted(set(lost)))


def test_there_are_pages() -> None:
    assert {"gyer1996", "saastamoinen1974", "bertram1966", "ray", "air"} <= {
        path.stem for path in PAGES
    }
