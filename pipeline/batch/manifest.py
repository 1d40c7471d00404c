"""The manifest of a finished run, and how the mission ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.plan import Plan

MANIFEST_VERSION = 1


@dataclass(frozen=True)
class Outcome:
    """How a mission ended: where its results are, its manifest, and its exit code."""

    name: str
    output: Path
    manifest: dict[str, Any]
    exit_code: int
    repeated: bool


def outcome_of(plan: Plan, manifest: dict[str, Any], *, repeated: bool) -> Outcome:
    """The outcome that a manifest describes."""
    return Outcome(
        plan.mission.mission.name, plan.output, manifest, int(manifest["exit_code"]), repeated
    )
