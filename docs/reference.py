"""The generated parts of the pages: `<!-- generated: what of -->`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator

from docs.snippets import DOCS, printed_by
from unbend.config.keys import MissionKey, campaign_keys, mission_keys
from unbend.report import explanations
from unbend.tables import schemas

GENERATED = re.compile(r"<!-- generated: (\w+) (\w+) -->")

# Each role of a channel may be {name, unit}: said once, of the first of them.
REPEATED = re.compile(r"log\.channels\.(?!position\b)\w+\.")


def help_of(command: str) -> str:
    """What `unbend COMMAND --help` prints."""
    text, _ = printed_by([command, "--help"])
    lines = "\n".join(line.rstrip() for line in text.strip().splitlines())
    return f"```text\n{lines}\n```"


def keys_of(section: str) -> str:
    """The keys of a section of the mission file, each under a heading of its own."""
    found = [
        key
        for key in (*mission_keys(), *campaign_keys())
        if key.path.split(".")[0] == section and not REPEATED.match(key.path)
    ]
    return "\n\n".join(lines for key in found for lines in key_lines(key))


def key_lines(key: MissionKey) -> Iterator[str]:
    """A key: its heading, what it means, what it takes."""
    path = key.path.replace(".*", ".<name>", 1) if section_of_names(key) else key.path
    path = path.replace("channels.position.", "channels.<role>.")
    anchor = re.sub(r"[^a-z0-9]+", "-", key.path.lower()).strip("-")
    yield f"### `{path}` {{ #{anchor} }}"
    text = key.text[:1].upper() + key.text[1:]
    yield escaped(text.rstrip(".") + ".")
    facts = [f"Takes {escaped(key.allowed)}.", f"Default: {escaped(key.default)}."]
    if key.example:
        facts.append(f"Example: `{key.path.rsplit('.', 1)[-1]}: {key.example}`")
    yield " ".join(facts) + "\n{ .facts }"


def section_of_names(key: MissionKey) -> bool:
    """Whether the first `*` of a key stands for a name of the reader's choice."""
    return key.path.split(".")[0] in ("cameras", "mount", "events")


def columns_of(table: str) -> str:
    """The columns of a table of results."""
    rows = [
        f"| `{name}` | {unit or '-'} | {escaped(text)} |"
        for name, (_, unit, text) in schemas.columns_of(table).items()
    ]
    return "\n".join(["| column | unit | |", "|---|---|---|", *rows])


def escaped(text: str) -> str:
    """Text that Markdown leaves as it is; `code` stays code."""
    parts = re.split(r"(`[^`]*`)", text)
    plain = [re.sub(r"([*_<>|\\$\[\]{}])", r"\\\1", part) for part in parts[::2]]
    return "".join(a + b for a, b in zip(plain, [*parts[1::2], ""], strict=True))


def codes_of(table: str) -> str:
    """The exit codes, the list of all families, or the codes of one family."""
    if table == "exit":
        return exit_codes()
    if table == "families":
        return list_of_families()
    return "\n\n".join(lines for code in families()[table] for lines in code_lines(code))


def exit_codes() -> str:
    """A table of the exit codes."""
    rows = [
        f"| {code} | {escaped(e.means)} | {escaped(e.effect)} | {escaped(e.remedy)} |"
        for code, e in explanations.meanings()["exit"].items()
    ]
    return "\n".join(["| code | means | the results | to do |", "|---|---|---|---|", *rows])


def families() -> dict[str, list[str]]:
    """The codes of each family, which is called by the first word of its codes."""
    codes_of_family: dict[str, list[str]] = {}
    for code in sorted(explanations.meanings()["codes"]):
        codes_of_family.setdefault(code.split("-")[0], []).append(code)
    return codes_of_family


def family_page(family: str) -> str:
    """The place of a family's page in the site."""
    return f"codes/{family.lower()}.md"


def list_of_families() -> str:
    """A table of all codes, one row a family, each with a link to its explanation."""
    rows = ["| family | codes |", "|---|---|"]
    for family, codes in families().items():
        page = family_page(family)
        links = [f"[{code}]({page}#{code.lower()})" for code in codes]
        rows.append(f"| [{family}]({page}) | {', '.join(links)} |")
    return "\n".join(rows)


def code_lines(code: str) -> Iterator[str]:
    """A code: its heading, what it means, what it does to the result and what to do."""
    entry = explanations.meanings()["codes"][code]
    yield f"## {code}"
    yield escaped(entry.means)
    yield f"Effect: {escaped(entry.effect)} To do: {escaped(entry.remedy)}\n{{ .facts }}"


def project_urls() -> dict[str, str]:
    """The addresses that a maintainer fills into pyproject.toml: Repository and Issues, or none."""
    text = (DOCS.parent / "pyproject.toml").read_text(encoding="utf-8")
    urls: dict[str, str] = tomllib.loads(text)["project"].get("urls", {})
    return urls


def address_of(label: str) -> str:
    """A link to an address of the project, or what to do while there is none."""
    address = project_urls().get(label)
    if address is None:
        missing = "this one names no address yet: `[project.urls]` in `pyproject.toml`"
        return f"the maintainer of your copy ({missing})"
    return f"<{address}>"


PARTS: dict[str, Callable[[str], str]] = {
    "address": address_of,
    "codes": codes_of,
    "help": help_of,
    "keys": keys_of,
    "columns": columns_of,
}


def with_generated(markdown: str) -> str:
    """A page with its generated parts."""
    return GENERATED.sub(lambda found: PARTS[found[1]](found[2]), markdown)
