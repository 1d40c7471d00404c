"""Missions with a mistake in them, derived from the samples as `tests/data/mistakes.yaml` says."""

from __future__ import annotations

import copy
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from scipy.spatial.transform import Rotation

from tests.stages.dataflash_records import Field, records
from tests.stages.oriented_tables import QUATERNION, attitudes, textbook_opk
from unbend.batch.runs import read_mission
from unbend.flight.stations import station_columns
from unbend.ingest import open_log

REPOSITORY = Path(__file__).resolve().parents[2]
SAMPLES = REPOSITORY / "sample_logs"
MISTAKES = REPOSITORY / "tests" / "data" / "mistakes.yaml"


@cache
def sample_sections(base: str) -> dict[str, Any]:
    text = (REPOSITORY / "configs" / f"{base}.yaml").read_text(encoding="utf-8")
    return yaml.safe_load(text)


def changed(sections: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """The sections of a mission file with other values under dotted keys; ``delete`` removes."""
    sections = copy.deepcopy(sections)
    for key, value in changes.items():
        *path, last = key.split(".")
        section = sections
        for part in path:
            section = section.setdefault(part, {})
        if value == "delete":
            section.pop(last, None)
        else:
            section[last] = value
    return sections


@cache
def stations_of(base: str) -> pd.DataFrame:
    """The stations of a sample mission, as `unbend stations --csv` writes them."""
    stations = read_mission(REPOSITORY / "configs" / f"{base}.yaml").stations
    return pd.DataFrame(station_columns(stations))


def orientation_of_sample() -> pd.DataFrame:
    """Omega, phi, kappa and places of the images of a sample mission, in degrees."""
    table = stations_of("sample_bin").copy()
    table[["omega_deg", "phi_deg", "kappa_deg"]] = textbook_opk(attitudes(table))
    return table


def write_observations(path: Path, recipe: str) -> None:
    table = pq.read_table(SAMPLES / "observations.parquet").replace_schema_metadata(None)
    rows = table.to_pandas()
    if recipe == "rotate images by 11":
        number = (rows["image"].str[-5:].astype(int) + 10) % 28 + 1
        rows["image"] = rows["image"].str[:-5] + number.map("{:05d}".format)
    else:
        rows = evaluated(rows, recipe)
    pq.write_table(pa.Table.from_pandas(rows, table.schema, preserve_index=False), path)


def evaluated(rows: pd.DataFrame, recipe: str) -> pd.DataFrame:
    """Assignments separated by semicolons, as `pandas.DataFrame.eval` understands them."""
    for assignment in filter(None, recipe.split("; ")):
        if assignment.startswith("drop "):
            rows = rows.drop(columns=assignment[5:])
        else:
            rows = rows.eval(assignment)
    return rows


def write_orientation(path: Path, recipe: str) -> None:
    rows = orientation_of_sample()
    if recipe == "reverse the first line":
        places = ["lat_deg", "lon_deg", "h_ellipsoid_m"]
        line = rows["image"].isin([f"nadir_{i:05d}" for i in range(1, 8)])
        rows.loc[line, places] = rows.loc[line, places].to_numpy()[::-1]
        recipe = ""
    rows = evaluated(rows, recipe)
    if "time_utc" in rows:
        rows["time_utc"] = iso(rows["time_utc"])
    rows.to_csv(path, index=False)


def write_quaternions(path: Path, recipe: str) -> None:
    assert recipe == "half turn about x"
    rows = stations_of("sample_bin").copy()
    w, x, y, z = rows[QUATERNION].to_numpy().T
    rows[QUATERNION] = np.stack([-x, w, -z, y], axis=1)  # (0,1,0,0) * q
    rows["time_utc"] = iso(rows["time_utc"])
    rows.to_csv(path, index=False)


def iso(times: pd.Series) -> pd.Series:
    return times.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def write_events(path: Path, recipe: str) -> None:
    rows = stations_of("sample_bin")[["image", "camera", "time_utc"]].copy()
    time = rows.pop("time_utc")
    if recipe == "gps week - 1":
        seconds = (time - pd.Timestamp("1980-01-06")).dt.total_seconds() + 18.0
        rows["gps_week"] = (seconds // 604800).astype(int) - 1
        rows["gps_seconds"] = (seconds % 604800).round(6)
    else:
        late = pd.Timedelta(seconds=7200 if recipe == "utc + 7200 s" else 0)
        rows["time_utc"] = iso(time + late)
    rows.to_csv(path, index=False)


def write_trajectory(path: Path, recipe: str) -> None:
    """Positions and attitudes of the log at 5 Hz, heights above the ellipsoid."""
    channels = {channel.name: channel for channel in open_log(SAMPLES / "flight.bin").channels}
    gps = channels["GPS[0]"]
    attitude = channels["ATT"]
    time_ns = attitude.time_ns[4:-4:2]
    late_ns = 18 * 10**9 if recipe == "+ 18 s" else 0
    quaternion = np.stack([attitude[f"q_{axis}"][4:-4:2] for axis in "xyzw"], axis=1)
    angles = Rotation.from_quat(quaternion).as_euler("ZYX", degrees=True)
    rows = pd.DataFrame(angles, columns=["yaw", "pitch", "roll"])
    rows["yaw"] %= 360.0
    rows["time_utc"] = iso(pd.Series(pd.to_datetime(time_ns + late_ns)))
    rows["lat"] = np.degrees(np.interp(time_ns, gps.time_ns, gps["lat_rad"]))
    rows["lon"] = np.degrees(np.interp(time_ns, gps.time_ns, gps["lon_rad"]))
    rows["h"] = np.interp(time_ns, gps.time_ns, gps["h_ellipsoid_m"])
    rows.to_csv(path, index=False, float_format="%.9f")


def write_sounding(path: Path, recipe: str) -> None:
    """The air of the flight; with a recipe that of a year before, 12 K colder."""
    year = 2024 if recipe else 2025
    colder = 12.0 if recipe else 0.0
    h_m = np.arange(400.0, 12001.0, 200.0)
    temperature_k = 294.15 - 0.0065 * (h_m - 400.0)
    exponent = 9.80665 * 0.0289644 / 8.31432 / 0.0065
    rows = pd.DataFrame({"h_m": h_m, "time_utc": f"{year}-06-12T09:00:00Z"})
    rows["pressure_hpa"] = (974.0 * (temperature_k / 294.15) ** exponent).round(2)
    rows["temperature_c"] = (temperature_k - 273.15 - colder).round(2)
    rows["dew_point_c"] = rows["temperature_c"] - 6.0
    rows["latitude_deg"] = 47.4
    rows["longitude_deg"] = 8.6
    rows.to_csv(path, index=False)


SHIFTS = {("GPS", "GMS"): -86_400_000, ("BARO", "Press"): 800.0, ("HYGR", "Temp"): 6.0}
REVERSED = {("ATT", "Roll"), ("ATT", "Pitch")}


def changed_value(field: Field, key: tuple[str, str], value: float) -> float:
    if key in REVERSED:
        return -value
    scale = 100.0 if field.letter in "cCeE" else 1
    return value + SHIFTS[key] * scale


def write_log(path: Path, recipe: str) -> None:
    """The flight a day earlier: pressure 8 hPa higher, air 6 K warmer, roll and pitch reversed."""
    assert recipe == "a day before"
    log = (SAMPLES / "flight.bin").read_bytes()
    changed = bytearray(log)
    names = {name for name, _ in (*SHIFTS, *REVERSED)}
    for record in records(log):
        if record.name not in names:
            continue
        fields = record.fields()
        is_first_sensor = "I" not in fields or log[fields["I"].start] == 0
        for column, field in fields.items():
            key = (record.name, column)
            if key in REVERSED or (key in SHIFTS and is_first_sensor):
                (value,) = struct.unpack_from(field.code, log, field.start)
                new = changed_value(field, key, value)
                struct.pack_into(field.code, changed, field.start, type(value)(new))
    path.write_bytes(changed)


WRITERS = {
    "observations": ("observations_mistake.parquet", write_observations),
    "orientation": ("orientation.csv", write_orientation),
    "quaternions": ("orientation.csv", write_quaternions),
    "events": ("events.csv", write_events),
    "trajectory": ("trajectory.csv", write_trajectory),
    "sounding": ("sounding.csv", write_sounding),
    "log": ("flight_mistake.bin", write_log),
}


def write_mistake(folder: Path, mistake: dict[str, Any]) -> Path:
    """The mission file of a mistake, with its changed inputs beside it."""
    sections = sample_sections(mistake["base"])
    for name in ("log", "observations"):
        sections[name]["path"] = str((REPOSITORY / "configs" / sections[name]["path"]).resolve())
    sections["output"]["path"] = "results"
    sections = changed(sections, mistake["mission"])
    log = sections.get("log", {}).get("path", "")
    if log.startswith("../sample_logs"):
        sections["log"]["path"] = str(SAMPLES / Path(log).name)
    for name, recipe in mistake.get("files", {}).items():
        file, write = WRITERS[name]
        write(folder / file, recipe)
    if sections["output"]["path"] != "results":
        sections["output"]["path"] = "results"
        (folder / "results").mkdir()
        other = {"mission": "sample_bin", "fingerprint": "0", "outputs": [], "exit_code": 0}
        (folder / "results" / "manifest.json").write_text(json.dumps(other), encoding="utf-8")
    path = folder / "mission.yaml"
    path.write_text(yaml.safe_dump(sections, sort_keys=False), encoding="utf-8")
    return path
