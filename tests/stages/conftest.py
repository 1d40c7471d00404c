"""What several tests of the stages start from."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from block_files import CABIN


@pytest.fixture
def whole_report():
    """Asks for reports with their plots."""


@pytest.fixture(autouse=True)
def _without_plots(request):
    """Reports are what the tests of `report` and of the command line are about."""
    if "whole_report" not in request.fixturenames:
        request.getfixturevalue("plain_report")


@pytest.fixture(scope="module")
def by_log(mission_factory, tmp_path_factory):
    """The mission by its log, in the standard atmosphere behind windows of constant air."""
    mission = mission_factory(tmp_path_factory.mktemp("by_log") / "mission")
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = {"cabin": CABIN}
    ended = mission.run()
    assert ended.code == 0, ended.text
    return mission
