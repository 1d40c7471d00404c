"""The generated parts of the pages: `<!-- generated: what of -->`."""

import re
import tomllib
from collections.abc import Callable, Iterator

from docs.snippets import DOCS, printed_by
from unbend.config.keys import MissionKey, campaign_keys, mission_keys
from unbend.report import explanations
from unbend.tables import written_columns

GENERATED = re.compile(r"<!-- generated: (\w+) (\w+) -->")

# Each role of a channel may be {name, unit}: said once, of the first of them.
REPEATED = re.compile(r"log\.channels\.(?!position\b)\w+\.")


def help_of(command: str) -> str:
    """What `unbend COMMAND --help` prints."""
    text, _ = printed_by([command, "--help"])
    text = re.sub(r" +$", "", text.strip(), flags=re.MULTILINE)
    return f"```text\n{text}\n```"


def keys_of(section: str) -> str:
    """The keys of a section of the mission file, each under a heading of its own."""
    lines: list[str] = []
    for key in (*mission_keys(), *campaign_keys()):
        if key.path.split(".")[0] == section and not REPEATED.match(key.path):
            lines += key_lines(key)
    return "\n\n".join(lines)


def key_lines(key: MissionKey) -> Iterator[str]:
    """A key: its heading, what it means, what it takes."""
    path = key.path.replace("channels.position.", "channels.<role>.")
    if section_of_names(key):
        path = path.replace(".*", ".<name>", 1)
    anchor = re.sub(r"[^a-z0-9]+", "-", key.path.lower()).strip("-")
    yield f"### `{path}` {{ #{anchor} }}"
    text = key.text.rstrip(".")
    text = text[:1].upper() + text[1:]
    yield escaped(f"{text}.")
    facts = f"Takes {escaped(key.allowed)}. Default: {escaped(key.default)}."
    if key.example:
        name = key.path.rsplit(".", 1)[-1]
        facts += f" Example: `{name}: {key.example}`"
    yield f"{facts}\n{{ .facts }}"


def section_of_names(key: MissionKey) -> bool:
    """Whether the first `*` of a key stands for a name of the reader's choice."""
    section = key.path.split(".")[0]
    return section in ("cameras", "mount", "events")


def columns_of(table: str) -> str:
    """The columns of a table of results."""
    rows = ["| column | unit | |", "|---|---|---|"]
    for name, (_, unit, text) in written_columns.columns_of(table).items():
        shown_unit = unit or "-"
        rows.append(f"| `{name}` | {shown_unit} | {escaped(text)} |")
    return "\n".join(rows)


def escaped(text: str) -> str:
    """Text that Markdown leaves as it is; `code` stays code."""
    parts = re.split(r"(`[^`]*`)", text)
    for number in range(0, len(parts), 2):  # between pieces of code
        parts[number] = re.sub(r"([*_<>|\\$\[\]{}])", r"\\\1", parts[number])
    return "".join(parts)


def codes_of(table: str) -> str:
    """The exit codes, the list of all families, or the codes of one family."""
    if table == "exit":
        return exit_codes()
    if table == "families":
        return list_of_families()
    lines: list[str] = []
    for code in families()[table]:
        lines += code_lines(code)
    return "\n\n".join(lines)


def exit_codes() -> str:
    """A table of the exit codes."""
    rows = ["| code | means | the results | to do |", "|---|---|---|---|"]
    for code, entry in explanations.meanings()["exit"].items():
        means = escaped(entry.means)
        effect = escaped(entry.effect)
        remedy = escaped(entry.remedy)
        rows.append(f"| {code} | {means} | {effect} | {remedy} |")
    return "\n".join(rows)


def families() -> dict[str, list[str]]:
    """The codes of each family, which is called by the first word of its codes."""
    codes_of_family: dict[str, list[str]] = {}
    for code in sorted(explanations.meanings()["codes"]):
        family = code.split("-")[0]
        codes_of_family.setdefault(family, []).append(code)
    return codes_of_family


def family_page(family: str) -> str:
    """The place of a family's page in the site."""
    return f"codes/{family.lower()}.md"


def list_of_families() -> str:
    """A table of all codes, one row a family, each with a link to its explanation."""
    rows = ["| family | codes |", "|---|---|"]
    for family, codes in families().items():
        page = family_page(family)
        links = ", ".join(f"[{code}]({page}#{code.lower()})" for code in codes)
        rows.append(f"| [{family}]({page}) | {links} |")
    return "\n".join(rows)


def code_lines(code: str) -> Iterator[str]:
    """A code: its heading, what it means, what it does to the result and what to do."""
    entry = explanations.meanings()["codes"][code]
    effect = escaped(entry.effect)
    remedy = escaped(entry.remedy)
    yield f"## {code}"
    yield escaped(entry.means)
    yield f"Effect: {effect} To do: {remedy}\n{{ .facts }}"


def project_urls() -> dict[str, str]:
    """The addresses that a maintainer fills into pyproject.toml: Repository and Issues, or none."""
    text = (DOCS.parent / "pyproject.toml").read_text("utf-8")
    project = tomllib.loads(text)["project"]
    urls: dict[str, str] = project.get("urls", {})
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
