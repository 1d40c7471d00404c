"""Mission and campaign files with values at their limits."""

from functools import cache, cached_property

import yaml
from pydantic import BaseModel

from tests.config import test_mission_file as missions
from tests.faults.extreme_inputs import WORDS, Reader
from unbend.config import load_mission
from unbend.config.campaign import open_configs

YAML_WORDS = (
    ".inf",
    "-.inf",
    ".nan",
    "1e400",
    "-1e400",
    "0x10",
    "1_000",
    "~",
    "!!bool x",
    "!!int x",
    "!!float x",
    "!!timestamp x",
    "!!timestamp 0001-01-01T00:00:00+23:59",
    "!!binary x",
    "!!set x",
    "!!omap [1]",
    "!!python/object:os.system x",
    "&loop [*loop]",
    "&loop {a: *loop}",
    "&loop {<<: *loop}",
    "*unknown",
    "[[[[[[]]]]]]",
    "[" * 3000,
    "{a: {a: {a: 1}}}",
    "9" * 5000,
    "[1.0e+308, -1.0e+308, 1.0e+308]",
    "[0.0, 0.0, 0.0]",
    "[0.0, 0.0]",
    "[-1.0, -1.0]",
    "- 1",
    "true",
    "2026-05-14",
    '"\\0"',
    "&a [&b [&c [&d [x, x, x], *d, *d, *d], *c, *c, *c], *b, *b, *b]",
)


@cache
def mission_texts():
    """Mission files of all kinds, written one key a line."""
    kinds = {
        "full": missions.FULL,
        "events": missions.with_csv_events(),
        "oriented": missions.ORIENTED,
        "projected": missions.oriented(missions.PROJECTED),
        "topocentric": missions.oriented(missions.TOPOCENTRIC),
    }
    for number, values in enumerate(missions.with_imports()):
        kinds[f"imports {number}"] = values
    return {
        name: yaml.dump(values, Dumper=_without_aliases(), sort_keys=False, width=10_000)
        for name, values in kinds.items()
    }


def _without_aliases():
    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data):
            return True

    return Dumper


def extreme_mission(text, draw):
    """A mission file one to three of whose values are at their limits."""
    lines = text.splitlines()
    for _ in range(draw.choice((1, 1, 1, 3))):
        row = draw.randrange(len(lines))
        key, colon, value = lines[row].partition(": ")
        if colon and value:
            word = draw.choice((*YAML_WORDS, *WORDS))
            if word in WORDS and draw.random() < 0.3:
                word = f'"{word}"'
            lines[row] = f"{key}: {word}"
        elif lines[row].lstrip().startswith("- "):
            indent = lines[row].partition("- ")[0]
            lines[row] = f"{indent}- {draw.choice((*YAML_WORDS, *WORDS))}"
    return "\n".join(lines) + "\n"


def write_mission(folder, draw):
    texts = mission_texts()
    text = texts[draw.choice(list(texts))]
    (folder / "mission.yaml").write_text(extreme_mission(text, draw), "utf-8")


def write_campaign(folder, draw):
    """A campaign with defaults and a mission that stands in its file."""
    texts = mission_texts()
    text = extreme_mission(texts["full"], draw)
    inside = "\n".join(f"    {line}" for line in text.splitlines())
    name = draw.choice((*YAML_WORDS, *WORDS, "*.yaml", "a.yaml"))
    content = f"campaign: c\ndefaults:\n{inside}\nmissions:\n- mission: {{name: a}}\n- {name}\n"
    (folder / "campaign.yaml").write_text(content, "utf-8")


def derived_values(section):
    """Ask a section, and those in it, for all that follows from its values."""
    if isinstance(section, dict):
        for inner in section.values():
            derived_values(inner)
    elif isinstance(section, list | tuple):
        for inner in section:
            derived_values(inner)
    elif isinstance(section, BaseModel):
        for name in vars(type(section)):
            kind = vars(type(section))[name]
            if not name.startswith("_") and isinstance(kind, property | cached_property):
                ask(section, name)
        for name in type(section).model_fields:
            derived_values(getattr(section, name))


def ask(section, name):
    """Compute a property; that of a camera in a file, which is not there, cannot be."""
    try:
        getattr(section, name)
    except ValueError as error:
        if "has not been read" not in str(error):
            raise


def read_mission(folder):
    derived_values(load_mission(folder / "mission.yaml"))


def read_campaign(folder):
    missions, _ = open_configs([folder / "campaign.yaml"])
    for mission in missions:
        derived_values(mission.load())


MISSIONS = {
    "mission file": Reader(write_mission, read_mission),
    "campaign file": Reader(write_campaign, read_campaign),
}
