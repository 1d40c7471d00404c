"""The explanations of `unbend help`: of keys, codes, statuses, columns and technical terms."""

import difflib
import importlib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from unbend.config.keys import MissionKey, campaign_keys, mission_keys
from unbend.errors import STORAGE_WRITE, Code
from unbend.report import messages
from unbend.tables.written_columns import DISPLACED_COLUMNS, columns_of

MAX_KEYS = 8  # that are explained; of further keys only the names are printed
MAX_SIMILAR_CODES = 3  # suggested for an unknown word
MAX_SIMILAR_NAMES = 3
LEAST_SIMILAR_CODE = 0.7  # by difflib; high, because codes share many letters
LEAST_SIMILAR_NAME = 0.6  # difflib's default

TITLES = {
    "exit": "exit code {}",
    "observations": "{} (status of observations)",
    "stations": "{} (status of stations)",
}
"""Section of `meanings` -> the title of an explanation of an exit code or a status."""


class Meaning(NamedTuple):
    """The explanation of a code or status: its meaning, effect on the result, and remedy."""

    means: str
    effect: str
    remedy: str

    def lines(self) -> list[str]:
        """The lines below the title of a code."""
        return [
            f"  {self.means}",
            f"  effect on the result: {self.effect}",
            f"  to do: {self.remedy}",
        ]


@cache
def meanings() -> Mapping[str, Mapping[str, Meaning]]:
    """The explanations by section and word.

    Sections are ``codes`` (of refusals and of the ledger), ``exit``, ``observations`` and
    ``stations`` (their statuses).
    """
    text = (
        resources.files(__package__)
        .joinpath("data/exit_codes_and_statuses.toml")
        .read_text("utf-8")
    )
    sections: dict[str, dict[str, Meaning]] = {"codes": {}}
    for section, entries in tomllib.loads(text).items():
        sections[section] = {word: Meaning(**entry) for word, entry in entries.items()}
    for code in all_codes():
        sections["codes"][code.name] = Meaning(code.means, code.effect, code.remedy)
    return sections


def all_codes() -> Iterator[Code]:
    """All codes of unbend: those defined in modules named messages, and STORAGE-WRITE."""
    yield STORAGE_WRITE
    root = Path(str(resources.files("unbend")))
    for path in sorted(root.rglob("messages.py")):
        module_name = ".".join(path.relative_to(root.parent).with_suffix("").parts)
        module = importlib.import_module(module_name)
        yield from (value for value in vars(module).values() if isinstance(value, Code))


@dataclass(frozen=True)
class Term:
    """A technical term: its name, its meaning, and its other names in lower case."""

    name: str
    means: str
    also: tuple[str, ...]


@cache
def glossary() -> tuple[Term, ...]:
    """The technical terms of ``data/glossary.toml``."""
    text = resources.files(__package__).joinpath("data/glossary.toml").read_text("utf-8")
    entries = tomllib.loads(text).items()
    return tuple(Term(name, entry["means"], tuple(entry["also"])) for name, entry in entries)


TABLES = {
    "observations": "observations/part-*.parquet",
    "stations": "stations.parquet",
    "profile": "profile.parquet",
    "campaign": "campaign.parquet",
    "lattice": "unbend export --format lattice",
    "radial": "unbend export --format radial",
}
"""Section of ``data/columns.toml`` -> the file or export with this table."""


def explain(word: str) -> list[str]:
    """Lines that explain a key, a code, an exit code, a status, a column or a technical term.

    A key is named completely or by its last part; a column is one of the results. A value such as
    ``omega_phi_kappa`` is explained by the keys that allow it. At most 8 keys are explained.
    Refuses (ConfigError HELP-WORD) an unknown word, and suggests similar ones.

    >>> explain("4")[0]
    'exit code 4'
    >>> explain("f_px")[:2]
    ['cameras.*.f_px', '  principal distance, if it is the same along x and y']
    >>> explain("r_c_rad")[0], explain("GCP")[0]
    ('r_c_rad (column of observations)', 'gcp')
    """
    lower = word.strip().lower()
    code = lower.upper().strip(":")
    codes = meanings()["codes"]
    lines = _status_lines(lower)
    if not lines and code in codes:
        return [code, *codes[code].lines()]
    if not lines:
        lines += _key_lines(lower)
    for more in (_column_lines(lower), _term_lines(lower)):
        if lines and more:
            lines.append("")
        lines += more
    if not lines:
        lines = _value_lines(lower)
    if lines:
        return lines
    raise messages.help_word(word=word, near=", ".join(_similar_words(lower)))


def _status_lines(word: str) -> list[str]:
    """The explanation of an exit code or a status; empty if ``word`` is neither."""
    lines = []
    for kind, title in TITLES.items():
        if word in meanings()[kind]:
            lines += [title.format(word), *meanings()[kind][word].lines()]
    return lines


