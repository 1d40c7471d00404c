"""A finished run read back from its folder: mission, stations, profiles, ground; and checked."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import ValidationError

from unbend.atmosphere.layers import Layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.batch import messages, remote, store
from unbend.batch.manifest import MANIFEST, manifest_text
from unbend.batch.remote import Place, is_url
from unbend.batch.results import find_damage, manifest_of_run, verify_run
from unbend.config import Mission
from unbend.errors import ConfigError, InputError, MissionError
from unbend.flight.heights import HIGHEST_GROUND_M, LOWEST_GROUND_M
from unbend.flight.stations import NO_TIME, SUSPECT, Stations
from unbend.geodesy import Gravity
from unbend.ingest.flight_log import hash_file
from unbend.messages import Ledger
from unbend.refraction.image import correct_observations
from unbend.refraction.ray import rays_by
from unbend.stages import exposure_setup
from unbend.tables.exports import ExportCamera, FinishedRun, find_format
from unbend.tables.refraction_mark import SIDECAR, sidecar_text
from unbend.units import Array, Integers, Names

_MOST_CHECKED = 50_000  # observations of a run that are computed again, spread over all of them
_LARGEST_DIFFERENCE_PX = 1e-6  # of reading back; the sample runs are reproduced to the last bit
_LARGEST_CHECKED_RAD = np.radians(80.0)
"""Beyond, an observation may be on the far branch by its distance, which no table keeps."""


def mission_of(manifest: dict[str, Any], path: Path) -> Mission:
    """The mission file as the run understood it, from its manifest."""
    try:
        # As text, because strict models take from JSON what they gave to it.
        return Mission.model_validate_json(json.dumps(manifest.get("config")))
    except ValidationError as error:
        raise MissionError.of(
            "EXPORT-CONFIG", str(path / "manifest.json"), mistakes=error.error_count()
        ) from None


def stations_of(table: pa.Table) -> Stations:
    """Stations from the table of ``stations.parquet``; the inverse of `table_of_stations`."""

    def number(name: str) -> Array:
        if name not in table.schema.names:  # of an older version
            return np.full(table.num_rows, np.nan)
        return np.asarray(table[name].to_numpy(), dtype=np.float64)

    def quaternion(prefix: str) -> Array:
        return np.stack([number(f"{prefix}_{axis}") for axis in "wxyz"], axis=1)

    def text(name: str) -> Names:
        there = name in table.schema.names
        values = table[name].to_pylist() if there else [""] * table.num_rows
        return np.array([value or "" for value in values], dtype=object)

    time = pc.fill_null(table["time_utc"].cast(pa.int64()), int(NO_TIME)).to_numpy()
    angles = ("lat", "lon", "sigma_tilt", "sigma_yaw")
    derived: dict[str, Any] = {f"{name}_rad": np.radians(number(f"{name}_deg")) for name in angles}
    derived |= {name: text(name) for name in ("image", "camera", "status", "suspect_reason")}
    derived |= {
        "time_ns": time.astype(np.int64),
        "quaternion": quaternion("q"),
        "aircraft_quaternion": quaternion("aircraft_q"),
        "accepted": np.equal(derived["status"], SUSPECT)
        & table["profile_id"].is_valid().to_numpy(),
    }
    names = [field.name for field in fields(Stations) if field.name not in derived]
    return Stations(**(derived | {name: number(name) for name in names}))


def air_of(table: pa.Table, profile_id: pa.ChunkedArray) -> ProfileSeries:
    """Profiles of ``profile.parquet``, and which is each station's: the first if it has none."""
    names = pc.unique(table["profile_id"])
    airs = tuple(
        TimedProfile(None, profile_of(table.filter(pc.equal(table["profile_id"], name))))
        for name in names
    )
    number = pc.fill_null(pc.index_in(profile_id, value_set=names), 0)
    return ProfileSeries(airs, np.asarray(number.to_numpy(), dtype=np.int64))


