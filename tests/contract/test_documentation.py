"""The documentation works as it stands there: every command, snippet and link, and what is printed.

After a change of what is printed: python -m docs.snippets --write
"""

import html
import json
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from urllib.parse import urlsplit

import pytest
import yaml

from docs import snippets
from tests.conftest import run_command
from tests.contract.sources import ROOT, text_of

EVERY = os.environ.get("UNBEND_SNIPPETS") == "all"
PAGES = {page.relative_to(ROOT).as_posix(): page for page in snippets.pages()}
TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

OF_ITS_TIME = ("changelog_details", "decisions.md")
"""Pages that name commands as they were."""


def runs_here(page):
    """Whether something of a page runs, without UNBEND_SNIPPETS=all what is slow does not."""
    return any(block.runs and (EVERY or not block.slow) for block in snippets.blocks(page))


posix = pytest.mark.skipif(os.name == "nt", reason="the pages show a POSIX shell")


@pytest.fixture(scope="session")
def ready(tmp_path_factory):
    """What pages begin with, made when the first of them needs it."""
    return tmp_path_factory.mktemp("ready")


@posix
@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if runs_here(page)])
def test_what_a_page_shows_runs_and_prints_that(name, ready, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    page = PAGES[name]
    wrong = snippets.run_alone(page, ready, tmp_path / "page", EVERY)
    assert not wrong, "\n".join(
        f"{name} shows\n{difference.shown}where is printed\n{difference.printed}"
        for _, difference in wrong
    )


@cache
def help_text(command):
    """What `unbend COMMAND --help` prints; nothing where there is no such command."""
    ended = run_command(command, "--help")
    return ended.out if ended.code == 0 else ""


@pytest.mark.parametrize(
    "page",
    [page for page in TEXTS if not page.name.startswith(OF_ITS_TIME)],
    ids=lambda page: page.name,
)
def test_every_command_in_a_sentence_exists(page):
    text = re.sub(r"^( *)```.*?^\1```", "", text_of(page), flags=re.M | re.S)
    text = re.sub(r"\\\n *", "", text)  # a line that goes on in the next
    shown = re.findall(r"`unbend ([^`]+)`", text) + re.findall(r"^ {4}unbend ([^#\n]+)", text, re.M)
    for line in shown:
        name, *words = shlex.split(line.replace("|", " "))
        if name.startswith("-"):
            assert name in ("--help", "--version", "-h", "--install-completion")
            continue
        assert help_text(name), f"`unbend {line}`"
        for word in words:
            if word.startswith("--"):
                assert f"{word} " in help_text(name), f"`unbend {line}`"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_bytes()) <= 9000


def test_the_readme_has_a_mission_in_twenty_lines():
    (block,) = (b for b in snippets.blocks(ROOT / "README.md") if b.kind == "yaml")
    assert len(block.body.splitlines()) <= 20


def test_the_angle_is_what_it_says(unbend):
    text = text_of(ROOT / "docs" / "pages" / "guide" / "exact.md")
    found = re.search(r"    unbend (angle .*\\\n.*)\n\s*\ngives ([0-9.]+) arcsec", text)
    assert found is not None
    words = found[1].replace("\\\n", " ").split()
    assert f"{found[2]} arcsec" in unbend(*words).out


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=str)
def test_links_of_the_repository_are_files(page):
    for link in re.findall(r"\]\(([^)#]+)", text_of(page)):
        assert (page.parent / link).exists(), link


class Loaded(HTMLParser):
    """What a page of the site loads, beside what it links."""

    def __init__(self):
        super().__init__()
        self.addresses: set[str] = set()

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag in ("script", "img", "iframe", "source", "link"):
            self.addresses.update(filter(None, (values.get("src"), values.get("href"))))


