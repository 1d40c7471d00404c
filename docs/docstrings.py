"""Docstrings of the package as Markdown, for the API reference.

They are plain text with three habits: `name, name : what it is` describes an argument, lines that
begin with `>>>` are an example, and a name in single backticks is another name of the reference.
"""

import importlib
import re
from functools import cache
from typing import Any

import griffe

DESCRIBED = ("unbend", "unbend.atmosphere", "unbend.refraction", "unbend.ingest")
"""Modules with a page: each lists its public names in `__all__`."""

ARGUMENT = re.compile(r"^(?P<names>\w+(?:, \w+)*) : (?P<text>.*)$")
UNDERLINE = re.compile(r"^-{3,}$")
NAME = re.compile(r"(?<![`\[])`(?P<name>\w+)`(?!`)")


class PlainDocstrings(griffe.Extension):
    """Rewrites each docstring before mkdocstrings renders it."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)


def as_markdown(docstring: str) -> str:
    """A docstring with its arguments as a list and its examples as code.

    >>> print(as_markdown("An angle.\\n\\nh : height [m],\\n    above the sea."))
    An angle.
    <BLANKLINE>
    * **h**: height [m],
        above the sea.
    """
    paragraphs = docstring.strip().split("\n\n")
    return "\n\n".join(paragraph_as_markdown(text) for text in paragraphs)


def paragraph_as_markdown(text: str) -> str:
    """One paragraph: an example, a list of arguments, or sentences."""
    if text.startswith(">>> "):
        return f"```pycon\n{text}\n```"
    lines = []
    for line in text.splitlines():
        argument = ARGUMENT.match(line)
        if UNDERLINE.match(line):
            lines[-1] = f"**{lines[-1]}**\n"
        elif argument:
            lines.append(f"* **{argument['names']}**: {argument['text']}")
        else:
            lines.append(line)
    return NAME.sub(link, "\n".join(lines))


def link(found: re.Match[str]) -> str:
    """A name in backticks, with a link if the reference has it."""
    place = places().get(found["name"])
    return f"[`{found['name']}`][{place}]" if place else found[0]


@cache
def places() -> dict[str, str]:
    """The public functions and classes of these modules, each with the place of its definition."""
    found: dict[str, str] = {}
    for name_of_module in DESCRIBED:
        module = importlib.import_module(name_of_module)
        for name in module.__all__:
            home = getattr(getattr(module, name), "__module__", None)
            if home is not None:  # constants have none, and are described only with a docstring
                found[name] = f"{home}.{name}"
    return found
