"""A simulated mission, from the first draw to the last file."""

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
from unbend.simulate.block import CONVENTIONS, choose_points, observe, stations, write_tables
from unbend.simulate.flight import FIELD_LAT_RAD, UNDULATION_M, fly
from unbend.simulate.optics import SimulatedCamera, cameras
from unbend.simulate.true_air import FIELD_HEIGHT_M, WAVELENGTH_UM, true_air
from unbend.simulate.write_dataflash import write_dataflash
from unbend.simulate.write_mcap import write_mcap
from unbend.simulate.write_tlog import write_tlog

Progress = Callable[[str, int, int], None]

KINDS = ("bin", "tlog", "mcap")
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
    """What to fly: height [m] above the field, lines, exposures, points; one seed for all noise."""

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
    """The files written, and how much is in them."""

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

    out: folder, made where absent; options: see `SimulationOptions`; progress: called with
    (stage, done, total). Rays by the eikonal equation, 1e-10 rad; the same seed gives the same
    bytes. Takes a few seconds.
    """
    chosen = options or SimulationOptions()
    steps, done = 4 + len(KINDS), count()

    def begin(stage: str) -> None:
        if progress is not None:
            progress(stage, next(done), steps)

    begin("air and flight")
    air = true_air(FIELD_LAT_RAD)
    pair = cameras(chosen.focal_px)
    flight = fly(chosen.height_above_ground_m, chosen.lines, chosen.exposures_per_line)
    of_points, of_image = (np.random.default_rng([chosen.seed, branch]) for branch in (0, 1))

    begin("rays")
    block = stations(flight, air, pair)
    points, station, point = choose_points(flight, block, pair, chosen.points_per_image, of_points)
    seen = observe(air, block, points, pair, station=station, point=point)

    begin("tables")
    truth = out / "truth"
    logs = {kind: out / f"flight.{kind}" for kind in KINDS}
    missions = {kind: out / f"mission_{kind}.yaml" for kind in KINDS}
    messages: dict[str, int] = {}
    with storage_errors(out):
        write_tables(
            out, air, block, points, seen,
            cameras=pair, noise_px=chosen.image_noise_px, rng=of_image,
        )  # fmt: skip
        samples = sensors.sample(flight, air, chosen.seed, tuple(c.name for c in pair))
        for kind, path in logs.items():
            begin(path.name)
            messages[kind] = _WRITERS[kind](path, samples, chosen.seed)
        begin("mission files")
        for kind, path in missions.items():
            path.write_bytes(mission_yaml(kind, pair).encode())
        text = truth_json(chosen, pair, flight.duration_s)
        (truth / "truth.json").write_bytes(text.encode())
    begin("done")
    files = out, logs, missions, out / "observations.parquet", truth
    counts = len(block.image), len(points.name), len(seen.station), messages
    return Simulated(*files, *counts, flight.duration_s)


_WRITERS: dict[str, Callable[[Path, sensors.LoggedSamples, int], int]] = {
    "bin": lambda path, samples, _: write_dataflash(path, samples),
    "tlog": write_tlog,
    "mcap": write_mcap,
}


_SENSORS = (
    "gnss_horizontal_m", "gnss_vertical_m", "tilt_deg", "heading_deg", "barometer_pa",
    "thermometer_k", "thermometer_bias_k", "humidity", "board_heat_k",
)  # fmt: skip


def truth_json(
    options: SimulationOptions, pair: tuple[SimulatedCamera, ...], duration_s: float
) -> str:
    """Options, conventions, cameras and sigmas of the sensors: truth.json."""
    content = {
        "options": asdict(options),
        "conventions": CONVENTIONS,
        "cameras": [asdict(camera) for camera in pair],
        "field_h_msl_m": FIELD_HEIGHT_M,
        "undulation_m": UNDULATION_M,
        "wavelength_um": WAVELENGTH_UM,
        "index": "modified Edlen (Birch and Downs 1994; NIST water term)",
        "duration_s": duration_s,
        "sensors": {name: getattr(sensors, name.upper()) for name in _SENSORS},
    }
    return json.dumps(content, indent=2) + "\n"


def mission_yaml(
    kind: str, pair: tuple[SimulatedCamera, ...], *, inputs: str = "", results: str = "results"
) -> str:
    """The mission file for one of the logs: bin, tlog or mcap.

    ``inputs`` and ``results`` are the folders of both, relative to the mission file.
    """
    template = files("unbend.simulate").joinpath("data/mission.yaml.j2").read_text("utf-8")
    rendered: str = Template(template, keep_trailing_newline=True).render(
        kind=kind, cameras=pair, undulation_m=UNDULATION_M, inputs=inputs, results=results
    )
    return rendered
