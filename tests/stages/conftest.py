"""What several tests of the stages start from."""

import pandas as pd
import pytest
import yaml

from tests.conftest import without_plots
from tests.stages.block_files import CABIN
from tests.stages.flown_files import Files
from unbend.simulate import SimulationOptions, simulate
from unbend.simulate.flight import fly


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
    with without_plots():
        mission.run_to_manifest()
    return mission


@pytest.fixture(scope="session")
def crossing_flight(tmp_path_factory):
    """Three lines with tie points between them."""
    options = SimulationOptions(
        seed=9,
        height_above_ground_m=2500.0,
        lines=3,
        exposures_per_line=5,
        points_per_image=25,
        image_noise_px=0.3,
    )
    return simulate(tmp_path_factory.mktemp("crossing"), options)


@pytest.fixture(scope="module")
def crossing_lines(crossing_flight):
    """The same without a log and windows: its folder, sections of its mission, true stations."""
    file = crossing_flight.missions["bin"]
    config = yaml.safe_load(file.read_text())
    for section in ("log", "mount", "events"):
        del config[section]
    for camera in config["cameras"].values():
        del camera["window"]
    truth = pd.read_parquet(crossing_flight.truth / "stations.parquet")
    return file.parent, config, truth


@pytest.fixture(scope="session")
def truth(flown):
    """Camera stations by image, and the flight as a function of time."""
    stations = pd.read_parquet(flown.truth / "stations.parquet")
    return stations.set_index("image"), fly(2500.0, 1, 3)


@pytest.fixture
def files(mission, truth):
    return Files(mission, *truth)
