"""What a key, a code, a column or a word means: the words of `unbend help`."""

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

MAX_KEYS = 8  # that are explained
MAX_NEAR_CODES = 3
MAX_NEAR_NAMES = 3
LIKE_A_CODE = 0.7  # similarity by difflib: codes share many letters
LIKE_A_NAME = 0.6  # difflib's usual value

TITLES = {
    "exit": "exit code {}",
    "observations": "{} (status of observations)",
    "stations": "{} (status of stations)",
}
"""How the explanation of an exit code or a status begins."""


class Meaning(NamedTuple):
    """Of a code: what it means, what it does to the result, and what to do."""

    means: str
    effect: str
    remedy: str

    def lines(self) -> list[str]:
        """The text below a code."""
        return [
            f"  {self.means}",
            f"  effect on the result: {self.effect}",
            f"  to do: {self.remedy}",
        ]


@cache
def meanings() -> Mapping[str, Mapping[str, Meaning]]:
    """Of ``codes`` of refusals and of the ledger, ``exit`` codes, and statuses."""
    text = (
        resources.files(__package__)
        .joinpath("data/exit_codes_and_statuses.toml")
        .read_text("utf-8")
    )
    meanings_of: dict[str, dict[str, Meaning]] = {"codes": {}}
    for kind, entries in tomllib.loads(text).items():
        meanings_of[kind] = {word: Meaning(**entry) for word, entry in entries.items()}
    for code in codes():
        meanings_of["codes"][code.name] = Meaning(code.means, code.effect, code.remedy)
    return meanings_of


def codes() -> Iterator[Code]:
    """The codes of all packages, in their modules called messages, and STORAGE-WRITE."""
    yield STORAGE_WRITE
    root = Path(str(resources.files("unbend")))
    for path in sorted(root.rglob("messages.py")):
        words = path.relative_to(root.parent).with_suffix("").parts
        module = importlib.import_module(".".join(words))
        yield from (value for value in vars(module).values() if isinstance(value, Code))


@dataclass(frozen=True)
class Word:
    """A word of the field: its name, what it means, and other names in small letters."""

    name: str
    means: str
    also: tuple[str, ...]


@cache
def glossary() -> tuple[Word, ...]:
    """The words of ``data/glossary.toml``."""
    text = resources.files(__package__).joinpath("data/glossary.toml").read_text("utf-8")
    entries = tomllib.loads(text).items()
    return tuple(Word(name, entry["means"], tuple(entry["also"])) for name, entry in entries)


TABLES = {
    "observations": "observations/part-*.parquet",
    "stations": "stations.parquet",
    "profile": "profile.parquet",
    "campaign": "campaign.parquet",
    "lattice": "unbend export --format lattice",
    "radial": "unbend export --format radial",
}
"""Tables whose columns are explained, and where they are."""


def explain(word: str) -> list[str]:
    """Lines that explain a key, a code, an exit code, a status, a column or a word of the field.

    A key is named whole or by its last part; a column is one of the results. A value of keys, as
    ``omega_phi_kappa``, is explained by these keys. Of several keys 8 are explained. Refuses
    (ConfigError HELP-WORD) a word that is none of these.

    >>> explain("4")[0]
    'exit code 4'
    >>> explain("f_px")[:2]
    ['cameras.*.f_px', '  principal distance, if it is the same along x and y']
    >>> explain("r_c_rad")[0], explain("GCP")[0]
    ('r_c_rad (column of observations)', 'gcp')
    """
    small = word.strip().lower()
    code = small.upper().strip(":")
    codes = meanings()["codes"]
    lines = _status_lines(small)
    if not lines and code in codes:
        return [code, *codes[code].lines()]
    if not lines:
        lines += _key_lines(small)
    for more in (_column_lines(small), _word_lines(small)):
        if lines and more:
            lines.append("")
        lines += more
    if not lines:
        lines = _value_lines(small)
    if lines:
        return lines
    raise messages.help_word(word=word, near=", ".join(_near(small)))


def _status_lines(word: str) -> list[str]:
    """What an exit code or a status means."""
    lines = []
    for kind, title in TITLES.items():
        if word in meanings()[kind]:
            lines += [title.format(word), *meanings()[kind][word].lines()]
    return lines