@pytest.fixture(scope="session")
def site_folder(tmp_path_factory):
    """The site, built as `make docs` does: in strict mode, so that a broken link ends it."""
    folder = tmp_path_factory.mktemp("site")
    config = ROOT / "docs" / "mkdocs.yml"
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mkdocs",
            "build",
            "--strict",
            "--config-file",
            config,
            "--site-dir",
            folder,
        ],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_loads_nothing_from_a_network(site_folder):
    for page in site_folder.rglob("*.html"):
        loaded = Loaded()
        loaded.feed(text_of(page))
        assert len(loaded.addresses) > 3
        for address in loaded.addresses:
            parts = urlsplit(address)
            is_remote = bool(parts.scheme or parts.netloc)
            assert not is_remote, f"{page}: {address}"
            is_not_found_page = page.name == "404.html"  # its addresses begin with a slash
            assert is_not_found_page or (page.parent / parts.path).exists(), f"{page}: {address}"
    for sheet in site_folder.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", sheet.read_text("utf-8")), sheet


def test_equations_are_mathml(site_folder):
    """No equation is left to a script."""
    for page in site_folder.rglob("*.html"):
        text = text_of(page)
        assert 'class="arithmatex"' not in text, page.name


def entries_of_the_search(site_folder):
    """What the search of the site looks through: a place, a title and a text each."""
    index = json.loads((site_folder / "search" / "search_index.json").read_text("utf-8"))
    return index["docs"]


FOUND_ON = yaml.safe_load("""
- [GCP, guide/control.html]
- [Agisoft, formats/metashape_in.html]
- [Metashape, formats/metashape_in.html]
- [conda, install.html]
- [docker, install.html]
- [notebook, notebooks/arrays.html]
- [Jupyter, notebooks/block.html]
- [EXIF, formats/camera_events.html]
- [EVENTS-AMBIGUOUS, codes/events.html]
- [refraction_angle, api/index.html]
- [pyproject, install.html]
""")


@pytest.mark.parametrize(("word", "page"), FOUND_ON)
def test_the_search_finds_a_word_on_its_page(word, page, site_folder):
    found = {
        entry["location"].partition("#")[0]
        for entry in entries_of_the_search(site_folder)
        if re.search(rf"\b{word}\b", f"{entry['title']} {entry['text']}", flags=re.IGNORECASE)
    }
    assert page in found


def test_the_glossary_names_things_as_other_programs_do(site_folder):
    glossary = " ".join(
        entry["text"]
        for entry in entries_of_the_search(site_folder)
        if entry["location"].startswith("glossary.html")
    )
    for word in ("GCP", "Agisoft", "EXIF", "conda", "notebook", "Jupyter", "EPSG", "DEM", "PPK"):
        assert word in glossary, word


def test_no_page_of_codes_is_long(site_folder):
    """One page a family: none has more than a tenth of all codes."""
    counts = {
        page.stem: text_of(page).count("<h2 id=") for page in (site_folder / "codes").glob("*.html")
    }
    assert len(counts) > 50
    assert max(counts.values()) <= sum(counts.values()) / 10


def test_the_first_level_of_the_navigation_has_what_is_looked_for():
    class Loader(yaml.SafeLoader):
        """mkdocs' own tags do not matter here."""

    text = text_of(ROOT / "docs" / "mkdocs.yml")
    entries = yaml.load(text, Loader)["nav"]
    first = {name for entry in entries if isinstance(entry, dict) for name in entry}
    assert first >= {"Limits", "Verification", "Glossary", "Codes", "Cost and accuracy", "Python"}


def test_the_reference_shows_signatures_and_docstrings(site_folder):
    text = (site_folder / "api" / "index.html").read_text("utf-8")
    plain = html.unescape(re.sub(r"<[^>]+>", "", text))
    assert re.search(r"open_log\(\s*path: Path \| str,", plain)
    assert "Read a flight log of any format" in plain
    assert '<div class="language-pycon' in text
    refusals = (site_folder / "api" / "errors.html").read_text("utf-8")
    assert 'id="unbend.errors.LogError"' in refusals
