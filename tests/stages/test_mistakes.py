"""Mistakes that survey engineers make: caught by `check` with the key to change.

The list was written by a reader of the README alone. Those that are not caught are named here, with
the reason; a sound mission beside each kind raises nothing. Of the list, UNBEND_MISTAKES (6; `make
faults`: all) are drawn from UNBEND_SEED.
"""

from __future__ import annotations

import os
import random
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.draws import SEED
from unbend.batch import opening
from unbend.batch.runs import check_mission
from unbend.errors import UnbendError

from .mistaken import MISTAKES, write_mistake

LIST = yaml.safe_load(MISTAKES.read_text(encoding="utf-8"))

COUNT = min(int(os.environ.get("UNBEND_MISTAKES", "6")), len(LIST["mistakes"]))
DRAWN = random.Random(SEED).sample(LIST["mistakes"], COUNT)

MISSED = {
    "orientation-date-of-processing": "without a log nothing else has the date",
    "cameras-exchanged-in-events": "both fire at the same moments: nothing changes",
    "pixel-origin-centre": "half a pixel",
}
"""Mistakes that end with code 0: id -> why."""


@pytest.fixture(scope="module", autouse=True)
def parsed_once(computed_once: None) -> Iterator[None]:
    """Logs are parsed once, and what is the same in many missions is computed once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, "open_log", lru_cache(None)(opening.open_log))
        yield


def checked(folder: Path, mistake: dict[str, Any]) -> tuple[int, str]:
    """Exit code of `check`, and what it says that is no note."""
    try:
        manifest = check_mission(write_mistake(folder, mistake)).manifest.values
    except UnbendError as error:
        return error.exit_code, str(error)
    grave = [e for e in manifest["ledger"] if e["kind"] in ("finding", "loss")]
    text = "\n".join(f"{e['code']}: {e['what']} ({e['where']})" for e in grave)
    return int(manifest["exit_code"]), text


def names(text: str, keys: str) -> bool:
    """Whether a text names one of the keys: as a whole, or its first and its last part."""
    for key in keys.split(" | "):
        *section, last = key.split(".")
        if all(re.search(rf"\b{re.escape(part)}\b", text) for part in (*section[:1], last)):
            return True
    return False


@pytest.mark.parametrize("mistake", DRAWN, ids=lambda mistake: str(mistake["id"]))
def test_a_mistake_is_caught_with_its_key(tmp_path: Path, mistake: dict[str, Any]) -> None:
    code, text = checked(tmp_path, mistake)
    if mistake["id"] in MISSED:
        assert code == 0, "caught by now: to be taken from the list of the missed"
        return
    assert code not in (0, 1), text
    assert names(text, mistake["key"]), text


@pytest.mark.parametrize("control", LIST["controls"], ids=lambda control: control["id"])
def test_what_is_right_raises_nothing(tmp_path: Path, control: dict[str, Any]) -> None:
    assert checked(tmp_path, control) == (0, "")


def test_hardly_any_is_missed() -> None:
    assert len(LIST["mistakes"]) >= 60
    assert len(LIST["mistakes"]) - len(MISSED) >= 57
    assert set(MISSED) <= {mistake["id"] for mistake in LIST["mistakes"]}
