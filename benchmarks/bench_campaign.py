"""An unchanged campaign of 1,000 missions beside the parsing of their files, once."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from unbend.batch.manifest import manifest_text
from unbend.batch.runs import mission_status, plan_of, run_mission
from unbend.config import load_mission
from unbend.simulate import SimulationOptions, simulate

MISSIONS = 1000
SMALL = SimulationOptions(
    seed=5, height_above_ground_m=2500.0, lines=1, exposures_per_line=3, points_per_image=12
)


def campaign(folder: Path) -> Path:
    """Missions with a log, a table and results of their own.

    One is run. The results of the others are copies of its own, each with a manifest that says what
    a run of it would: `mission_status` agrees.
    """
    flown = simulate(folder / "flown", SMALL)
    sections = yaml.safe_load(flown.missions["bin"].read_text("utf-8"))
    sections["output"]["path"] = "results"
    files = []
    for number in range(MISSIONS):
        place = folder / "flights" / f"{number:04d}"
        place.mkdir(parents=True)
        shutil.copy(flown.logs["bin"], place)
        shutil.copy(flown.observations, place)
        sections["mission"]["name"] = f"flight-{number:04d}"
        files.append(place / "mission.yaml")
        write_yaml(files[-1], sections)
    first, *others = files
    manifest = run_mission(first).manifest
    for file in others:
        values = plan_of(file).identity().row()
        results = file.parent / "results"
        shutil.copytree(first.parent / "results", results)
        text = manifest_text(manifest.with_values(values))
        (results / "manifest.json").write_text(text, "utf-8")
    _, differences = mission_status(files[-1])
    assert differences == []
    content = {"campaign": {"name": "season", "output": "."}, "missions": ["flights/*/*.yaml"]}
    write_yaml(folder / "season.yaml", content)
    return folder / "season.yaml"


def write_yaml(path: Path, content: dict[str, Any]):
    path.write_text(yaml.safe_dump(content), "utf-8")


def cpu_seconds(action: Callable[[], Any]) -> float:
    """CPU time of a call with the processes that it starts."""
    before = os.times()
    action()
    after = os.times()
    return sum(after[:4]) - sum(before[:4])


def test_an_unchanged_campaign_beside_the_parsing_of_its_files(ratios, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    file = campaign(tmp_path)
    files = sorted((tmp_path / "flights").glob("*/mission.yaml"))
    all_missions = f"{MISSIONS:,} of {MISSIONS:,} missions"

    def run() -> str:
        command = [sys.executable, "-m", "unbend", "run", str(file)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    def parse():
        for path in files:
            load_mission(path)

    assert all_missions in run()  # now the manifests know the files
    parsing = cpu_seconds(parse)
    running = min(cpu_seconds(run) for _ in range(3))
    ratios.check(
        "an unchanged campaign of 1,000, times the parsing of its files",
        running / parsing,
        at_most=1.0,
    )
    os.utime(files[0].parent / "observations.parquet")
    assert all_missions in run()  # read again, and found the same