def _column_lines(word: str) -> list[str]:
    """The explanation of a column in each table of results that has it; empty without any."""
    lines = []
    for table in TABLES:
        columns = columns_of(table)
        if table == "observations":
            columns = {**DISPLACED_COLUMNS, **columns}
        if word in columns:
            _, unit, meaning = columns[word]
            shown_unit = f" [{unit}]" if unit not in ("", "1") else ""
            lines.append(f"{word} (column of {table})")
            lines.append(f"  {meaning or 'see the column before it'}{shown_unit}")
            lines.append(f"  in {TABLES[table]}")
    return lines


def _term_lines(word: str) -> list[str]:
    """The explanation of a technical term, empty if unknown; "-" and "_" count as blanks."""
    spaced = word.replace("_", " ").replace("-", " ")
    for entry in glossary():
        names = (entry.name, *entry.also)
        if word in names or spaced in [name.replace("-", " ") for name in names]:
            return [entry.name, f"  {entry.means}"]
    return []


def _value_lines(word: str) -> list[str]:
    """The explanations of the keys that allow ``word`` as a value; empty without any.

    ``word`` is in lower case, values such as ``OPENCV`` need not be.
    """
    keys = [*mission_keys(), *campaign_keys()]
    keys_with_value = []
    for key in keys:
        if word in map(str.lower, _values_of(key)):
            keys_with_value.append(key)
    if not keys_with_value:
        return []
    return [f"{word} (value of keys)", "", *_lines_of_keys(keys_with_value, keys)]


def _values_of(key: MissionKey) -> list[str]:
    """The words that a key allows as values; other values, such as a number, are left out.

    >>> (key,) = [key for key in mission_keys() if key.path == "observations.match_names"]
    >>> _values_of(key)
    ['case', 'extension', 'folder', 'digits']
    """
    values = []
    for value in re.split(r" \| | or ", key.allowed.removeprefix("a list of ")):
        is_description = value.startswith(("a ", "an ")) or "," in value
        if not is_description:
            values.append(value)
    return values


def _key_lines(word: str) -> list[str]:
    """The explanations of the keys with this name; empty without any."""
    keys = [*mission_keys(), *campaign_keys()]
    return _lines_of_keys(_keys_called(word, keys), keys)


def _lines_of_keys(selected: Sequence[MissionKey], keys: Sequence[MissionKey]) -> list[str]:
    """The explanations of the first 8 ``selected`` keys, and the names of the others.

    ``keys`` are all keys, among which those within a key are looked up.
    """
    lines: list[str] = []
    for key in selected[:MAX_KEYS]:
        if lines:
            lines.append("")
        lines += [key.path, f"  {key.text}", f"  takes: {key.allowed}", f"  default: {key.default}"]
        if key.example:
            lines.append(f"  example: {key.example}")
        names = _names_within(key, keys)
        if names:
            lines.append(f"  within it: {', '.join(names)}")
    more = [key.path for key in selected[MAX_KEYS:]]
    if more:
        lines += ["", f"and: {', '.join(more)}"]
    return lines


def _keys_called(word: str, keys: Sequence[MissionKey]) -> list[MissionKey]:
    """The keys with a path that is ``word``; if there is none, those with a path that ends so.

    ``*`` in a path stands for any name, such as that of a camera.
    """
    parts = word.strip(".").split(".")
    with_this_end = []
    for key in keys:
        end = key.path.split(".")[-len(parts) :]
        has_last_part = len(end) == len(parts) and end[-1] == parts[-1]
        if has_last_part and all(
            in_key in ("*", part) for in_key, part in zip(end, parts, strict=True)
        ):
            with_this_end.append(key)
    with_this_path = [key for key in with_this_end if len(key.path.split(".")) == len(parts)]
    return with_this_path or with_this_end


def _names_within(key: MissionKey, keys: Sequence[MissionKey]) -> list[str]:
    """The names of the keys directly within a key, or within its entries ``*``."""
    names: dict[str, None] = {}  # each once, in their order
    for other in keys:
        if other.path.startswith(f"{key.path}."):
            below = other.path.removeprefix(key.path).removeprefix(".*")
            if below.count(".") == 1:
                names[below[1:]] = None
    return list(names)


def _similar_words(word: str) -> list[str]:
    """Codes, keys, values, statuses, columns and terms with a name similar to ``word``."""
    similar = difflib.get_close_matches(
        word.upper(), meanings()["codes"], MAX_SIMILAR_CODES, LEAST_SIMILAR_CODE
    )
    keys = [*mission_keys(), *campaign_keys()]
    names: dict[str, str] = {}  # name that is compared -> word that is suggested
    for key in keys:
        names |= {value: value for value in _values_of(key)}
    names |= {key.path.rpartition(".")[2]: key.path for key in keys}
    for kind in TITLES:
        names |= {status: status for status in meanings()[kind]}
    for table in TABLES:
        names |= {column: column for column in columns_of(table)}
    for entry in glossary():
        names |= dict.fromkeys((entry.name, *entry.also), entry.name)
    last_part = word.rpartition(".")[2]
    for name in difflib.get_close_matches(last_part, names, MAX_SIMILAR_NAMES, LEAST_SIMILAR_NAME):
        similar.append(names[name])
    return list(dict.fromkeys(similar))  # each once
