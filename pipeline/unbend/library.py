"""The correction as a library: tables in memory in, the table of a run out.

It is a run without files: a mission is made of the tables, then prepared, checked and corrected by
the functions of `stages.story`, as in a run.
"""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import pyarrow as pa

from unbend.batch.finished_run.read_back import stations_of
from unbend.batch.given_air import Air, air_of_stations
from unbend.batch.opening import (
    KNOWN_POSITIONS,
    columns_of_positions,
    geographic_places,
    open_inputs,
    open_table,
    paths_of_other_inputs,
    stated_orientation,
)
from unbend.config import Mission
from unbend.config.orientations import KnownPositions
from unbend.config.reading import mission_of
from unbend.messages import LOSSES, Ledger, Message
from unbend.stages import messages
from unbend.stages.correction import correct_parts
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.opened_inputs import KnownImagePositions, OpenedInputs
from unbend.stages.results import observation_metadata
from unbend.stages.statistics import Statistics
from unbend.stages.story import PreparedMission, correct_mission, prepare_mission
from unbend.tables.imports.user_tables import known_positions_of_frame, orientation_of_frame
from unbend.tables.manifest.results import ResultsRecord

Table = TypeVar("Table", pd.DataFrame, pa.Table)

_QUANTITY_OF_COLUMN = {
    "lat_deg": "latitude",
    "lon_deg": "longitude",
    "latitude_deg": "latitude",
    "longitude_deg": "longitude",
    "omega_deg": "omega",
    "phi_deg": "phi",
    "kappa_deg": "kappa",
    "roll_deg": "roll",
    "pitch_deg": "pitch",
    "yaw_deg": "yaw",
    "sigma_tilt_deg": "sigma_tilt",
    "sigma_yaw_deg": "sigma_yaw",
}
"""Quantities of stations, by other names that their columns may have."""

_REFERENCE_OF_HEIGHT = {"h_msl_m": "msl", "h_ellipsoid_m": "ellipsoid"}
"""The reference of heights, by the name of their column."""

_ANGLES_OF_COLUMN = {"omega": "omega_phi_kappa", "roll": "roll_pitch_yaw", "q_w": "quaternion"}
"""The kind of angles that stations have, by one of their columns."""

_OPTIONAL_COLUMNS = (
    "camera",
    "time_utc",
    "sigma_horizontal_m",
    "sigma_height_m",
    "sigma_tilt",
    "sigma_yaw",
)
"""Columns of stations that are used where they are there."""

_COLUMNS_OF_A_RUN = {"profile_id", "status", "q_w"}
"""Columns that show together that a table is ``stations.parquet`` of a run."""

_DEFAULT_GROUND_HEIGHT = {"column": "h_g_m"}
"""The default of the key ``ground.height``."""

_DEFAULT_GROUND_REFERENCE = "msl"
"""The default of the key ``ground.reference``: only for the default column, or for a number."""

_RECORDS = ("uncertainty", "profile", "cabin_air", "ledger")
"""Records of the manifest that go with the corrected table."""

_REPLACED_SECTIONS = {"log", "stations", "events", "atmosphere", "output"}
"""Sections of a mission file that tables in memory replace, so that they may not be given."""


