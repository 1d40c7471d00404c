"""A forgotten window of a pressurised aircraft whose log has a barometer in the cabin."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers import with_code
from tests.stages.other_logs import read_folder
from unbend.batch.rehearsal import camera_text
from unbend.library import corrected_table
from unbend.messages import Kind, Ledger
from unbend.stages.plausibility.cabin_windows import windows_of_compartments
from unbend.stages.story import prepare_mission

CODE = "PLAUSIBLE-WINDOW"


@pytest.fixture
def forgotten(mission):
    """The mission without its windows and the channels of the cabin."""
    return without_cabin(mission)


def without_cabin(mission):
    channels = mission.config["log"]["channels"]
    for role in ("cabin_pressure", "cabin_temperature", "cabin_humidity"):
        channels.pop(role, None)
    for camera in mission.config["cameras"].values():
        del camera["window"]
    return mission


def of_window(ledger):
    """The findings about windows, as text and key."""
    return [entry for entry in with_code(ledger, CODE) if entry.kind is Kind.FINDING]


def checked(mission):
    return of_window(mission.checked().corrected.prepared.ledger)


@pytest.mark.parametrize(
    ("kind", "barometer"),
    [("bin", "BARO[1]"), ("tlog", "SCALED_PRESSURE2"), ("mcap", "/cabin/pressure")],
)
def test_a_forgotten_window_is_found(mission_factory, tmp_path, kind, barometer):
    mission = without_cabin(mission_factory(tmp_path / "mission", kind))
    (finding,) = checked(mission)
    assert finding.what.startswith(f"{barometer} is in a closed compartment")
    assert f"log.channels.cabin_pressure: {barometer}, or window: null" in finding.what
    assert finding.where == "cameras.nadir.window, cameras.oblique.window"


def test_the_shift_is_that_of_the_window(forgotten, baseline):
    """Halfway to the corner, of the nadir camera: the difference of the indices times f tan."""
    (finding,) = checked(forgotten)
    shift_px = float(re.search(r"about ([0-9.]+) px", finding.what)[1])
    stations = baseline.station_rows()
    by_pressure = 77.6e-6 / 100.0  # n - 1 by p/T [K/Pa], of visible light within 2 %
    inside = stations["cabin_pressure_pa"] / stations["cabin_temperature_k"]
    outside = stations["pressure_pa"] / stations["temperature_k"]
    difference = by_pressure * float((inside - outside).median())
    assert shift_px == pytest.approx(difference * np.hypot(14000, 10600) / 4.0, rel=0.1)


@pytest.mark.parametrize("name", ["nadir", "oblique"])
def test_a_stated_null_holds_for_its_camera(forgotten, name):
    forgotten.config["cameras"][name]["window"] = None
    (finding,) = checked(forgotten)
    other = {"nadir": "oblique", "oblique": "nadir"}[name]
    assert finding.where == f"cameras.{other}.window"


@pytest.mark.parametrize(
    "stated",
    [
        {"window": None},
        {"window": {"cabin": "standard_schedule"}},
        {"opening": {"warmer_k": 0.0}},
    ],
)
def test_cameras_of_which_all_is_stated(forgotten, stated):
    for camera in forgotten.config["cameras"].values():
        camera.update(stated)
    assert checked(forgotten) == []


def test_a_window_of_one_camera_is_no_statement_for_the_other(forgotten):
    forgotten.config["cameras"]["nadir"]["window"] = {"cabin": "standard_schedule"}
    (finding,) = checked(forgotten)
    assert finding.where == "cameras.oblique.window"


def test_the_shift_is_that_of_the_flying_height_with_an_exposure_on_the_ground(forgotten):
    facts = forgotten.checked().corrected.facts
    (without_it,) = windows_of_compartments(facts)
    height_m = facts.exposures.height_m.copy()
    height_m[0] = 450.0  # the take-off
    exposures = replace(
        facts.exposures,
        height_m=height_m,
    )
    with_it = replace(facts, exposures=exposures)

    (finding,) = windows_of_compartments(with_it)

    assert finding.what == without_it.what


def test_a_stated_null_of_all_cameras_is_no_finding_but_a_note(forgotten):
    for camera in forgotten.config["cameras"].values():
        camera["window"] = None

    shown = forgotten.checked()

    (note,) = with_code(shown.corrected.prepared.ledger, "WINDOW-NONE-STATED")
    assert note.kind is Kind.NOTE
    assert "BARO[1] is in a closed compartment" in note.what
    assert note.where == "cameras.nadir.window, cameras.oblique.window"
    for name in ("nadir", "oblique"):
        assert camera_text(shown.corrected.facts, name).endswith(", no window (stated)")


def test_a_barometer_that_is_named_as_the_one_outside(forgotten):
    """Another check says that its pressures are not those outside."""
    forgotten.config["log"]["channels"]["pressure"] = "BARO[1]"
    assert checked(forgotten) == []


def test_a_log_without_the_barometer_of_the_cabin(forgotten):
    read = read_folder(forgotten)
    log = read.inputs.log
    channels = [channel for channel in log.channels if channel.name != "BARO[1]"]
    inputs = replace(read.inputs, log=replace(log, channels=tuple(channels)))
    prepared = prepare_mission(read.mission, inputs, Ledger())
    corrected_table(prepared)
    assert of_window(prepared.ledger) == []


@pytest.mark.parametrize(("part", "findings"), [(1.0, 1), (0.1, 0)])
def test_a_window_that_shifts_too_little_to_be_measured(forgotten, part, findings):
    """0.12 px in images of 150 megapixels, a tenth of it in those of 1.5."""
    facts = forgotten.checked().corrected.facts
    cameras = {}
    for name, camera in facts.cameras.items():
        cameras[name] = replace(
            camera,
            width_px=round(part * camera.width_px),
            height_px=round(part * camera.height_px),
        )
    assert len(list(windows_of_compartments(replace(facts, cameras=cameras)))) == findings
