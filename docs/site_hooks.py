"""Hooks of mkdocs: files outside docs/pages, generated parts and pages, notebooks, equations."""

import html
import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))  # mkdocs loads hooks by their file
from docs.notebooks import pictures_of, text_of_page  # noqa: E402
from docs.reference import (  # noqa: E402
    families,
    family_page,
    project_urls,
    with_generated,
)

PAGES = DOCS / "pages"
LINK = re.compile(r"(\]\()([^)#\s:]+)((?:#[^)\s]*)?\))")
UNSEARCHED = ("changelog.md", "changelog_details.md", "decisions.md")
FUNCTION = re.compile(
    r"(?<=[\w}])\s*(?=\\(?:sin|cos|tan|cot)\b)|(?<=\\(?:sin|cos|tan|cot))\s*(?=[a-zA-Z\\])"
)
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def elsewhere() -> dict[Path, str]:
    """Files of the repository that the site has too, and their place in it."""
    places = {DOCS.parent / "CONTRIBUTING.md": "contributing.md"}
    for path in (*DOCS.glob("*.md"), *DOCS.glob("*.png")):
        places[path] = path.name
    return places


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show the address of the repository, if pyproject.toml has one, in the head of each page."""
    config.repo_url = project_urls().get("Repository")
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for path, place in elsewhere().items():
        file = File.generated(config, place, abs_src_path=str(path))
        files.append(file)
    for notebook in sorted(PAGES.rglob("*.ipynb")):
        page = notebook.relative_to(PAGES).with_suffix(".md")
        files.append(File.generated(config, page.as_posix(), abs_src_path=str(notebook)))
        for name, picture in pictures_of(notebook).items():
            place = f"{page.parent}/{name}"
            files.append(File.generated(config, place, content=picture))
    for family in families():
        place = family_page(family)
        text = f"# {family}\n\n<!-- generated: codes {family} -->\n"
        files.append(File.generated(config, place, content=text))
    add_families(config)
    return files


def add_families(config: MkDocsConfig) -> None:
    """Put a page for each family of codes into the navigation, below the page of all codes."""
    for entry in config.nav or []:
        if isinstance(entry, dict) and "Codes" in entry:
            entry["Codes"] = ["codes.md", *map(family_page, families())]


def on_page_read_source(page: Page, **_: Any) -> str | None:
    """A notebook as the Markdown of its page; other pages are read as they are."""
    source = Path(str(page.file.abs_src_path))
    if source.suffix == ".ipynb":
        return text_of_page(source)
    return None


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    source = Path(str(page.file.abs_src_path))
    here = posixpath.dirname(page.file.src_uri)
    places = elsewhere()
    if page.file.src_uri in UNSEARCHED:
        page.meta["search"] = {"exclude": True}

    def as_in_the_site(link: re.Match[str]) -> str:
        before, address, after = link.groups()
        target = (source.parent / address).resolve()
        if target in places:
            place = places[target]
        elif target.is_relative_to(PAGES):
            place = target.relative_to(PAGES).as_posix()
            if target.suffix == ".ipynb" and target != source:  # its own page offers the file
                place = place.removesuffix(".ipynb") + ".md"
        else:
            return link[0]
        return before + posixpath.relpath(place, here) + after

    return LINK.sub(as_in_the_site, with_generated(markdown))


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML, which browsers show without a script."""

    def as_mathml(equation: re.Match[str]) -> str:
        tag, text = equation.groups()
        # The converter leaves no space about the names of functions.
        latex = FUNCTION.sub(r"\\,", html.unescape(text).strip())
        display = "block" if tag == "div" else "inline"
        return convert(latex, display=display)

    return EQUATION.sub(as_mathml, content)