def _column_lines(word: str) -> list[str]:
    """What a column of results holds, table by table."""
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


def _word_lines(word: str) -> list[str]:
    """What a word of the field means."""
    plain = word.replace("_", " ").replace("-", " ")
    for entry in glossary():
        names = (entry.name, *entry.also)
        if word in names or plain in [name.replace("-", " ") for name in names]:
            return [entry.name, f"  {entry.means}"]
    return []


def _value_lines(word: str) -> list[str]:
    """What the keys that take a word as their value are; the first 8, and the names of others.

    The word is in lower case, values such as ``OPENCV`` in any.
    """
    keys = [*mission_keys(), *campaign_keys()]
    taking = []
    for key in keys:
        if word in map(str.lower, _values_of(key)):
            taking.append(key)
    if not taking:
        return []
    return [f"{word} (value of keys)", "", *_lines_of_keys(taking, keys)]


def _values_of(key: MissionKey) -> list[str]:
    """The words that a key takes.

    >>> (key,) = [key for key in mission_keys() if key.path == "ground.reference"]
    >>> _values_of(key)
    ['msl', 'ellipsoid', 'relative']
    """
    values = []
    for value in re.split(r" \| | or ", key.allowed):
        if " " not in value:
            values.append(value)
    return values


def _key_lines(word: str) -> list[str]:
    """What a key takes; of several with this name, the first 8, and the names of the others."""
    keys = [*mission_keys(), *campaign_keys()]
    return _lines_of_keys(_keys_called(word, keys), keys)


def _lines_of_keys(called: Sequence[MissionKey], keys: Sequence[MissionKey]) -> list[str]:
    """The first 8 keys of those that are ``called``, of all ``keys``, and the others' names."""
    lines: list[str] = []
    for key in called[:MAX_KEYS]:
        if lines:
            lines.append("")
        lines += [key.path, f"  {key.text}", f"  takes: {key.allowed}", f"  default: {key.default}"]
        if key.example:
            lines.append(f"  example: {key.example}")
        names = _names_within(key, keys)
        if names:
            lines.append(f"  within it: {', '.join(names)}")
    more = [key.path for key in called[MAX_KEYS:]]
    if more:
        lines += ["", f"and: {', '.join(more)}"]
    return lines


def _keys_called(word: str, keys: Sequence[MissionKey]) -> list[MissionKey]:
    """The keys of a name; ``*`` of a key stands for any name. Whole names go before last parts."""
    parts = word.strip(".").split(".")
    called = []
    for key in keys:
        tail = key.path.split(".")[-len(parts) :]
        is_same = len(tail) == len(parts) and tail[-1] == parts[-1]
        if is_same and all(in_key in ("*", part) for in_key, part in zip(tail, parts, strict=True)):
            called.append(key)
    whole = [key for key in called if len(key.path.split(".")) == len(parts)]
    return whole or called


def _names_within(key: MissionKey, keys: Sequence[MissionKey]) -> list[str]:
    """The names of the keys right below a key."""
    names: dict[str, None] = {}  # each once, in their order
    for other in keys:
        if other.path.startswith(f"{key.path}."):
            below = other.path.removeprefix(key.path).removeprefix(".*")
            if below.count(".") == 1:
                names[below[1:]] = None
    return list(names)


def _near(word: str) -> list[str]:
    """Codes, keys, their values, statuses, columns and words that are like a word."""
    codes_of_meanings = meanings()["codes"]
    near = difflib.get_close_matches(word.upper(), codes_of_meanings, MAX_NEAR_CODES, LIKE_A_CODE)
    keys = [*mission_keys(), *campaign_keys()]
    names: dict[str, str] = {}
    for key in keys:
        names |= {value: value for value in _values_of(key)}
    names |= {key.path.rpartition(".")[2]: key.path for key in keys}
    for kind in TITLES:
        names |= {status: status for status in meanings()[kind]}
    for table in TABLES:
        names |= {column: column for column in columns_of(table)}
    for entry in glossary():
        names |= dict.fromkeys((entry.name, *entry.also), entry.name)
    last = word.rpartition(".")[2]
    for name in difflib.get_close_matches(last, names, MAX_NEAR_NAMES, LIKE_A_NAME):
        near.append(names[name])
    return list(dict.fromkeys(near))
