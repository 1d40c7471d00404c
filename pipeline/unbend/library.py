"""The correction as a library: tables in memory in, the table of a run out.

It is a run without a file: a mission of the tables is prepared, checked and corrected by the
story's steps.
"""

import json
import warnings
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import yaml

import unbend.refraction as refraction
from unbend.atmosphere import Profile, standard_atmosphere
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile, constant_series
from unbend.batch.finished_run import air_of, stations_of
from unbend.batch.opening import open_inputs, paths_beside_tables, stated_orientation
from unbend.config import Mission
from unbend.config.reading import mission_of
from unbend.errors import ConfigError
from unbend.flight.stations import Stations
from unbend.messages import Kind, Ledger
from unbend.refraction.camera import DISTORTION_MODELS
from unbend.refraction.effect import FlightAir
from unbend.refraction.kernels.columns import BLOCK, TILE, TerrainGrid
from unbend.refraction.kernels.jit import Kernel
from unbend.refraction.kernels.moments import WORTH_A_TABLE
from unbend.refraction.kernels.terrain import extremes_of_tile
from unbend.refraction.target_heights import terrain_heights
from unbend.refraction.window import refract_at_window
from unbend.stages.correction import correct_parts
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.outputs import observation_metadata
from unbend.stages.statistics import Statistics
from unbend.stages.story import correct_mission, prepare_mission
from unbend.tables.imports.user_tables import orientation_of_frame
from unbend.tables.observations import observations_of_table
from unbend.tables.text_columns import fnv_1a
from unbend.units import Array, Integers

Table = TypeVar("Table", pd.DataFrame, pa.Table)
Air: TypeAlias = Profile | TimedProfile | ProfileSeries | pa.Table | str | Mapping[str, Any]

_NO_FILE = yaml.MappingNode("tag:yaml.org,2002:map", [], yaml.Mark("", 0, 0, 0, None, 0))
_DEGREES = ("latitude", "longitude", "omega", "phi", "kappa", "roll", "pitch", "yaw")
_NAMES = {"lat_deg": "latitude", "lon_deg": "longitude", "sigma_tilt_deg": "sigma_tilt",
          "sigma_yaw_deg": "sigma_yaw"} | {f"{name}_deg": name for name in _DEGREES}  # fmt: skip
_HEIGHTS = {"h_msl_m": "msl", "h_ellipsoid_m": "ellipsoid"}
_ANGLES = {"omega": "omega_phi_kappa", "roll": "roll_pitch_yaw", "q_w": "quaternion"}
_FURTHER = ("camera", "time_utc", "sigma_horizontal_m", "sigma_height_m", "sigma_tilt", "sigma_yaw")


def correct(
    observations: Table,
    stations: pd.DataFrame | pa.Table,
    profile: Air,
    cameras: Mapping[str, Mapping[str, Any]],
    *,
    orientation: Mapping[str, Any] | None = None,
    **sections: Any,
) -> Table:
    """Remove the refraction of the air and of windows from observations in tables in memory.

    Parameters
    ----------
    observations : image, point, x_px, y_px [px], h_g_m [m above sea level]; others pass through.
    stations : image, camera (where there are several), position and attitude of each image:
        latitude, longitude [deg] (or lat_deg, lon_deg) and a height, named h_msl_m or
        h_ellipsoid_m [m]; omega, phi, kappa, or roll, pitch, yaw, or q_w to q_z, the angles in
        degrees (omega_deg too) against east, north and up at the station. Or the whole
        ``stations.parquet`` of a run, of which then everything is taken as it is.
    profile : a `Profile`; with a covariance a `TimedProfile`; the `ProfileSeries` or the
        ``profile.parquet`` of a run with its stations; the name of a standard atmosphere; or the
        section ``atmosphere`` of a mission file, from which the air is estimated.
    cameras : the section of that name of a mission file.
    orientation : further keys of ``stations.orientation``, where names do not say everything:
        frame, heights, unit, columns, date, sigmas.
    sections : other sections of a mission file, as ``ground={"height": 120.0}``.

    Returns a table of the kind of ``observations`` with the columns of a run, the same to the last
    bit. ``uncertainty``, ``cabin_air`` and ``ledger`` of the manifest are in ``attrs`` of a
    DataFrame, and as JSON in the metadata of an Arrow table.

    Refuses what a run refuses, with its codes (`UnbendError`); what ends a run with code 3 is a
    UserWarning each. Raises TypeError for what is no table and ValueError for a series of profiles
    that belongs to other stations.
    """
    taken = sorted({"log", "stations", "events", "atmosphere", "output"} & sections.keys())
    if taken:
        raise TypeError(f"{', '.join(taken)}: tables in memory take the place of these sections")
    measured = _arrow(observations, "observations")
    placed: pa.Table = _arrow(stations, "stations")
    own = stations_of(placed) if {"profile_id", "status", "q_w"} <= {*placed.column_names} else None
    # The section does not count where the profile itself is given.
    atmosphere: Mapping[str, Any] = {"adjust": False, "standard": profile}
    if not isinstance(profile, str):
        atmosphere = profile if isinstance(profile, Mapping) else {"adjust": False}
    given = {"cameras": cameras, "atmosphere": atmosphere, **sections}
    frame = placed.to_pandas().rename(columns=_NAMES)
    mission = mission_of_tables(frame, orientation or {}, given)
    if own is not None:
        from_run = mission.stations.model_copy(update={"orientation": None})
        mission = mission.model_copy(update={"log": None, "stations": from_run})
    ledger = Ledger()
    mission, inputs = inputs_of_tables(mission, measured, frame, ledger)
    prepared = prepare_mission(mission, inputs, ledger, stations=own)
    if not isinstance(profile, str | Mapping):
        prepared = replace(prepared, air=air_of_stations(profile, placed, prepared.stations))
    parts: list[pa.Table] = []

    def correct_all(setup: CorrectionSetup) -> Statistics:
        total = Statistics.of(setup.cameras)
        for part in correct_parts(
            prepared.observations,
            setup,
            finish=lambda part: part,
            batch_rows=mission.output.batch_rows,
            metadata=observation_metadata(mission),
        ):
            total.merge(part.statistics)
            parts.append(part.table)
        return total

    manifest = correct_mission(prepared, correct_all).manifest
    facts = {name: manifest[name] for name in ("uncertainty", "cabin_air", "ledger")}
    for entry in facts["ledger"]:
        if entry["kind"] in (Kind.LOSS, Kind.FINDING):
            warnings.warn(f"{entry['code']}: {entry['what']}", UserWarning, stacklevel=2)
    table = pa.concat_tables(parts)
    if isinstance(observations, pd.DataFrame):
        corrected: pd.DataFrame = table.to_pandas()
        corrected.attrs |= facts
        return corrected
    texts = {f"unbend.{name}": json.dumps(value) for name, value in facts.items()}
    return table.replace_schema_metadata(table.schema.metadata | texts)


