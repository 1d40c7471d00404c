"""How a mission ended: done, refused, by a bug, or with the process that ran it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.object_store.place import Place
from pipeline.errors import UnbendError


@dataclass(frozen=True)
class Outcome:
    """How a mission ended: where its results are, its manifest, and its exit code."""

    name: str
    output: Path | Place
    manifest: dict[str, Any]
    exit_code: int
    repeated: bool


@dataclass(frozen=True)
class Receipt:
    """An outcome from another process, in less than a kilobyte: its manifest is at ``output``."""

    name: str
    output: Path | Place
    fingerprint: str
    exit_code: int
    repeated: bool


@dataclass(frozen=True)
class Bug:
    """A mission that ended in an unexpected exception."""

    traceback: str


@dataclass(frozen=True)
class Lost:
    """A mission whose process died: how, in words."""

    how: str


TaskEnd = Outcome | Receipt | UnbendError | Bug | Lost


def end_of(task: Callable[[], TaskEnd]) -> TaskEnd:
    """Run a mission; refusals and unexpected exceptions are returned, not raised."""
    try:
        return task()
    except UnbendError as error:
        return error
    except Exception:
        # The one broad except: a bug in one mission must not cost the user the others.
        return Bug(traceback.format_exc())
