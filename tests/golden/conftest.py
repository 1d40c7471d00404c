"""Whole runs, made once for all the tests that look at them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import yaml

import unbend
from tests.conftest import without_plots
from unbend.batch.executors import Outcome

REPOSITORY = Path(__file__).resolve().parents[2]
SHARED = REPOSITORY.parent / "shared"

needs_shared = pytest.mark.shared("logs")


def run_mission(path: Path) -> Outcome:
    """The mission with a report without plots."""
    with without_plots():
        return unbend.run_mission(path)


def write_mission(path: Path, **sections: object) -> Path:
    """A mission file from its sections."""
    path.write_text(yaml.safe_dump(sections, sort_keys=False), encoding="utf-8")
    return path


def sample_sections(kind: str, output: Path) -> dict[str, dict[str, object]]:
    """The mission file of a sample log, with absolute paths and another output."""
    folder = REPOSITORY / "configs"
    sections = yaml.safe_load((folder / f"sample_{kind}.yaml").read_text(encoding="utf-8"))
    for name in ("log", "observations"):
        sections[name]["path"] = str((folder / sections[name]["path"]).resolve())
    sections["output"] = {"path": str(output)}
    return sections


def read_observations(folder: Path) -> pd.DataFrame:
    """All parts of a run, in order."""
    parts = sorted((folder / "observations").glob("part-*.parquet"))
    return pd.concat([pd.read_parquet(part) for part in parts], ignore_index=True)


def run_sample(kind: str, folder: Path, **changes: dict[str, object]) -> Outcome:
    """Run the mission of a sample log with some of its sections changed."""
    folder.mkdir(parents=True, exist_ok=True)
    sections = sample_sections(kind, folder / "results")
    for name, change in changes.items():
        sections[name] = {**sections.get(name, {}), **change}
    return run_mission(write_mission(folder / f"{kind}.yaml", **sections))


@pytest.fixture(scope="session")
def runs(tmp_path_factory) -> dict[str, Outcome]:
    """The three logs of the one sample flight, corrected."""
    folder = tmp_path_factory.mktemp("sample")
    return {kind: run_sample(kind, folder / kind) for kind in ("bin", "tlog", "mcap")}


@pytest.fixture(scope="session")
def truth() -> dict[str, pd.DataFrame]:
    """What the simulator knows: observations, stations, profile, points."""
    folder = REPOSITORY / "sample_logs" / "truth"
    return {path.stem: pd.read_parquet(path) for path in folder.glob("*.parquet")}