def profile_of(table: pa.Table) -> Profile:
    """The profile from a table of one as in ``profile.parquet``; the inverse of `table_of_profile`.

    The refractivity is that of the run to 1e-15 of itself (6e-16 in the sample runs).
    """
    metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}

    def column(name: str) -> Array:
        return np.asarray(table[name].to_numpy(), dtype=np.float64)

    vapour = column("vapour_pressure_pa") / column("pressure_pa")
    edge = np.append(column("geopotential_base_m")[:-1], column("geopotential_m")[-1])
    layers = Layers(
        edge=edge,
        temperature=column("t_base_k")[:-1],
        lapse=column("lapse_k_per_m")[:-1],
        pressure=column("p_base_pa")[:-1],
        vapour=vapour[:-1],
        vapour_slope=np.diff(vapour) / np.diff(edge),
        source=tuple(table["source"].to_pylist()[:-1]),
    )
    latitude = float(np.radians(float(metadata["latitude"]))) if metadata["latitude"] else None
    wavelength_m, co2_ppm = (float(metadata[f"unbend.{n}"]) for n in ("wavelength_m", "co2_ppm"))
    index = IndexModel(metadata["unbend.index"], wavelength_m, co2_ppm)
    gravity = Gravity(float(metadata["g_phi"]), float(metadata["r_phi"]), latitude)
    name = metadata["unbend.standard"] if metadata["unbend.basis"] == "standard" else "adjusted"
    return Profile(layers, gravity, index, name, float(metadata["unbend.constant_k_per_m"]))


def ground_of(run: FinishedRun, constant_m: float | None, ledger: Ledger) -> Array:
    """(s,) median ground height [m above sea level] of the observations of each image, or constant.

    An image without observations gets the median of the others. Memory: 16 bytes an observation.
    """
    if constant_m is not None:
        return np.full(len(run.stations), constant_m)
    rows, heights = [], []
    for station, table in run.observations(["h_g_m"]):
        rows.append(station)
        heights.append(table["h_g_m"].to_numpy())
    series = pd.Series(np.concatenate(heights)).dropna()
    by_station = series.groupby(np.concatenate(rows)[series.index]).median()
    ground = np.array(by_station.reindex(range(len(run.stations))), dtype=np.float64)
    empty = ~np.isfinite(ground) & run.stations.ok
    if bool(empty.any()) and bool(np.isfinite(ground).any()):
        ground[empty] = median = float(np.nanmedian(ground))
        count = int(empty.sum())
        ledger.fallback("EXPORT-GROUND", where="observations", count=count, median=median)
    return ground


def check_reproduced(run: FinishedRun, path: Path) -> None:
    """Refuse corrections that cannot be computed again to 1e-6 px (EXPORT-NOT-REPRODUCED)."""
    parts = run.observations(_CHECKED, _MOST_CHECKED)
    largest = max((largest_difference_px(run, t, station) for station, t in parts), default=0.0)
    if largest > _LARGEST_DIFFERENCE_PX:
        raise MissionError.of("EXPORT-NOT-REPRODUCED", path, largest=largest)


_CHECKED = ["x_px", "y_px", "x_corrected_px", "y_corrected_px", "zeta_c_rad", "h_g_m", "status"]


def largest_difference_px(run: FinishedRun, table: pa.Table, station: Integers) -> float:
    """The largest difference between corrections in a table and those computed now [px]."""
    x, y, x_then, y_then, zeta, h_g = (
        np.asarray(table[name].to_numpy(), dtype=np.float64) for name in _CHECKED[:6]
    )
    x, y, x_then, y_then = map(run.pixels.to_colmap, (x, y, x_then, y_then))
    ok = np.asarray(pc.equal(table["status"], "ok").to_numpy()) & (zeta < _LARGEST_CHECKED_RAD)
    largest = 0.0
    for name, camera in run.cameras.items():
        of_camera = ok & (run.stations.camera[station] == name)
        for air in np.unique(run.air.profile_number[station[of_camera]]):
            rows = np.flatnonzero(of_camera & (run.air.profile_number[station] == air))
            now = correct_observations(
                x[rows], y[rows], h_g[rows], station[rows],
                run.exposures, camera=camera.camera, table=run.rays[air],
            )  # fmt: skip
            difference = np.hypot(
                now.x_corrected_px - x_then[rows], now.y_corrected_px - y_then[rows]
            )
            largest = max(largest, float(np.nan_to_num(difference, nan=np.inf).max()))
    return largest


def refuse_output(run: Path, out: Path, *, force: bool) -> None:
    """Refuse to write among the results of a run, over a file that is there already, to a URL."""
    if is_url(str(out)):
        raise messages.url_for_export(url=str(out))
    for resolve in (os.path.abspath, os.path.realpath):
        if Path(resolve(out)).is_relative_to(resolve(run)):
            raise ConfigError.of("EXPORT-INSIDE-RUN", out)
    if out.is_dir():
        raise ConfigError.of("EXPORT-EXISTS/folder", out)
    if os.path.lexists(out) and not force:
        raise ConfigError.of("EXPORT-EXISTS", out)


