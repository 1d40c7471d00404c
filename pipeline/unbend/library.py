"""The correction as a library: tables in memory in, the table of a run out.

It is a run without a file: a mission of the tables is prepared, checked and corrected by the
story's steps.
"""

import json
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from unbend.atmosphere import Profile
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile, constant_series
from unbend.batch.finished_run.read_back import air_of, stations_of
from unbend.batch.opening import open_inputs, open_table, paths_beside_tables, stated_orientation
from unbend.config import Mission
from unbend.config.reading import mission_of
from unbend.flight.stations import Stations
from unbend.messages import LOSSES, Ledger
from unbend.refraction.effect import FlightAir
from unbend.stages.correction import correct_parts
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.results import observation_metadata
from unbend.stages.statistics import Statistics
from unbend.stages.story import PreparedMission, correct_mission, prepare_mission
from unbend.tables.imports.user_tables import orientation_of_frame
from unbend.tables.manifest import ResultsRecord

Table = TypeVar("Table", pd.DataFrame, pa.Table)
Air: TypeAlias = Profile | TimedProfile | ProfileSeries | pa.Table | str | Mapping[str, Any]

_DEGREES = ("latitude", "longitude", "omega", "phi", "kappa", "roll", "pitch", "yaw")
_NAMES = {"lat_deg": "latitude", "lon_deg": "longitude", "sigma_tilt_deg": "sigma_tilt",
          "sigma_yaw_deg": "sigma_yaw"} | {f"{name}_deg": name for name in _DEGREES}  # fmt: skip
_HEIGHTS = {"h_msl_m": "msl", "h_ellipsoid_m": "ellipsoid"}
_ANGLES = {"omega": "omega_phi_kappa", "roll": "roll_pitch_yaw", "q_w": "quaternion"}
_OF_A_RUN = {"profile_id", "status", "q_w"}  # columns that only the stations of a run have
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
    own = None
    if {*placed.column_names} >= _OF_A_RUN:
        own = stations_of(placed)
    frame = placed.to_pandas().rename(columns=_NAMES)
    given = {"cameras": cameras, "atmosphere": _atmosphere(profile), **sections}
    mission = mission_of_tables(frame, orientation or {}, given)
    if own is not None:
        from_run = mission.stations.model_copy(update={"orientation": None})
        mission = mission.model_copy(update={"log": None, "stations": from_run})
    ledger = Ledger()
    mission, inputs = inputs_of_tables(mission, measured, frame, ledger)
    prepared = prepare_mission(mission, inputs, ledger, stations=own)
    if not isinstance(profile, str | Mapping):
        prepared = replace(prepared, air=air_of_stations(profile, placed, prepared.stations))
    table, results = corrected_table(prepared)
    for entry in results.ledger:
        if entry["kind"] in LOSSES:
            warnings.warn(f"{entry['code']}: {entry['what']}", UserWarning, stacklevel=2)
    manifest = results.row()
    facts = {name: manifest[name] for name in ("uncertainty", "cabin_air", "ledger")}
    if isinstance(observations, pd.DataFrame):
        corrected: pd.DataFrame = table.to_pandas()
        corrected.attrs |= facts
        return corrected
    texts = {f"unbend.{name}": json.dumps(value) for name, value in facts.items()}
    return table.replace_schema_metadata(table.schema.metadata | texts)


def corrected_table(prepared: PreparedMission) -> tuple[pa.Table, ResultsRecord]:
    """The corrected observations of a mission, all in memory, and what is to be said of them."""
    parts: list[pa.Table] = []

    def correct_all(setup: CorrectionSetup) -> Statistics:
        total = Statistics.of(setup.cameras)
        made = correct_parts(
            prepared.observations,
            setup,
            finish=lambda part: part,
            batch_rows=prepared.mission.output.batch_rows,
            metadata=observation_metadata(prepared.mission),
        )
        for part in made:
            total.merge(part.statistics)
            parts.append(part.table)
        return total

    results = correct_mission(prepared, correct_all).results
    return pa.concat_tables(parts), results


def _atmosphere(profile: Air) -> Mapping[str, Any]:
    """The section of the atmosphere; it does not count where the profile itself is given."""
    if isinstance(profile, str):
        return {"adjust": False, "standard": profile}
    if isinstance(profile, Mapping):
        return profile
    return {"adjust": False}


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
    return mission_of(json.loads(text), None, "sections")


def inputs_of_tables(
    mission: Mission, measured: pa.Table, frame: pd.DataFrame, ledger: Ledger
) -> tuple[Mission, OpenedInputs]:
    """The tables as inputs, with files that the mission names beside them; and what these say."""
    mission, paths = paths_beside_tables(mission, Path.cwd())
    observations = open_table(mission, Path(mission.observations.path), ledger, table=measured)
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
        ids = pa.nulls(0)
        if "profile_id" in placed.column_names:
            ids = placed["profile_id"]
        profile_count = pc.count_distinct(profile["profile_id"]).as_py()
        if profile_count > 1 and not len(ids):
            raise ValueError("several profiles need the stations of their run, with profile_id")
        series = air_of(profile, ids.cast(pa.string()))
    elif isinstance(profile, ProfileSeries):
        series = profile
        size = series.profile_number.size
        given = placed.num_rows
        if size != given:
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
    adjustment = unadjusted(first.profile, "it is given")
    adjustment = replace(adjustment, covariance=first.covariance)
    return FlightAir(adjustment, ProfileSeries(series.timed_profiles, number))


def correct_one_image() -> None:
    """Correct one image of few points, which compiles what missions call.

    A camera with a Brown-Conrady lens over ground at one height; other models of lenses, and
    elevation models, are compiled by the first mission that has one.
    """
    rows = 100
    x = np.linspace(1.0, 999.0, rows)
    name = np.full(rows, "image")
    points = [f"point {number}" for number in range(rows)]
    observations = pd.DataFrame(
        {"image": name, "point": points, "x_px": x, "y_px": x, "h_g_m": 0.0}
    )
    place = {"latitude": 47.0, "longitude": 8.0, "h_msl_m": 3000.0}
    attitude = {"omega": 0.0, "phi": 0.0, "kappa": 0.0}
    stations = pd.DataFrame([{"image": "image"} | place | attitude])
    camera = {
        "width_px": 1000,
        "height_px": 1000,
        "f_px": 1000.0,
        "cx_px": 500.0,
        "cy_px": 500.0,
        "calibration": "laboratory",
        "window": {"cabin": "standard_schedule"},
    }
    correct(observations, stations, "us1976", {"main": camera})
