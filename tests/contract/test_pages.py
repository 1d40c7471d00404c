"""Every `>>>` on a page of the documentation gives what is printed there."""

import doctest
import re

import pytest

from tests.contract.sources import ROOT, text_of

FENCE = re.compile(r"^```pycon\n(.*?)^```$", re.DOTALL | re.MULTILINE)


ALL_PAGES = sorted(ROOT.glob("docs/**/*.md"))
PAGES = [path for path in ALL_PAGES if FENCE.search(text_of(path))]


def examples(page):
    """The fences of a page, each line at its place; one fence follows from another."""
    text = ""
    for fence in FENCE.finditer(page):
        before = page[: fence.start(1)]
        missing = before.count("\n") - text.count("\n")
        text += "\n" * missing
        text += fence[1]
    return text


def failures(text, name):
    """What does not come out as printed."""
    parser = doctest.DocTestParser()
    test = parser.get_doctest(text, {}, name, name, 0)
    report = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(test, out=report.append)
    return "".join(report)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_prints_what_comes_out(path, monkeypatch):
    monkeypatch.chdir(ROOT)
    text = examples(text_of(path))
    wrong = failures(text, path.name)
    assert not wrong, wrong


def test_a_wrong_number_is_noticed():
    page = "text\n\n```pycon\n>>> 1 + 1\n3\n```\n\n```pycon\n>>> 2\n2\n```\n"
    assert "line 4" in failures(examples(page), "page")


QUOTED = re.compile(r"`([\w/]+\.py|test_\w+)`")


def test_modules_and_tests_that_pages_name_exist():
    files = ""
    for folder in ("pipeline", "tests", "docs", "benchmarks"):
        for path in ROOT.glob(f"{folder}/**/*.py"):
            files += f"{path}\n"
    tests = "".join(map(text_of, ROOT.glob("tests/**/*.py")))
    decisions = ROOT / "docs" / "decisions.md"
    lost = set()
    for page in (decisions, *ROOT.glob("docs/pages/**/*.md")):
        for name in QUOTED.findall(text_of(page)):
            is_file = f"/{name}\n" in files
            is_test = f"def {name}(" in tests
            if not is_file and not is_test:
                lost.add(f"{page.name}: {name}")
    assert not lost, "\n".join(sorted(lost))


def test_there_are_pages():
    names = {path.stem for path in PAGES}
    assert {"gyer1996", "saastamoinen1974", "bertram1966", "ray", "air"} <= names