def _arrow(table: pd.DataFrame | pa.Table, name: str) -> pa.Table:
    if isinstance(table, pd.DataFrame):
        return pa.Table.from_pandas(table, preserve_index=False)
    if not isinstance(table, pa.Table):
        kind = type(table).__name__
        raise TypeError(f"{name} is a pandas DataFrame or a pyarrow Table, no {kind}")
    return table


def mission_of_tables(
    frame: pd.DataFrame, orientation: Mapping[str, Any], sections: Mapping[str, Any]
) -> Mission:
    """The mission of tables in memory; the ``frame`` of stations has the names of quantities."""
    known = [name for name in frame if frame[name].notna().any()]
    columns = {name: name for name in _FURTHER if name in known}
    if "date" in orientation:
        columns.pop("time_utc", None)
    stated: dict[str, Any] = {"frame": "geographic"}
    stated.update(("angles", angles) for name, angles in _ANGLES.items() if name in known)
    for name, heights in _HEIGHTS.items():
        if name in known and "latitude" in known and "height" not in columns:
            columns["height"] = name
            stated["heights"] = heights
    stated |= orientation
    stated["columns"] = columns | dict(orientation.get("columns", {}))
    stated["path"] = "stations"
    given = {
        "ground": {"height": {"column": "h_g_m"}, "reference": "msl"},
        **sections,
        "mission": {"name": "tables", **sections.get("mission", {})},
        "observations": {**sections.get("observations", {}), "path": "observations"},
        "stations": {"orientation": stated},
        "output": {"path": "results"},
    }
    if "profile_id" in known:  # the cabin's air of a run's stations may be that of a log
        given["log"] = {"path": "-"}
    # Plain values: tuples become lists, and numpy's numbers Python's, with all their digits.
    text = json.dumps(given, default=lambda v: v.item() if hasattr(v, "item") else str(v))
    try:
        return mission_of(json.loads(text), _NO_FILE, "sections")
    except ConfigError as error:  # no line of a file that nobody wrote
        what = error.what.replace("line 1: ", "")
        raise ConfigError(error.code, what, where=error.where, remedy=error.remedy) from None


def inputs_of_tables(
    mission: Mission, measured: pa.Table, frame: pd.DataFrame, ledger: Ledger
) -> tuple[Mission, OpenedInputs]:
    """The tables as inputs, with files that the mission names beside them; and what these say."""
    mission, paths = paths_beside_tables(mission, Path.cwd())
    section = mission.observations
    ground = mission.ground
    observations = observations_of_table(
        measured,
        section.path,
        section.columns.model_dump(),
        ground.column,
        ledger,
        ground_is_msl=ground.reference == "msl",
        sigma_column=ground.sigma_column,
        direction=mission.refraction.direction,
        pixels=section.pixels,
    )
    inputs = open_inputs(mission, paths, observations, None, ledger)
    of_stations = mission.stations.orientation
    if of_stations is None:
        return mission, inputs
    table = orientation_of_frame(frame, of_stations.path, stated_orientation(of_stations), ledger)
    return mission, replace(inputs, orientation=table)