def rebuild_run(
    path: Path, manifest: dict[str, Any], ground_height_m: float | None, ledger: Ledger
) -> FinishedRun:
    """A run from its folder alone; ``ground_height_m`` [m above sea level] replaces its heights."""
    if ground_height_m is not None and not LOWEST_GROUND_M <= ground_height_m <= HIGHEST_GROUND_M:
        raise ConfigError.of(
            "EXPORT-GROUND/limits", "--ground-height", height=ground_height_m,
            low=LOWEST_GROUND_M, high=HIGHEST_GROUND_M,
        )  # fmt: skip
    mission = mission_of(manifest, path)
    if mission.refraction.direction != "remove":
        where = f"{path / 'manifest.json'}, refraction.direction"
        raise ConfigError.of("EXPORT-DIRECTION", where)
    table = pq.read_table(path / "stations.parquet")
    stations = stations_of(table)
    air = air_of(pq.read_table(path / "profile.parquet"), table["profile_id"])
    windows = mission.windows
    cameras = {}
    for name, camera in mission.interior_orientations.items():
        section, plane = mission.cameras[name], name in windows and windows[name].shape == "plane"
        wide, high = (np.nan, np.nan) if section.metric is None else section.metric.pixel_um
        in_flight = section.calibration == "in_flight_uncorrected"
        cameras[name] = ExportCamera(
            camera, plane, wide * 1e-3 if wide == high else np.nan, in_flight
        )
    outputs = sorted(str(item["name"]) for item in manifest["outputs"])
    run = FinishedRun(
        mission.mission.name,
        stations,
        exposure_setup.exposures_of_mission(mission, stations, air, Ledger()),
        air,
        tuple(rays_by(profile, mission.refraction.method) for profile in air.profiles),
        mission.refraction.method,
        cameras,
        partial(ground_of, constant_m=ground_height_m, ledger=ledger),
        mission.observations.pixels,
        tuple(path / name for name in outputs if name.startswith("observations/")),
        {
            "unbend.mission": mission.mission.name,
            "unbend.fingerprint": manifest["fingerprint"],
            "unbend.pixel_origin": mission.observations.pixel_origin,
        },
        partial(database_of, mission, manifest, path),
    )
    check_reproduced(run, path)
    return run


def database_of(mission: Mission, manifest: dict[str, Any], path: Path) -> Path | None:
    """COLMAP's database that the run read, as seen from its folder; None if gone or changed."""
    here = Path("/?/?/?/?/?")  # in the place of the mission's folder, whose name no table keeps
    stated = mission.observations.path
    if not os.path.isabs(stated):
        stated = os.path.relpath(here / stated, here / mission.output.path)
    file = path / stated
    read = {item["sha256"] for item in manifest["inputs"] if item["role"] == "observations"}
    is_it = file.suffix.lower() == ".db" and file.is_file() and hash_file(file) in read
    return file if is_it else None


def copy_of_run(place: Place) -> Path:
    """A copy in the user's cache of what is published at a place, as a folder; anew if replaced."""
    manifest = manifest_of_run(place)
    with suppress(FileNotFoundError, InputError):
        copy = remote.copy_of_attempt(place, manifest)
        if not find_damage(place, manifest, read=False):  # all was there until now
            with store.atomic_write(copy / MANIFEST) as draft:
                draft.write_text(manifest_text(manifest), encoding="utf-8")
            return copy
    if verify_run(place) == manifest:
        raise messages.input_changed(role="results", path=str(place))
    return copy_of_run(place)


def export_run(
    path: Path | Place,
    name: str,
    out: Path,
    options: Mapping[str, Any],
    *,
    ground_height_m: float | None = None,
    force: bool = False,
) -> tuple[int, Ledger]:
    """Write a finished run in a format, with its options; rows written, and what was left out."""
    form = find_format(name, out)
    values = form.values(options)
    if isinstance(path, Place):
        path = copy_of_run(path)
    refuse_output(path, out, force=force and bool(form.ending))
    ledger = Ledger()
    run = rebuild_run(path, verify_run(path), ground_height_m, ledger)
    with store.atomic_write(out) as draft:
        if not form.ending:
            draft.mkdir(parents=True)
        rows = form.write(run, values, draft, ledger)
        if form.use:
            ledger.note("EXPORT-USE", form.use, where=f"--format {name}")
        if form.marked:
            about = {"mission": run.mission, "notes": [entry.what for entry in ledger]}
            files = {file or out.name: draft / file for file in form.marked}
            beside = out if form.ending else draft / form.marked[0]
            with store.atomic_write(beside.with_name(beside.name + SIDECAR)) as sidecar:
                sidecar.write_text(sidecar_text(files, about), encoding="utf-8")
    return rows, ledger
