"""A small simulated mission that tests may copy, spoil and run through the command line."""

import contextlib
import io
import itertools
import json
import math
import os
import pickle
import random
import re
import shutil
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tests.shared_by_tests  # noqa: F401  # isort: skip (before numpy, numba, matplotlib)

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import settings

from tests.draws import SEED
from unbend.simulate import SimulationOptions, simulate

# No property depends on how loaded the machine is.
settings.register_profile("unbend", deadline=None)
settings.load_profile("unbend")

# Signals between processes, forks, named pipes, memory limits: Windows has none of them.
collect_ignore = (
    ["batch/test_processes.py", "cli/test_interrupts.py", "faults", "ingest/test_buffers.py"]
    if os.name == "nt"
    else []
)

SMALL = SimulationOptions(
    seed=5, height_above_ground_m=2500.0, lines=1, exposures_per_line=3, points_per_image=12
)


@dataclass(frozen=True)
class Ended:
    """How a command ended, and what it said."""

    code: int
    out: str
    err: str

    @property
    def text(self):
        return self.out + self.err


def run_command(*words):
    """`unbend` with these words, in this process."""
    from unbend.cli import main

    out = io.StringIO()
    err = io.StringIO()
    kept = sys.argv, sys.excepthook
    heard = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.argv = ["unbend", *(str(word) for word in words)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        sys.argv, sys.excepthook = kept
        for number, handler in heard.items():
            signal.signal(number, handler)
    return Ended(code, out.getvalue(), err.getvalue())


@dataclass
class MissionFolder:
    """A folder with a mission file, which a test changes as a dictionary, and its inputs."""

    folder: Path
    kind: str
    config: dict[str, Any]

    @property
    def file(self):
        return self.folder / "mission.yaml"

    @property
    def log(self):
        return self.folder / self.config["log"]["path"]

    @property
    def output(self):
        return self.folder / self.config["output"]["path"]

    def save(self):
        self.file.write_text(yaml.safe_dump(self.config, sort_keys=False), "utf-8")
        return self.file

    def run(self, *options):
        return run_command("run", self.save(), *options)

    def manifest(self):
        """The manifest of the last run, as JSON."""
        return json.loads((self.output / "manifest.json").read_text("utf-8"))

    def run_to_manifest(self, exit_code=0):
        """Run the mission, which must end with this code; its manifest as JSON."""
        ended = self.run()
        assert ended.code == exit_code, ended.text
        return self.manifest()

    def checked(self):
        """What `unbend check` finds of the mission as it is now."""
        from unbend.batch.runs import check_mission

        return check_mission(self.save())

    def refusal(self, code, exit_code=6):
        """Run the mission, which must be refused with this code; what the user reads."""
        ended = self.run()
        assert ended.code == exit_code, ended.text
        assert code in ended.err, ended.text
        return ended.err

    def measurements(self):
        return pq.read_table(self.folder / "observations.parquet").replace_schema_metadata(None)

    def measured_rows(self):
        """The measurements as a DataFrame."""
        return self.measurements().to_pandas()

    def measured_often(self, copies):
        """The measurements over and over, each time of other points."""
        once = self.measurements()
        parts = []
        place = once.schema.get_field_index("point")
        for number in range(copies):
            point = pc.binary_join_element_wise(once["point"].cast(pa.string()), str(number), "-")
            parts.append(once.set_column(place, "point", point))
        return pa.concat_tables(parts).combine_chunks()

    def observe(self, table, name="own.parquet"):
        """Make a table the observations of the mission."""
        pq.write_table(table, self.folder / name)
        self.config["observations"]["path"] = name

    def observe_rows(self, rows):
        """Make a DataFrame the observations of the mission."""
        self.observe(pa.Table.from_pandas(rows, preserve_index=False))

    def observe_text(self, text, name="own.csv"):
        """Make a CSV the observations of the mission."""
        content = text.encode() if isinstance(text, str) else text
        (self.folder / name).write_bytes(content)
        self.config["observations"]["path"] = name

    def results(self):
        return pq.read_table(self.output / "observations")

    def stations(self):
        return pq.read_table(self.output / "stations.parquet")

    def result_rows(self):
        """The results of the last run as a DataFrame."""
        return self.results().to_pandas()

    def station_rows(self):
        """The stations of the last run as a DataFrame."""
        return self.stations().to_pandas()


@contextlib.contextmanager
def at_home(folder):
    """A folder is the user's home, with the user's cache in it; programs started inherit it."""
    folder.mkdir()
    home = {"HOME": str(folder), "USERPROFILE": str(folder)}
    home["XDG_CACHE_HOME"] = str(folder / ".cache")
    elsewhere = ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in home.items():
            patch.setenv(name, value)
        for name in elsewhere:
            patch.delenv(name, raising=False)
        yield


@pytest.fixture(scope="session", autouse=True)
def homes(tmp_path_factory):
    """Folders for the homes of tests; what several tests use is made in the first of them."""
    folder = tmp_path_factory.mktemp("homes")
    with at_home(folder / "of_all"):
        yield (folder / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def own_home(homes):
    """Each test has a home and a cache of its own, gone when it ends."""
    home = next(homes)
    with at_home(home):
        yield home
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """A flight of one line: three logs, six images, some sixty observations."""
    return simulate(tmp_path_factory.mktemp("flown"), SMALL)


@pytest.fixture(scope="session")
def computed_once():
    """What takes most of a small run is computed once for equal inputs, in however many runs.

    What tie points say of a mission file, and the air of a flight: pure functions, known by all
    that they are given.
    """
    from unbend.messages import Ledger
    from unbend.stages import air_of_mission
    from unbend.stages.multi_image import tie_point_checks

    diagnose = tie_point_checks.diagnosis
    said = {}
    estimate = air_of_mission.build_adjusted_profile
    found = {}

    def diagnosis(stated):
        given = {name: value for name, value in vars(stated).items() if not callable(value)}
        at = [stated.shifted(seconds) for seconds in (-60.0, 1.0)] if stated.shifted else []
        key = pickle.dumps((given, at, stated.rays(stated.cameras, {})))
        if key not in said:
            said[key] = diagnose(stated)
        return said[key]

    def build(samples, standard, latitude, ledger, **named):
        key = pickle.dumps((samples, standard, latitude, named))
        if key not in found:
            own = Ledger()
            found[key] = estimate(samples, standard, latitude, own, **named), tuple(own)
        ledger.extend(found[key][1])
        return found[key][0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tie_point_checks, "diagnosis", diagnosis)
        patch.setattr(air_of_mission, "build_adjusted_profile", build)
        yield


FLOWN_S = 1_750_000_000
"""When the inputs of all copied missions were last written: a manifest has this time."""


@contextlib.contextmanager
def inputs_settled():
    """Inputs pass for old as soon as they are there: each run records when they were written.

    Otherwise it does so only 2 s after they were copied, which on a slow machine some runs are. The
    time of the copying (ctime) counts beside that of the content, and cannot be set.
    """
    from unbend.batch import input_files

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(input_files, "SETTLED_NS", -(10**9))
        yield


@pytest.fixture
def settled_inputs():
    """The inputs of a test pass for old as soon as they are there."""
    with inputs_settled():
        yield


@pytest.fixture(scope="session")
def mission_factory(flown, computed_once):
    """Copies the simulated mission into a folder."""

    def make(folder, kind="bin"):
        folder.mkdir(parents=True, exist_ok=True)
        for source in (flown.logs[kind], flown.observations):
            copy = shutil.copy(source, folder)
            os.utime(copy, (FLOWN_S, FLOWN_S))
        config = yaml.safe_load(flown.missions[kind].read_text("utf-8"))
        config["output"]["path"] = "results"
        return MissionFolder(folder, kind, config)

    return make


@pytest.fixture
def mission(mission_factory, tmp_path):
    """The simulated mission with its DataFlash log, in a folder of the test's own."""
    return mission_factory(tmp_path / "mission")


@pytest.fixture(scope="session")
def baseline(mission_factory, tmp_path_factory):
    """The mission as simulated, after a run. Not to be changed."""
    done = mission_factory(tmp_path_factory.mktemp("baseline") / "mission")
    with inputs_settled():
        done.run_to_manifest()
    return done


@contextlib.contextmanager
def without_plots():
    """A report without plots, which take half of the time of a small run."""
    from unbend.batch import runs

    def write_report(path, manifest, *_):
        path.write_text(manifest.run.mission, "utf-8")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "write_report", write_report)
        yield


@pytest.fixture
def plain_report():
    """The runs of a test have a report without plots."""
    with without_plots():
        yield


@pytest.fixture
def unbend():
    """`unbend` with some words, in this process."""
    return run_command


@pytest.fixture
def obeyed(unbend):
    """Runs a command that must end with an exit code, by default 0; what it prints."""

    def run(*words, exit_code=0):
        ended = unbend(*words)
        assert ended.code == exit_code, ended.text
        return ended.out

    return run


@pytest.fixture
def refusal_of(unbend):
    """Runs a command that must be refused with a code; what it says."""

    def run(code, exit_code, *words):
        return assert_refused(unbend(*words), code, exit_code)

    return run


def assert_refused(ended, code, exit_code):
    """A refusal has its form and says what to do; what the user reads."""
    assert ended.code == exit_code, ended.text
    assert "Traceback" not in ended.text
    assert "Warning" not in ended.text
    assert re.search(rf"^(.+: )?{code}: \S", ended.err, re.MULTILINE), ended.text
    assert "\n  to do: " in ended.err, ended.err
    return ended.err


@pytest.fixture
def eighty_columns(monkeypatch):
    """Texts as wide as in a terminal of 80 columns; otherwise what is captured is not wrapped."""
    monkeypatch.setenv("COLUMNS", "80")


SHARED = Path(__file__).resolve().parents[2] / "shared"
NEEDS = {
    "real_log": pytest.mark.shared("logs"),
    "berlin": pytest.mark.shared("ba"),
    "strasbourg": pytest.mark.shared("ba"),
    "browser": pytest.mark.browser,
}
NEEDS |= dict.fromkeys(("place", "s3_place", "seaweed", "moto", "azurite"), pytest.mark.emulator)
"""Fixtures, and the marker of each test that uses one."""


_SLOW = """
atmosphere/estimate/
atmosphere/test_estimate_montecarlo.py
atmosphere/test_model_montecarlo.py
block/test_assignment.py::test_constant_intervals_are_refused
block/test_assignment.py::test_drawn_flights_are_right_or_refused
block/test_diagnosis.py
faults/
flight/test_gimbal.py::test_a_mission
flight/test_injected_faults.py
golden/
refraction/test_chord.py::test_the_angle_at_that_height_gives_the_distance_back
refraction/test_compile_cache.py
refraction/test_forward.py
refraction/test_ray.py::test_a_wiggly_profile_against_an_independent_ode
refraction/test_ray.py::test_targets_above_against_thirty_digits
refraction/test_steep.py
refraction/test_terrain.py
refraction/test_window_sigma.py
"""
SLOW = tuple(_SLOW.split())
"""Folders, files and tests that take seconds of a processor, by the beginning of their names."""

_DRAWN = """
atmosphere/estimate/
atmosphere/test_estimate_montecarlo.py
atmosphere/test_model_montecarlo.py
batch/campaigns/
batch/object_store/test_missions.py
batch/object_store/test_silent_store.py
batch/test_dask_executor.py::test_a_scheduler_that_is_killed
batch/test_dask_executor.py::test_a_worker_that_is_stopped_costs_no_mission
batch/test_dask_executor.py::test_the_only_worker_that_is_stopped_is_named
batch/test_dask_executor.py::test_workers_that_are_killed_cost_no_mission
batch/test_processes.py
batch/test_rehearsal.py::test_check_says_what_run_says
batch/test_same_bytes.py
batch/test_soak.py
block/test_assignment.py
block/test_diagnosis.py
cli/test_interrupts.py
cli/test_terminal.py
config/test_mission_file.py
contract/test_documentation.py::test_what_a_page_shows
contract/test_imports.py::test_importing_warns_of_nothing
contract/test_planted.py::test_a_seed_draws_bugs_that_can_be_planted
contract/test_notebooks.py::test_a_notebook_prints_what_it_shows
faults/test_budget.py
faults/test_extreme_inputs.py
faults/test_mcap.py::test_bombs_are_skipped_at_once
flight/test_gimbal.py::test_a_mission
flight/test_injected_faults.py
golden/test_adjustment.py
golden/test_block_heights.py
golden/test_calibration_export.py
golden/test_costs.py
golden/test_gallery.py
golden/test_memory.py
golden/test_portability.py
golden/test_scale_parameter.py
golden/test_wheel.py
golden/test_when.py
ingest/dataflash/test_equal.py
ingest/dataflash/test_text.py::test_every_cell_is_that_of_the_library
ingest/test_evidence.py
ingest/test_memory.py
ingest/test_other_systems.py
ingest/tlog/test_equal.py
refraction/test_air_sigma.py
refraction/test_compile_cache.py
refraction/test_forward.py
refraction/test_order_of_effects.py
refraction/test_ray.py::test_a_wiggly_profile_against_an_independent_ode
refraction/test_ray.py::test_targets_above
refraction/test_steep.py
refraction/test_terrain.py::test_rays_land_where_an_integrated_ray_does
report/test_browser.py::test_nothing_is_wider_than_the_screen
simulate/test_mission.py
stages/test_air_of_mission.py::test_a_sounding_of_another_time_or_place
stages/test_angle_roads.py
stages/test_blocks.py::test_a_block_as_a_mission_without_a_log
stages/test_elevation_model.py
stages/test_image_events.py
stages/test_missions.py
stages/test_mistakes.py
stages/test_oriented_stations.py
stages/test_plausibility.py::test_a_mistake_is_found_with_its_key
stages/test_uncertainty.py
tables/exports/test_block_memory.py
tables/test_model_fields.py
tables/test_weather_files.py::test_pyproj_and_eccodes_live_together
"""
DRAWN = tuple(_DRAWN.split())
"""Tests that take half of the time of all and repeat a thought in other cases, by the beginning of
their names. With UNBEND_CASES=drawn, as in `make test`, one in `DRAWN_OF` runs each day."""

DRAWN_OF = 10
"""`make test` has ten minutes."""


def drawn_today(items):
    """One in `DRAWN_OF` of these tests, by the seed."""
    draw = random.Random(SEED)
    return set(draw.sample(items, math.ceil(len(items) / DRAWN_OF)))


def pytest_collection_modifyitems(config, items):
    """Mark tests by name and fixtures; skip those whose folder of ../shared is absent."""
    if os.environ.get("UNBEND_CASES") == "drawn":
        costly = [item for item in items if item.nodeid.removeprefix("tests/").startswith(DRAWN)]
        left_out = set(costly) - drawn_today(costly)
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=list(left_out))
    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(SLOW):
            item.add_marker(pytest.mark.slow)
        for name in NEEDS.keys() & {*getattr(item, "fixturenames", ())}:
            item.add_marker(NEEDS[name])
        folders = {folder for mark in item.iter_markers("shared") for folder in mark.args}
        for folder in sorted(folders):
            if not (SHARED / folder).is_dir():
                reason = f"../shared/{folder} is not beside this checkout"
                item.add_marker(pytest.mark.skip(reason=reason))


def pytest_report_header():
    return f"what tests draw: UNBEND_SEED={SEED}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """A failure names the seed of the day, without which it may not be there tomorrow."""
    report = yield
    if report.failed:
        report.sections.append(("what was drawn", f"UNBEND_SEED={SEED}"))
    return report


COUNTED = ("cells compared", "mutations", "assignments")


def pytest_terminal_summary(terminalreporter):
    """How much was compared and tried, which tests record as properties of theirs."""
    reports = [
        report
        for name in ("passed", "failed")
        for report in terminalreporter.stats.get(name, [])
        if report.when == "call"
    ]
    found = {
        name: [
            (report.nodeid, value)
            for report in reports
            for key, value in report.user_properties
            if key == name
        ]
        for name in COUNTED
    }
    if not any(found.values()):
        return
    terminalreporter.section("counted")
    cells = found["cells compared"]
    if cells:
        total = sum(count for _, count in cells)
        terminalreporter.write_line(f"{total:,} cells of {len(cells)} logs are the libraries'")
    for test, summary in found["mutations"] + found["assignments"]:
        terminalreporter.write_line(f"{test}: {summary}")