def air_of_stations(profile: Air, placed: pa.Table, stations: Stations) -> FlightAir:
    """The air that is given, for all stations; those that have none get the first profile."""
    series: ProfileSeries | None = None
    if isinstance(profile, Profile):
        profile = TimedProfile(None, profile)
    if isinstance(profile, TimedProfile):
        series = constant_series(profile, len(stations))
    elif isinstance(profile, pa.Table) and b"g_phi" in (profile.schema.metadata or {}):
        ids = placed["profile_id"] if "profile_id" in placed.column_names else pa.nulls(0)
        several = pc.count_distinct(profile["profile_id"]).as_py() > 1
        if several and not len(ids):
            raise ValueError("several profiles need the stations of their run, with profile_id")
        series = air_of(profile, ids.cast(pa.string()))
    elif isinstance(profile, ProfileSeries):
        series = profile
        if (size := series.profile_number.size) != (given := placed.num_rows):
            what = f"the profiles are those of {size} stations, not of the {given} that are given"
            raise ValueError(what)
    if series is None:
        raise TypeError(
            f"a profile is none of {type(profile).__name__}: a Profile, TimedProfile, "
            "ProfileSeries, the Arrow table of profile.parquet, a name, or a section"
        )
    number = np.zeros(len(stations), np.int64)
    number[: series.profile_number.size] = series.profile_number
    first = series.timed_profiles[0]
    adjustment = replace(unadjusted(first.profile, "it is given"), covariance=first.covariance)
    return FlightAir(adjustment, ProfileSeries(series.timed_profiles, number))


class _FlatGround:
    """A terrain of one tile at height zero, all in memory."""

    lock = nullcontext()

    def __init__(self) -> None:
        node, block = np.zeros((1, 1), np.float32), np.zeros((1, TILE // BLOCK, TILE // BLOCK))
        tiles, blocks = np.zeros((1, TILE + 1, TILE + 1), np.float32), block.astype(np.float32)
        slot = np.zeros((1, 1), np.int32)
        self.grid = TerrainGrid(node, node + 0.0, slot, tiles, blocks, blocks + 0.0, 0)
        extremes_of_tile(tiles[0], blocks[0], self.grid.block_high[0])

    def nodes(self, lat_rad: Array, lon_rad: Array) -> tuple[Array, Array]:
        """Cells of 100 m."""
        return TILE / 2 - lat_rad * 63_700.0, TILE / 2 + lon_rad * 63_700.0

    def load(self, tiles: Integers) -> None:
        """All is there."""


def compile_kernels() -> None:
    """Compile all that runs may need into the cache: half a minute of one CPU, 3 MB."""
    n = WORTH_A_TABLE + 1
    air, row, one = standard_atmosphere("us1976"), np.zeros(n, np.int64), np.ones(1)
    outside, table = np.full(1, 2e-4), refraction.ray_table(air)
    down = refraction.Exposures(
        one > 0.0, np.diag([1.0, -1.0, -1.0])[None], 0.0 * one, 3000.0 * one, outside,
        outside + 7e-5,
    )  # fmt: skip
    sigmas = refraction.StationSigmas(1e-3 * one, 1e-3 * one, np.array([[0.0, 0.0, 1.0]]), one)
    x, h_g = np.linspace(400.0, 600.0, n), np.linspace(0.0, 100.0, n)
    Kernel.always_compiled = True
    try:
        for model in DISTORTION_MODELS.values():
            lens = model.Parameters()
            camera = refraction.Camera(1000, 1000, 1000.0, 1000.0, 500.0, 500.0, lens)
            uncertainty = refraction.uncertainty_of(
                air, None, down, sigmas, [(camera, one > 0.0)], ground_heights_m=(0.0, 100.0)
            )
            refraction.correct_observations(
                x, x, h_g, row, down, camera=camera, table=table, uncertainty=uncertainty,
                sigma_h_g=0.0 * h_g,
            )  # fmt: skip
            camera.rays(x, x)
        refraction.bend(table, 3000.0, 0.0, np.sin([0.1, 1.55, 1.7]), np.cos([0.1, 1.55, 1.7]))
        refraction.height_at_distance(table, 3000.0, 0.6, 0.8, 3000.0)
        refract_at_window(np.array([[0.0, 0.0, 1.0]]), 2e-4, 3e-4)
        terrain_heights(
            x, x, row, down, (0.0 * one, 0.0 * one), camera=camera, table=table,
            terrain=_FlatGround(),
        )  # fmt: skip
        of_file = np.frombuffer(b"\0", np.uint8), np.frombuffer(bytes(8), np.int32)
        fnv_1a(*of_file, np.zeros(1, np.uint64))
    finally:
        Kernel.always_compiled = False