def correct(
    observations: Table,
    /,
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
        Points that two images show check the orientations: without names of points, as with
        row numbers, a wrong sense of the angles is not noticed.
    stations : one row for each image: image, camera (where there are several), position and
        attitude. The position is latitude, longitude [deg] (or lat_deg, lon_deg) and a height,
        named h_msl_m or h_ellipsoid_m [m]; or x, y of a projection and such a height, with
        ``orientation={"frame": "projected", "crs": "EPSG:32632"}``. The attitude is omega, phi,
        kappa [deg] (omega_deg too) of the camera against east, north and up at the station, or
        those of the grid; or roll, pitch, yaw [deg] of the aircraft; or the quaternion q_w to q_z
        that turns from east, north, up to the camera (x right, y down, z forward). Or the whole
        ``stations.parquet`` of a run, which is then taken as it is.
    profile : a `Profile`; with a covariance a `TimedProfile`; the `ProfileSeries` or the
        ``profile.parquet`` of a run with its stations; the name of a standard atmosphere; or the
        section ``atmosphere`` of a mission file, from which the air is estimated.
    cameras : the section of that name of a mission file.
    orientation : further keys of ``stations.orientation``, for what the names of columns do not
        say: angles (``quaternion_to_frame`` for the inverse), frame, heights, unit, columns, date,
        sigmas. ``known_positions`` may be a table with image, latitude, longitude [deg] (or
        lat_deg, lon_deg) and height [m] with the reference of the heights of ``stations``.
    sections : other sections of a mission file, as ``ground={"height": 120.0}``, or
        ``observations={"pixel_origin": "centre"}`` where pixels count from the centre of the first.
        The section ``ground`` has the defaults ``height={"column": "h_g_m"}`` and
        ``reference="msl"``, which the ledger names (TABLES-DEFAULT). The reference of heights from
        another column or a file must be stated.

    Returns a table of the kind of ``observations`` with the columns of a run, the same to the last
    bit, its rows in the order of ``observations``; a DataFrame has their index. ``uncertainty``,
    ``profile`` (the air and its sources), ``cabin_air`` and ``ledger`` of the manifest are in
    ``attrs`` of a DataFrame, and as JSON in the metadata of an Arrow table.

    Refuses what a run refuses, with the same codes (`unbend.UnbendError`). Each loss or finding,
    which would end a run with code 3, is a UserWarning. Raises TypeError for what is no table,
    for exchanged tables and for a camera without a name, and ValueError for a series of profiles
    that belongs to other stations.
    """
    replaced = sorted(_REPLACED_SECTIONS & sections.keys())
    if replaced:
        raise TypeError(f"{', '.join(replaced)}: tables in memory replace these sections")
    observation_table = _arrow_table(observations, "observations")
    station_table: pa.Table = _arrow_table(stations, "stations")
    _check_order(observation_table, station_table)
    _check_camera_names(cameras)
    station_frame = station_table.to_pandas().rename(columns=_QUANTITY_OF_COLUMN)
    all_sections = {"cameras": cameras, "atmosphere": _atmosphere(profile), **sections}
    keys, known_positions = split_known_positions(orientation or {})
    mission = mission_of_tables(station_frame, keys, all_sections)
    run_stations = None
    if {*station_table.column_names} >= _COLUMNS_OF_A_RUN:
        run_stations = stations_of(station_table)
        from_run = mission.stations.model_copy(update={"orientation": None})
        mission = mission.model_copy(update={"log": None, "stations": from_run})
    ledger = Ledger(messages_of_tables(mission, station_frame, keys, sections))
    mission, inputs = inputs_of_tables(
        mission, observation_table, station_frame, ledger, known_positions=known_positions
    )
    prepared = prepare_mission(mission, inputs, ledger, stations=run_stations)
    if not isinstance(profile, str | Mapping):
        air = air_of_stations(profile, station_table, prepared.stations)
        prepared = replace(prepared, air=air)
    report_given_air(profile, ledger)
    table, results = corrected_table(prepared)
    for entry in results.ledger:
        if entry.kind in LOSSES:
            warnings.warn(f"{entry.code}: {entry.what}", UserWarning, stacklevel=2)
    manifest = results.row()
    records = {name: manifest[name] for name in _RECORDS}
    if isinstance(observations, pd.DataFrame):
        corrected: pd.DataFrame = table.to_pandas()
        corrected.index = observations.index
        corrected.attrs |= records
        return corrected
    texts = {f"unbend.{name}": json.dumps(value) for name, value in records.items()}
    return table.replace_schema_metadata(table.schema.metadata | texts)


def corrected_table(prepared: PreparedMission) -> tuple[pa.Table, ResultsRecord]:
    """Correct all observations of a mission in memory; returns their table and its record."""
    tables: list[pa.Table] = []

    def correct_all(setup: CorrectionSetup) -> Statistics:
        total = Statistics.of(setup.cameras)
        parts = correct_parts(
            prepared.observations,
            setup,
            finish=lambda part: part,
            batch_rows=prepared.mission.output.batch_rows,
            metadata=observation_metadata(prepared.mission),
        )
        for part in parts:
            total.merge(part.statistics)
            tables.append(part.table)
        return total

    results = correct_mission(prepared, correct_all).results
    return pa.concat_tables(tables), results


def _atmosphere(profile: Air) -> Mapping[str, Any]:
    """The section ``atmosphere`` of the mission for the argument ``profile`` of `correct`.

    For a profile that is a value the section has no effect: the value replaces the air later.
    """
    if isinstance(profile, str):
        return {"adjust": False, "standard": profile}
    if isinstance(profile, Mapping):
        return profile
    return {"adjust": False}


def _arrow_table(table: pd.DataFrame | pa.Table, name: str) -> pa.Table:
    """A table as an Arrow table; a TypeError for anything else calls it ``name``."""
    if isinstance(table, pd.DataFrame):
        return pa.Table.from_pandas(table, preserve_index=False)
    if not isinstance(table, pa.Table):
        kind = type(table).__name__
        raise TypeError(f"{name} must be a pandas DataFrame or a pyarrow Table, not a {kind}")
    return table


def _check_order(observations: pa.Table, stations: pa.Table) -> None:
    """Refuse (TypeError) two tables that seem exchanged: the second has the pixels."""
    pixel_columns = {"x_px", "y_px"}
    stations_have_pixels = pixel_columns <= {*stations.column_names}
    if stations_have_pixels and pixel_columns.isdisjoint(observations.column_names):
        raise TypeError(
            "stations has the columns x_px and y_px, and observations does not: the two tables "
            "seem exchanged; the order is correct(observations, stations, ...)"
        )


def _check_camera_names(cameras: object) -> None:
    """Refuse (TypeError) the keys of one camera where sections by name are expected."""
    if not isinstance(cameras, Mapping):
        return
    if not all(isinstance(section, Mapping) for section in cameras.values()):
        raise TypeError(
            'cameras must be sections by the name of a camera: give cameras={"nadir": camera}'
        )


def split_known_positions(
    orientation: Mapping[str, Any],
) -> tuple[Mapping[str, Any], pd.DataFrame | None]:
    """Split a table in memory off the key ``known_positions`` of an orientation.

    Returns the keys of the orientation, with the name of a file in the place of the table, and the
    table, its columns named by quantities; None if the key has no table.
    """
    stated = orientation.get("known_positions")
    if not isinstance(stated, pd.DataFrame | pa.Table):
        return orientation, None
    table = _arrow_table(stated, "known_positions").to_pandas()
    known_positions = table.rename(columns=_QUANTITY_OF_COLUMN)
    return {**orientation, "known_positions": {"path": "known_positions"}}, known_positions


def mission_of_tables(
    frame: pd.DataFrame, orientation: Mapping[str, Any], sections: Mapping[str, Any]
) -> Mission:
    """The mission of tables in memory.

    ``frame`` is the table of stations, its columns named by quantities. ``orientation`` and
    ``sections`` are what the caller states in addition.
    """
    filled = [str(name) for name in frame if frame[name].notna().any()]
    all_sections = {
        **sections,
        "ground": ground_section(sections.get("ground", {})),
        "mission": {"name": "tables", **sections.get("mission", {})},
        "observations": {**sections.get("observations", {}), "path": "observations"},
        "stations": {"orientation": orientation_section(filled, orientation)},
        "output": {"path": "results"},
    }
    if "profile_id" in filled:  # stations of a run: its cabin's air may come from a log
        all_sections["log"] = {"path": "-"}
    plain_sections = json.loads(json.dumps(all_sections, default=_plain_value))
    return mission_of(plain_sections, None, "sections")


def ground_section(stated: object) -> object:
    """The section ``ground``: as stated, with defaults for height and reference."""
    if not isinstance(stated, Mapping):
        return stated  # which the model of the mission refuses
    return ground_defaults(stated) | {**stated}


def ground_defaults(stated: Mapping[str, object]) -> dict[str, object]:
    """The keys of the section ``ground`` that get a default, because they are not ``stated``.

    The reference of another column, of an elevation model or of a table of points has no default:
    such heights are often above the ellipsoid, some 50 m from mean sea level.
    """
    defaults: dict[str, object] = {}
    height = stated.get("height", _DEFAULT_GROUND_HEIGHT)
    if "height" not in stated:
        defaults["height"] = height
    has_default_reference = height == _DEFAULT_GROUND_HEIGHT or isinstance(height, int | float)
    if "reference" not in stated and has_default_reference:
        defaults["reference"] = _DEFAULT_GROUND_REFERENCE
    return defaults


def messages_of_tables(
    mission: Mission,
    frame: pd.DataFrame,
    orientation: Mapping[str, Any],
    sections: Mapping[str, Any],
) -> Iterator[Message]:
    """Messages about tables in memory: what a default decided, and what is not used.

    ``mission`` was made of these tables; it has no orientation where the stations are those of a
    run. ``frame`` is the table of stations, its columns named by quantities; ``orientation`` and
    ``sections`` are as the caller stated them.
    """
    if ground_defaults(sections.get("ground", {})):
        ground = mission.ground
        yield messages.ground_by_default(
            where="ground",
            height=str(ground.model_dump()["height"]),
            reference=ground.reference,
        )
    section = mission.stations.orientation
    if section is None:
        if orientation:
            yield messages.orientation_not_used(
                where="orientation",
                count=len(orientation),
                keys=", ".join(orientation),
            )
        return
    filled = [str(name) for name in frame if frame[name].notna().any()]
    used = set(stated_orientation(section).columns.values())
    for alternatives in (_ANGLES_OF_COLUMN, _REFERENCE_OF_HEIGHT):
        present = [name for name in alternatives if name in filled]
        yield from warning_of_unused(present, used)
    if "date" in orientation and "time_utc" in filled:
        yield messages.date_before_times(where="orientation", date=str(orientation["date"]))


def warning_of_unused(alternatives: Sequence[str], used: Set[str]) -> Iterator[Message]:
    """A warning if a table has alternative columns, and only some of them are ``used``."""
    chosen = [name for name in alternatives if name in used]
    unused = [name for name in alternatives if name not in used]
    if not chosen or not unused:
        return
    yield messages.columns_not_used(
        where="stations",
        count=len(unused),
        unused=", ".join(unused),
        used=", ".join(chosen),
    )


def report_given_air(profile: Air, ledger: Ledger) -> None:
    """Note in the ledger which air the caller gave, unless it is a section ``atmosphere``.

    The note replaces the message that the air is not adjusted.
    """
    if isinstance(profile, Mapping):
        return
    ledger.remove(lambda message: message.code == messages.AIR_NOT_ADJUSTED.name)
    air = f"the standard atmosphere {profile}" if isinstance(profile, str) else "a profile"
    ledger.add(messages.air_is_given(air=air))


def orientation_section(filled: Sequence[str], stated: Mapping[str, Any]) -> dict[str, Any]:
    """The section ``stations.orientation`` for a table with these ``filled`` columns.

    The names of the columns decide what the caller has not ``stated``. A stated column of heights
    is used alone; without one, the column of heights with the stated reference. A stated date is
    used instead of times. Refuses (ConfigError TABLES-FRAME) x and y without a stated frame.
    """
    refuse_unknown_frame(filled, stated)
    columns = {name: name for name in _OPTIONAL_COLUMNS if name in filled}
    if "date" in stated:
        columns.pop("time_utc", None)
    section: dict[str, Any] = {"frame": "geographic"}
    for name, angles in _ANGLES_OF_COLUMN.items():
        if name in filled:
            section["angles"] = angles
    frame = stated.get("frame", "geographic")
    is_local = isinstance(frame, Mapping)  # angles of one place
    has_places = "latitude" in filled and "longitude" in filled
    if is_local and has_places:  # degrees, which are not the default in this frame
        columns["latitude"] = "latitude"
        columns["longitude"] = "longitude"
    stated_columns = dict(stated.get("columns", {}))
    is_geodetic = has_places and (is_local or frame == "geographic")
    if is_geodetic and "height" not in stated_columns:
        section |= add_height_column(columns, "height", filled, stated.get("heights"))
    elif frame == "projected" and "z" not in stated_columns:
        section |= add_height_column(columns, "z", filled, stated.get("heights"))
    section |= stated
    section["columns"] = columns | stated_columns
    section["path"] = "stations"
    return section


def refuse_unknown_frame(filled: Sequence[str], stated: Mapping[str, Any]) -> None:
    """Refuse (ConfigError TABLES-FRAME) places in x and y alone, if no frame is stated."""
    has_map_places = "x" in filled and "y" in filled
    if has_map_places and "latitude" not in filled and "frame" not in stated:
        raise messages.frame_of_tables_missing(where="orientation")


def add_height_column(
    columns: dict[str, str], key: str, filled: Sequence[str], stated_reference: str | None
) -> dict[str, str]:
    """Change ``columns``: put the first filled column of heights under ``key``.

    If a reference is stated, only a column with this reference counts. Returns the key ``heights``
    of the section, the reference of the column; an empty mapping without a column.
    """
    for name, reference in _REFERENCE_OF_HEIGHT.items():
        if name in filled and stated_reference in (None, reference):
            columns[key] = name
            return {"heights": reference}
    return {}


def _plain_value(value: object) -> object:
    """A value for JSON: a number of numpy with all its digits, anything else as text."""
    if isinstance(value, np.generic):
        return value.item()
    return str(value)


def inputs_of_tables(
    mission: Mission,
    observation_table: pa.Table,
    station_frame: pd.DataFrame,
    ledger: Ledger,
    *,
    known_positions: pd.DataFrame | None = None,
) -> tuple[Mission, OpenedInputs]:
    """The opened inputs of a mission: tables in memory, and the files that it names.

    ``known_positions`` is None if they are in a file, or if there are none. The returned mission
    has the values of its camera files filled in.
    """
    in_memory = set() if known_positions is None else {KNOWN_POSITIONS}
    mission, paths = paths_of_other_inputs(mission, Path.cwd(), in_memory=in_memory)
    path = Path(mission.observations.path)
    observations = open_table(mission, path, ledger, table=observation_table)
    inputs = open_inputs(mission, paths, observations, None, ledger)
    section = mission.stations.orientation
    if section is None:
        return mission, inputs
    table = orientation_of_frame(station_frame, section.path, stated_orientation(section), ledger)
    inputs = replace(
        inputs,
        orientation=table,
        block_places=(*inputs.block_places, *geographic_places(station_frame, section)),
    )
    if known_positions is not None and isinstance(section.known_positions, KnownPositions):
        columns = columns_of_positions(section.known_positions)
        positions = known_positions_of_frame(known_positions, section.known_positions.path, columns)
        inputs = replace(inputs, known_positions=KnownImagePositions(*positions))
    return mission, inputs


def correct_one_image() -> None:
    """Correct one made-up image, so that numba compiles the code that most missions call.

    Its camera has a Brown-Conrady lens and its ground one height. The code of other lens models and
    of elevation models is compiled by the first mission that needs it.
    """
    rows = 100
    pixels = np.linspace(1.0, 999.0, rows)
    images = np.full(rows, "image")
    points = [f"point {number}" for number in range(rows)]
    observations = pd.DataFrame(
        {"image": images, "point": points, "x_px": pixels, "y_px": pixels, "h_g_m": 0.0}
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
