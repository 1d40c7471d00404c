"""What a key, a code or an exit code means: the words of `unbend help`."""

import difflib
import importlib
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from unbend.config.keys import campaign_keys, mission_keys
from unbend.errors import STORAGE_WRITE, Code
from unbend.report import messages

_MOST_LISTED = 8
_NUMBERS_AND_STATUSES = {"exit": "exit code {}", "observations": "{} (status of observations)",
                         "stations": "{} (status of stations)"}  # fmt: skip


class Meaning(NamedTuple):
    """Of a code: what it means, what it does to the result, and what to do."""

    means: str
    effect: str
    remedy: str

    def lines(self) -> list[str]:
        return [
            f"  {self.means}", f"  effect on the result: {self.effect}", f"  to do: {self.remedy}"
        ]  # fmt: skip


@cache
def meanings() -> Mapping[str, Mapping[str, Meaning]]:
    """Of ``codes`` of refusals and of the ledger, ``exit`` codes, and statuses."""
    text = resources.files(__package__).joinpath("exit_codes_and_statuses.toml").read_text("utf-8")
    found = {
        of: {word: Meaning(**entry) for word, entry in entries.items()}
        for of, entries in tomllib.loads(text).items()
    }
    for code in codes():
        found.setdefault("codes", {})[code.name] = Meaning(code.means, code.effect, code.remedy)
    return found


def codes() -> Iterator[Code]:
    """The codes of all rooms, which stand in modules called messages, and that of every room."""
    yield STORAGE_WRITE
    root = Path(str(resources.files("unbend")))
    for path in sorted(root.rglob("messages.py")):
        words = path.relative_to(root.parent).with_suffix("").parts
        room = importlib.import_module(".".join(words))
        yield from (value for value in vars(room).values() if isinstance(value, Code))


def explain(word: str) -> list[str]:
    """Lines that explain a key (whole or its last part), a code, an exit code or a status.

    Of several keys 8 are explained. Refuses (ConfigError HELP-WORD) a word that is none.

    >>> explain("4")[0]
    'exit code 4'
    >>> explain("f_px")[:2]
    ['cameras.*.f_px', '  principal distance, where it is the same along x and y']
    """
    small, code, known = word.lower(), word.upper().strip(":"), meanings()["codes"]
    of_word = [
        line for of, text in _NUMBERS_AND_STATUSES.items() if small in meanings()[of]
        for line in (text.format(small), *meanings()[of][small].lines())
    ]  # fmt: skip
    if of_word:
        return of_word
    if code in known:
        return [code, *known[code].lines()]
    keys = [*mission_keys(), *campaign_keys()]
    parts = word.strip(".").lower().split(".")
    tails = [(key, key.path.split(".")[-len(parts) :]) for key in keys]
    found = [  # * of a key stands for any name
        key for key, tail in tails
        if len(tail) == len(parts) and tail[-1] == parts[-1]
        and all(a in ("*", b) for a, b in zip(tail, parts, strict=True))
    ]  # fmt: skip
    whole = [key for key in found if len(key.path.split(".")) == len(parts)]
    found = whole or found
    if not found:
        last = {key.path.rpartition(".")[2]: key.path for key in keys}
        near = difflib.get_close_matches(code, known, 3, 0.7)
        last |= {status: status for of in _NUMBERS_AND_STATUSES for status in meanings()[of]}
        near += difflib.get_close_matches(parts[-1], last, 3, 0.6)
        raise messages.help_word(word=word, near=", ".join(near))
    lines = []
    for key in found[:_MOST_LISTED]:
        lines += [key.path, f"  {key.text}", f"  takes: {key.allowed}", f"  default: {key.default}"]
        lines += [f"  example: {key.example}"] if key.example else []
        within = [k.path.removeprefix(key.path).removeprefix(".*") for k in keys
                  if k.path.startswith(f"{key.path}.")]  # fmt: skip
        names = [path[1:] for path in dict.fromkeys(within) if path.count(".") == 1]
        lines += [f"  within it: {', '.join(names)}"] if names else []
        lines.append("")
    more = [key.path for key in found[_MOST_LISTED:]]
    return lines[:-1] + ([f"and: {', '.join(more)}"] if more else [])
