"""An unchanged campaign of 1,000 missions beside the parsing of their files, once."""

from __future__ import annotations

import os
import resource
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
    sections = yaml.safe_load(flown.missions["bin"].read_text(encoding="utf-8"))
    for number in range(MISSIONS):
        place = folder / "flights" / f"{number:04d}"
        place.mkdir(parents=True)
        shutil.copy(flown.logs["bin"], place)
        shutil.copy(flown.observations, place)
        sections["mission"]["name"] = f"flight-{number:04d}"
        sections["output"]["path"] = "results"
        (place / "mission.yaml").write_text(yaml.safe_dump(sections), encoding="utf-8")
        if number == 0:
            manifest = run_mission(place / "mission.yaml").manifest
            continue
        plan = plan_of(place / "mission.yaml")
        shutil.copytree(folder / "flights" / "0000" / "results", place / "results")
        text = manifest_text(manifest.with_values(plan.identity().row()))
        (place / "results" / "manifest.json").write_text(text, encoding="utf-8")
        if number == MISSIONS - 1:
            assert mission_status(place / "mission.yaml")[1] == []
    content = {"campaign": {"name": "season", "output": "."}, "missions": ["flights/*/*.yaml"]}
    (folder / "season.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return folder / "season.yaml"


def cpu_seconds(action: Callable[[], Any]) -> float:
    """CPU time of a call with the processes that it starts."""

    def spent() -> float:
        used = [resource.getrusage(of) for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(of.ru_utime + of.ru_stime for of in used)

    before = spent()
    action()
    return spent() - before


def test_an_unchanged_campaign_beside_the_parsing_of_its_files(ratios, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    file = campaign(tmp_path)
    files = sorted((tmp_path / "flights").glob("*/mission.yaml"))

    def run() -> str:
        command = [sys.executable, "-m", "unbend", "run", str(file)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    assert f"{MISSIONS:,} of {MISSIONS:,} missions" in run()  # now the manifests know the files
    parsing = cpu_seconds(lambda: [load_mission(path) for path in files])
    ratios.check(
        "an unchanged campaign of 1,000, times the parsing of its files",
        min(cpu_seconds(run) for _ in range(3)) / parsing,
        at_most=1.0,
    )
    os.utime(files[0].parent / "observations.parquet")
    assert f"{MISSIONS:,} of {MISSIONS:,} missions" in run()  # read again, and found the same
