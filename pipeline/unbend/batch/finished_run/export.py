"""A finished run is rebuilt from its folder, computed again in part, and written in a format."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.batch import remote, store
from unbend.batch.finished_run import messages
from unbend.batch.finished_run.later_changes import notes_on_changes
from unbend.batch.finished_run.read_back import air_of, mission_of, stations_of
from unbend.batch.manifest import manifest_text
from unbend.batch.messages import input_changed, url_for_export
from unbend.batch.remote import Place, is_url
from unbend.batch.results import find_damage, manifest_of_run, verify_run
from unbend.config import Mission
from unbend.errors import InputError
from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M
from unbend.ingest.flight_log import hash_file
from unbend.messages import Ledger, Notes
from unbend.refraction.image import correct_observations
from unbend.refraction.ray import rays_by
from unbend.stages import exposure_setup
from unbend.stages.wavelengths import air_by_camera
from unbend.tables.exports import FORMATS, ExportCamera, ExportFormat, FinishedRun, find_format
from unbend.tables.exports.export_format import NO_PROGRESS, ExportProgress
from unbend.tables.exports.export_frames import frame_record
from unbend.tables.exports.messages import geoid_without_grid, grid_not_taken
from unbend.tables.geodata.geoid import read_geoid
from unbend.tables.geodata.map_grids import MapGrid, open_grid
from unbend.tables.manifest.file_names import MANIFEST
from unbend.tables.manifest.whole import Manifest
from unbend.tables.refraction_mark import SIDECAR, sidecar_text
from unbend.units import Array, Integers

_MOST_CHECKED = 50_000  # observations that are computed again, spread over all of a run
_LARGEST_DIFFERENCE_PX = 1e-6  # of reading back; the sample runs are reproduced to the last bit
_LARGEST_CHECKED_RAD = np.radians(80.0)
"""Beyond this nadir angle the correction may depend on the distance of the point, which the table
does not have: the ray can cross the height of the ground twice."""

_CHECKED_NUMBERS = ("x_px", "y_px", "x_corrected_px", "y_corrected_px", "zeta_c_rad", "h_g_m")
_CHECKED = [*_CHECKED_NUMBERS, "status"]
"""Columns of the observations that are compared."""


@dataclass(frozen=True)
class ExportSystem:
    """The coordinate system of an export, as EPSG:25832; "" takes the default of the format.

    ``geoid`` is the grid of the heights in the vertical part of the system; None without one.
    """

    crs: str = ""
    geoid: Path | None = None


SYSTEM_OF_FORMAT = ExportSystem()


@dataclass(frozen=True)
class WrittenExport:
    """What an export wrote: the number of rows, their frame, and notes on what was left out.

    ``frame`` is described in `unbend.tables.exports.export_frames`.
    """

    rows: int
    frame: Mapping[str, Any]
    ledger: Ledger


def export_run(
    path: Path | Place,
    name: str,
    out: Path,
    options: Mapping[str, Any],
    *,
    system: ExportSystem = SYSTEM_OF_FORMAT,
    ground_height_m: float | None = None,
    force: bool = False,
    progress: ExportProgress = NO_PROGRESS,
) -> WrittenExport:
    """Write a finished run to ``out`` in the format called ``name``.

    ``path`` is the run, ``options`` are values of the format's options by name. ``system`` is the
    coordinate system of the export. ``ground_height_m`` [m above sea level] replaces the run's
    ground heights. ``force`` replaces a file at ``out``, never a folder. A sidecar next to the
    file, or in the folder, has the frame as JSON.
    """
    form = find_format(name, out)
    is_folder = not form.ending  # a format with an ending is one file
    values = form.values(options)
    refuse_system(form, system)
    folder = copy_of_run(path) if isinstance(path, Place) else path
    refuse_output(folder, out, force=force and not is_folder)
    ledger = Ledger()
    progress.start("checking the results")
    manifest = verify_run(folder)
    ledger.extend(notes_on_changes(folder, manifest))
    run = rebuild_run(folder, manifest, ground_height_m, ledger, progress)
    run = replace(run, grid=ledger.take(grid_of_export(run, form, system)))
    with store.atomic_write(out) as draft:
        if is_folder:
            draft.mkdir(parents=True)
        rows = form.write(run, values, draft, ledger)
        frame = frame_record(form.frame(run, values))
        use = form.use
        if form.grid is not None and system.crs:
            use = form.grid.use
        if use:
            ledger.add(messages.use_of_export(use=use, name=name))
        # The mark appears before the file: points without it might be corrected again.
        about = {"mission": run.mission, "format": name, "frame": frame}
        if is_folder:
            main_file = draft / (form.marked[0] if form.marked else name)
            corrected_files = {file: draft / file for file in form.marked}
        else:
            main_file = out
            corrected_files = {out.name: draft} if form.marked else {}
        write_sidecar(main_file, corrected_files, about, ledger)
    return WrittenExport(rows, frame, ledger)


def refuse_system(form: ExportFormat, system: ExportSystem) -> None:
    """Refuse (EXPORT-OPTION) a coordinate system that the format does not take."""
    if system.crs and form.grid is None:
        takers = [other.name for other in FORMATS.values() if other.grid is not None]
        raise grid_not_taken(name=form.name, takers=", ".join(takers))
    if system.geoid is not None and not system.crs:
        raise geoid_without_grid()


def grid_of_export(
    run: FinishedRun, form: ExportFormat, system: ExportSystem
) -> tuple[MapGrid | None, Notes]:
    """The coordinate system of an export with the notes on it; None for a format without one.

    It is that of ``system`` or else the default of the format, which gives no notes.
    """
    if form.grid is None:
        return None, ()
    wanted = system.crs or form.grid.default
    if not wanted:
        return None, ()
    is_usable = run.stations.ok
    grid, notes = open_grid(
        wanted,
        run.stations.lat_rad[is_usable],
        run.stations.lon_rad[is_usable],
        geoid=None if system.geoid is None else read_geoid(system.geoid),
        needs_angles=form.grid.needs_angles,
    )
    return grid, notes if system.crs else ()


def write_sidecar(
    main_file: Path, corrected_files: Mapping[str, Path], about: Mapping[str, Any], ledger: Ledger
) -> None:
    """Write the sidecar of an export: JSON with ``about``, the notes, and the corrected files.

    Its name is that of ``main_file`` with `SIDECAR` appended. ``corrected_files`` are the files
    with points from which refraction is removed: their present paths by their final names. There
    may be none.
    """
    notes = [message.what for message in ledger]
    text = sidecar_text(corrected_files, {**about, "notes": notes})
    path = main_file.with_name(main_file.name + SIDECAR)
    with store.atomic_write(path) as draft:
        draft.write_text(text, encoding="utf-8")


def refuse_output(run: Path, out: Path, *, force: bool) -> None:
    """Refuse to write into the folder of a run, over a folder, over a file or to a URL.

    ``run`` is the folder of the run; ``force`` allows to replace a file.
    """
    if is_url(str(out)):
        raise url_for_export(url=str(out))
    # A link outside may lead into the folder, or a link in the folder to another place.
    for resolve in (os.path.abspath, os.path.realpath):
        target = Path(resolve(out))
        if target.is_relative_to(resolve(run)):
            raise messages.inside_run(path=str(out))
    if out.is_dir():
        raise messages.folder_exists(path=str(out))
    if os.path.lexists(out) and not force:
        raise messages.file_exists(path=str(out))


def copy_of_run(place: Place) -> Path:
    """Copy the run that is published at a place; returns the folder of the copy.

    It is in the user's cache. If another run is published meanwhile, that run is copied.
    """
    manifest = manifest_of_run(place)
    with suppress(FileNotFoundError, InputError):
        copy = remote.copy_of_attempt(place, manifest)
        if not find_damage(place, manifest, hash_all=False):  # all was there while it was copied
            with store.atomic_write(copy / MANIFEST) as draft:
                draft.write_text(manifest_text(manifest), encoding="utf-8")
            return copy
    # The files could not be copied. If the same run is published still, one of them has changed.
    if verify_run(place) == manifest:
        raise input_changed(role="results", path=str(place))
    return copy_of_run(place)


def rebuild_run(
    path: Path,
    manifest: Manifest,
    ground_height_m: float | None,
    ledger: Ledger,
    progress: ExportProgress = NO_PROGRESS,
) -> FinishedRun:
    """A finished run as exports need it, from its folder ``path`` alone.

    ``ground_height_m`` [m above sea level] replaces the ground heights of the run. Refuses a run
    that does not remove refraction (EXPORT-DIRECTION), and a run with corrections that cannot be
    computed again (EXPORT-NOT-REPRODUCED).
    """
    if ground_height_m is not None and not LOWEST_GROUND_M <= ground_height_m <= HIGHEST_GROUND_M:
        raise messages.no_ground_height(
            height=ground_height_m, lowest=LOWEST_GROUND_M, highest=HIGHEST_GROUND_M
        )
    mission = mission_of(manifest, path)
    if mission.refraction.direction != "remove":
        raise messages.no_corrections(path=str(path / MANIFEST))
    table = pq.read_table(path / "stations.parquet")
    stations = stations_of(table)
    common_air = air_of(pq.read_table(path / "profile.parquet"), table["profile_id"])
    air = air_by_camera(common_air, stations.camera, mission.wavelengths_m)
    wavelengths = json.dumps(wavelengths_of_cameras(mission, common_air))
    method = mission.refraction.method
    outputs = sorted(item.name for item in manifest.run.outputs)
    already_reported = Ledger()  # the run has made these notes, and its manifest has them
    run = FinishedRun(
        mission=mission.mission.name,
        stations=stations,
        exposures=exposure_setup.exposures_of_mission(mission, stations, air, already_reported),
        air=air,
        rays=tuple(rays_by(profile, method) for profile in air.profiles),
        method=method,
        cameras=cameras_of(mission),
        find_ground=partial(ground_of, constant_m=ground_height_m, ledger=ledger),
        pixels=mission.observations.pixels,
        parts=tuple(path / name for name in outputs if name.startswith("observations/")),
        metadata={
            "unbend.mission": mission.mission.name,
            "unbend.fingerprint": manifest.run.fingerprint,
            "unbend.pixel_origin": mission.observations.pixel_origin,
            "unbend.wavelength_m": wavelengths,
        },
        database=partial(database_of, mission, manifest, path),
        progress=progress,
    )
    check_reproduced(run, path)
    return run


def wavelengths_of_cameras(mission: Mission, air: ProfileSeries) -> dict[str, float]:
    """The wavelength in vacuum [m] of the light of each camera; that of ``air`` if not stated."""
    common_m = air.index.light_m
    wavelengths = {}
    for name in mission.cameras:
        stated_m = mission.wavelengths_m.get(name)
        wavelengths[name] = common_m if stated_m is None else stated_m
    return wavelengths


def cameras_of(mission: Mission) -> dict[str, ExportCamera]:
    """The cameras of a mission as exports need them: with window, pixel size and calibration."""
    cameras = {}
    for name, camera in mission.interior_orientations.items():
        section = mission.cameras[name]
        pixel_mm = np.nan  # unknown, or of pixels that are not square
        if section.metric is not None:
            width_um, height_um = section.metric.pixel_um
            if width_um == height_um:
                pixel_mm = width_um * 1e-3
        cameras[name] = ExportCamera(
            camera=camera,
            has_window=name in mission.windows and mission.windows[name].shape == "plane",
            pixel_mm=pixel_mm,
            has_refraction=section.calibration == "in_flight_uncorrected",
        )
    return cameras


def ground_of(run: FinishedRun, constant_m: float | None, ledger: Ledger) -> Array:
    """(s,) ground height [m above sea level] of each image: the median of its observations.

    ``constant_m`` is the height of all images, unless it is None. A usable image without
    observations gets the median of the other images, with a note; otherwise NaN. Memory: 16 bytes
    an observation.
    """
    if constant_m is not None:
        return np.full(len(run.stations), constant_m)
    stations = []
    heights = []
    for station, table in run.observations(["h_g_m"]):
        stations.append(station)
        heights.append(table["h_g_m"].to_numpy())
    known_heights = pd.Series(np.concatenate(heights)).dropna()
    station_of_known = np.concatenate(stations)[known_heights.index]
    by_station = known_heights.groupby(station_of_known).median()
    ground = np.array(by_station.reindex(range(len(run.stations))), dtype=np.float64)
    has_ground = np.isfinite(ground)
    lacks_ground = ~has_ground & run.stations.ok
    if bool(lacks_ground.any()) and bool(has_ground.any()):
        median = float(np.nanmedian(ground))
        ground[lacks_ground] = median
        ledger.add(messages.ground_of_others(count=int(lacks_ground.sum()), median=median))
    return ground


def database_of(mission: Mission, manifest: Manifest, path: Path) -> Path | None:
    """COLMAP's database that the run read; None if it read none, or it is gone or changed.

    ``path`` is the run's folder. The mission file may be gone. Its paths are relative to its
    folder, which is unknown, so the database is located relative to the results.
    """
    mission_folder = Path("/?/?/?/?/?")  # a stand-in for the unknown one; has room for five ".."
    database = mission.observations.path
    if not os.path.isabs(database):
        results = mission_folder / mission.output.path
        database = os.path.relpath(mission_folder / database, results)
    file = path / database
    if file.suffix.lower() != ".db" or not file.is_file():
        return None
    hashes_read = {item.sha256 for item in manifest.run.inputs if item.role == "observations"}
    return file if hash_file(file) in hashes_read else None


def check_reproduced(run: FinishedRun, path: Path) -> None:
    """Refuse corrections that cannot be computed again to 1e-6 px (EXPORT-NOT-REPRODUCED)."""
    largest = 0.0
    for station, table in run.observations(_CHECKED, _MOST_CHECKED):
        largest = max(largest, largest_difference_px(run, table, station))
    if largest > _LARGEST_DIFFERENCE_PX:
        raise messages.not_reproduced(path=str(path), largest_px=largest)


def largest_difference_px(run: FinishedRun, table: pa.Table, station: Integers) -> float:
    """The largest difference between corrections in a table and those computed again [px].

    ``station`` (n,) is the index of the station of each row of ``table``. Infinite if a correction
    cannot be computed again. Rows with a nadir angle beyond 80 degrees, or without the status ok,
    are not compared.
    """
    columns = {}
    for column in _CHECKED_NUMBERS:
        values = table[column].to_numpy()
        columns[column] = np.asarray(values, dtype=np.float64)
    for column in ("x_px", "y_px", "x_corrected_px", "y_corrected_px"):
        columns[column] = run.pixels.to_colmap(columns[column])
    is_compared = np.asarray(pc.equal(table["status"], "ok").to_numpy())
    is_compared &= columns["zeta_c_rad"] < _LARGEST_CHECKED_RAD
    largest = 0.0
    for name, camera in run.cameras.items():
        is_of_camera = is_compared & (run.stations.camera[station] == name)
        for profile in np.unique(run.air.profile_number[station[is_of_camera]]):
            rows = np.flatnonzero(is_of_camera & (run.air.profile_number[station] == profile))
            recomputed = correct_observations(
                columns["x_px"][rows],
                columns["y_px"][rows],
                columns["h_g_m"][rows],
                station[rows],
                run.exposures,
                camera=camera.camera,
                table=run.rays[profile],
            )
            difference = np.hypot(
                recomputed.x_corrected_px - columns["x_corrected_px"][rows],
                recomputed.y_corrected_px - columns["y_corrected_px"][rows],
            )
            largest = max(largest, float(np.nan_to_num(difference, nan=np.inf).max()))
    return largest
