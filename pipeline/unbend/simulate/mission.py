"""Simulates a mission, and writes its logs, observations, truth and mission files."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.resources import files
from itertools import count
from pathlib import Path

import numpy as np
from jinja2 import Template

from unbend.errors import storage_errors
from unbend.simulate import messages, sensors
from unbend.simulate.block import (
    CONVENTIONS,
    GroundPoints,
    TrueObservations,
    TrueStations,
    choose_points,
    observe,
    stations,
    write_tables,
)
from unbend.simulate.flight import FIELD_LAT_RAD, UNDULATION_M, Flight, fly
from unbend.simulate.optics import SimulatedCamera, cameras
from unbend.simulate.true_air import FIELD_HEIGHT_M, WAVELENGTH_UM, TrueAir, true_air
from unbend.simulate.write_dataflash import write_dataflash
from unbend.simulate.write_mcap import write_mcap
from unbend.simulate.write_tlog import write_tlog

Progress = Callable[[str, int, int], None]

KINDS = ("bin", "tlog", "mcap")
# By option of `SimulationOptions`: the lowest and the highest value.
_LIMITS = {
    "height_above_ground_m": (300.0, 10_000.0),
    "lines": (1, 20),
    "exposures_per_line": (1, 100),
    "points_per_image": (1, 2000),
    "image_noise_px": (0.0, 10.0),
    "focal_px": (5_000.0, 60_000.0),
    "seed": (0, 2**32 - 1),
}


@dataclass(frozen=True)
class SimulationOptions:
    """The survey to fly. The same options give the same files; ``seed`` is that of all noise."""

    seed: int = 7
    height_above_ground_m: float = 3000.0
    lines: int = 4
    exposures_per_line: int = 7
    points_per_image: int = 40
    image_noise_px: float = 0.0
    focal_px: float = 20_000.0

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise messages.sim_option(where=name, name=name, value=value, low=low, high=high)


@dataclass(frozen=True)
class Simulated:
    """The files written, and what is in them; ``logs``, ``missions`` and ``messages`` by kind."""

    folder: Path
    logs: dict[str, Path]
    missions: dict[str, Path]
    observations: Path
    truth: Path
    images: int
    points: int
    observation_count: int
    messages: dict[str, int]
    duration_s: float


def simulate(
    out: Path, options: SimulationOptions | None = None, progress: Progress | None = None
) -> Simulated:
    """Fly a survey with known truth and write its logs, observations, truth and mission files.

    ``out``: folder, made if absent. ``progress``: called with the name of a stage, the number of
    stages done and of all stages. Rays by the eikonal equation, 1e-10 rad. The same seed gives the
    same bytes. Takes a few seconds.
    """
    chosen = options or SimulationOptions()
    steps = 4 + len(KINDS)
    done = count()

    def begin(stage: str) -> None:
        if progress is not None:
            progress(stage, next(done), steps)

    survey = _fly_survey(chosen, begin)
    begin("tables")
    logs = {kind: out / f"flight.{kind}" for kind in KINDS}
    missions = {kind: out / f"mission_{kind}.yaml" for kind in KINDS}
    truth = out / "truth"
    with storage_errors(out):
        write_tables(
            out,
            survey.air,
            survey.block,
            survey.points,
            survey.seen,
            cameras=survey.cameras,
            noise_px=chosen.image_noise_px,
            rng=np.random.default_rng([chosen.seed, 1]),
        )
        messages_of_log = _write_logs(logs, survey, chosen.seed, begin)
        begin("mission files")
        for kind, path in missions.items():
            path.write_bytes(mission_yaml(kind, survey.cameras).encode())
        text = truth_json(chosen, survey.cameras, survey.flight.duration_s)
        (truth / "truth.json").write_bytes(text.encode())
    begin("done")
    return Simulated(
        folder=out,
        logs=logs,
        missions=missions,
        observations=out / "observations.parquet",
        truth=truth,
        images=len(survey.block.image),
        points=len(survey.points.name),
        observation_count=len(survey.seen.station),
        messages=messages_of_log,
        duration_s=survey.flight.duration_s,
    )


@dataclass(frozen=True, eq=False)
class _Survey:
    """The true survey: air, cameras, flight, stations, ground points and observations."""

    air: TrueAir
    cameras: tuple[SimulatedCamera, ...]
    flight: Flight
    block: TrueStations
    points: GroundPoints
    seen: TrueObservations


def _fly_survey(options: SimulationOptions, begin: Callable[[str], None]) -> _Survey:
    """Simulate air, flight, stations and observations; ``begin`` is called with each stage."""
    begin("air and flight")
    air = true_air(FIELD_LAT_RAD)
    both_cameras = cameras(options.focal_px)
    flight = fly(options.height_above_ground_m, options.lines, options.exposures_per_line)
    begin("rays")
    block = stations(flight, air, both_cameras)
    rng = np.random.default_rng([options.seed, 0])
    points, station, point = choose_points(
        flight, block, both_cameras, options.points_per_image, rng
    )
    seen = observe(air, block, points, both_cameras, station=station, point=point)
    return _Survey(
        air=air,
        cameras=both_cameras,
        flight=flight,
        block=block,
        points=points,
        seen=seen,
    )


def _write_logs(
    logs: dict[str, Path], survey: _Survey, seed: int, begin: Callable[[str], None]
) -> dict[str, int]:
    """Write the same samples to each of the ``logs``; returns the number of messages by kind."""
    camera_names = tuple(camera.name for camera in survey.cameras)
    samples = sensors.sample(survey.flight, survey.air, seed, camera_names)
    messages_of_log = {}
    for kind, path in logs.items():
        begin(path.name)
        messages_of_log[kind] = _WRITERS[kind](path, samples, seed)
    return messages_of_log


_WRITERS: dict[str, Callable[[Path, sensors.LoggedSamples, int], int]] = {
    "bin": lambda path, samples, _: write_dataflash(path, samples),
    "tlog": write_tlog,
    "mcap": write_mcap,
}


# Names of constants in `sensors`, in lower case, that truth.json lists.
_SENSORS = (
    "gnss_horizontal_m",
    "gnss_vertical_m",
    "tilt_deg",
    "heading_deg",
    "barometer_pa",
    "thermometer_k",
    "thermometer_bias_k",
    "humidity",
    "board_heat_k",
)


def truth_json(
    options: SimulationOptions, simulated_cameras: tuple[SimulatedCamera, ...], duration_s: float
) -> str:
    """The text of truth.json: options, conventions, cameras and sigmas of the sensors."""
    content = {
        "options": asdict(options),
        "conventions": CONVENTIONS,
        "cameras": [asdict(camera) for camera in simulated_cameras],
        "field_h_msl_m": FIELD_HEIGHT_M,
        "undulation_m": UNDULATION_M,
        "wavelength_um": WAVELENGTH_UM,
        "index": "modified Edlen (Birch and Downs 1994; NIST water term)",
        "duration_s": duration_s,
        "sensors": {name: getattr(sensors, name.upper()) for name in _SENSORS},
    }
    return json.dumps(content, indent=2) + "\n"


def mission_yaml(
    kind: str,
    simulated_cameras: tuple[SimulatedCamera, ...],
    *,
    inputs: str = "",
    results: str = "results",
) -> str:
    """The text of the mission file for the log of a ``kind``: bin, tlog or mcap.

    ``inputs`` and ``results``: the folders of the input files and of the results, relative to the
    mission file.
    """
    text = files("unbend.simulate").joinpath("data/mission.yaml.j2").read_text("utf-8")
    template = Template(text, keep_trailing_newline=True)
    rendered: str = template.render(
        kind=kind,
        cameras=simulated_cameras,
        undulation_m=UNDULATION_M,
        inputs=inputs,
        results=results,
    )
    return rendered
