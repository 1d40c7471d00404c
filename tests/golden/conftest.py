"""Whole runs, made once for all the tests that look at them."""

import pandas as pd
import pytest
import yaml

import unbend
from tests.conftest import without_plots
from tests.logs import REPOSITORY

KINDS = ("bin", "tlog", "mcap")
"""The logs of the one sample flight."""

needs_shared = pytest.mark.shared("logs")


def run_mission(path):
    """The mission with a report without plots."""
    with without_plots():
        return unbend.run_mission(path)


def write_mission(path, **sections):
    """A mission file from its sections."""
    text = yaml.safe_dump(sections, sort_keys=False)
    path.write_text(text, "utf-8")
    return path


def sample_sections(kind, output):
    """The mission file of a sample log, with absolute paths and another output."""
    folder = REPOSITORY / "configs"
    text = (folder / f"sample_{kind}.yaml").read_text("utf-8")
    sections = yaml.safe_load(text)
    for name in ("log", "observations"):
        path = folder / sections[name]["path"]
        sections[name]["path"] = str(path.resolve())
    sections["output"] = {"path": str(output)}
    return sections


def read_observations(folder):
    """All parts of a run, in order."""
    return pd.read_parquet(folder / "observations")


def run_sample(kind, folder, **changes):
    """Run the mission of a sample log with some of its sections changed."""
    folder.mkdir(parents=True, exist_ok=True)
    sections = sample_sections(kind, folder / "results")
    for name, change in changes.items():
        sections.setdefault(name, {}).update(change)
    path = write_mission(folder / f"{kind}.yaml", **sections)
    return run_mission(path)


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """The three logs of the one sample flight, corrected."""
    folder = tmp_path_factory.mktemp("sample")
    outcomes = {}
    for kind in KINDS:
        outcomes[kind] = run_sample(kind, folder / kind)
    return outcomes


@pytest.fixture(scope="session")
def truth():
    """What the simulator knows: observations, stations, profile, points."""
    tables = {}
    for path in (REPOSITORY / "sample_logs" / "truth").glob("*.parquet"):
        tables[path.stem] = pd.read_parquet(path)
    return tables
