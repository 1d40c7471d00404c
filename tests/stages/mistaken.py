"""Missions with a mistake in them, derived from the samples as `tests/data/mistakes.yaml` says."""

import json
from copy import deepcopy
from functools import cache

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from scipy.spatial.transform import Rotation

from tests.logs import REPOSITORY
from tests.stages.block_files import PLACE
from tests.stages.dataflash_records import records, value_of, write_value
from tests.stages.flown_files import gps_time
from tests.stages.oriented_tables import QUATERNION, attitudes, textbook_opk
from tests.weather_texts import sounding_text
from unbend.batch.runs import read_mission
from unbend.flight.stations import station_columns
from unbend.ingest import open_log

CONFIGS = REPOSITORY / "configs"
SAMPLES = REPOSITORY / "sample_logs"
MISTAKES = REPOSITORY / "tests" / "data" / "mistakes.yaml"


@cache
def sample_sections(base):
    text = (CONFIGS / f"{base}.yaml").read_text()
    return yaml.safe_load(text)


def changed(sections, changes):
    """The sections of a mission file with other values under dotted keys; ``delete`` removes."""
    sections = deepcopy(sections)
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
def stations_of(base):
    """The stations of a sample mission, as `unbend stations --csv` writes them."""
    prepared = read_mission(CONFIGS / f"{base}.yaml")
    return pd.DataFrame(station_columns(prepared.stations))


def orientation_of_sample():
    """Omega, phi, kappa and places of the images of a sample mission, in degrees."""
    table = stations_of("sample_bin").copy()
    table[["omega_deg", "phi_deg", "kappa_deg"]] = textbook_opk(attitudes(table))
    return table


def write_observations(path, recipe):
    table = pq.read_table(SAMPLES / "observations.parquet").replace_schema_metadata(None)
    rows = table.to_pandas()
    if recipe == "rotate images by 11":
        camera = rows["image"].str[:-5]
        number = rows["image"].str[-5:].astype(int)
        rotated = (number + 10) % 28 + 1
        rows["image"] = camera + rotated.map("{:05d}".format)
    else:
        rows = evaluated(rows, recipe)
    changed = pa.Table.from_pandas(rows, table.schema, preserve_index=False)
    pq.write_table(changed, path)


def evaluated(rows, recipe):
    """Assignments separated by semicolons, as `pandas.DataFrame.eval` understands them."""
    for assignment in recipe.split("; "):
        if assignment.startswith("drop "):
            rows = rows.drop(columns=assignment[5:])
        elif assignment:
            rows = rows.eval(assignment)
    return rows


def write_orientation(path, recipe):
    rows = orientation_of_sample()
    if recipe == "reverse the first line":
        first_line = rows["image"].between("nadir_00001", "nadir_00007")
        places = rows.loc[first_line, PLACE].to_numpy()
        rows.loc[first_line, PLACE] = places[::-1]
    else:
        rows = evaluated(rows, recipe)
    if "time_utc" in rows:
        rows["time_utc"] = iso(rows["time_utc"])
    rows.to_csv(path, index=False)


def write_quaternions(path, recipe):
    assert recipe == "half turn about x"
    rows = stations_of("sample_bin").copy()
    w, x, y, z = rows[QUATERNION].to_numpy().T
    rows[QUATERNION] = np.stack([-x, w, -z, y], axis=1)  # (0,1,0,0) * q
    rows["time_utc"] = iso(rows["time_utc"])
    rows.to_csv(path, index=False)


def iso(times):
    return times.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def write_events(path, recipe):
    stations = stations_of("sample_bin")
    rows = stations[["image", "camera"]].copy()
    time = stations["time_utc"]
    if recipe == "gps week - 1":
        week, seconds = gps_time(time.dt.tz_localize("UTC"))
        rows["gps_week"] = week - 1
        rows["gps_seconds"] = seconds.round(6)
    else:
        if recipe == "utc + 7200 s":
            time = time + pd.Timedelta(seconds=7200)
        rows["time_utc"] = iso(time)
    rows.to_csv(path, index=False)


def write_trajectory(path, recipe):
    """Positions and attitudes of the log at 5 Hz, heights above the ellipsoid."""
    log = open_log(SAMPLES / "flight.bin")
    channels = {channel.name: channel for channel in log.channels}
    gps = channels["GPS[0]"]
    attitude = channels["ATT"]
    every_other = slice(4, -4, 2)
    time_ns = attitude.time_ns[every_other]
    quaternion = np.stack([attitude[name] for name in QUATERNION], axis=1)
    rotation = Rotation.from_quat(quaternion[every_other], scalar_first=True)
    angles = rotation.as_euler("ZYX", degrees=True)

    def at_attitudes(name):
        return np.interp(time_ns, gps.time_ns, gps[name])

    rows = pd.DataFrame(angles, columns=["yaw", "pitch", "roll"])
    rows["yaw"] %= 360.0
    time = pd.Series(pd.to_datetime(time_ns))
    if recipe == "+ 18 s":
        time += pd.Timedelta(seconds=18)
    rows["time_utc"] = iso(time)
    rows["lat"] = np.degrees(at_attitudes("lat_rad"))
    rows["lon"] = np.degrees(at_attitudes("lon_rad"))
    rows["h"] = at_attitudes("h_ellipsoid_m")
    rows.to_csv(path, index=False, float_format="%.9f")


def write_sounding(path, recipe):
    """The air of the flight; with a recipe that of a year before, 12 K colder."""
    year = 2025
    offset_k = 0.0
    if recipe:
        year = 2024
        offset_k = -12.0
    text = sounding_text(
        offset_k,
        time_utc=f"{year}-06-12T09:00:00Z",
        latitude_deg=47.4,
        longitude_deg=8.6,
    )
    path.write_text(text)


SHIFTS = {
    ("GPS", "GMS"): -86_400_000,
    ("BARO", "Press"): 800.0,
    ("HYGR", "Temp"): 6.0,
}
REVERSED = {("ATT", "Roll"), ("ATT", "Pitch")}


def changed_value(field, key, value):
    if key in REVERSED:
        return -value
    shift = SHIFTS[key]
    if field.letter in "cCeE":  # hundredths
        shift *= 100.0
    return value + shift


def write_log(path, recipe):
    """The flight a day earlier: pressure 8 hPa higher, air 6 K warmer, roll and pitch reversed."""
    assert recipe == "a day before"
    log = (SAMPLES / "flight.bin").read_bytes()
    changed = bytearray(log)
    names = {name for name, _ in SHIFTS.keys() | REVERSED}
    for record in records(log):
        if record.name not in names:
            continue
        fields = record.fields()
        is_first_sensor = "I" not in fields or value_of(log, fields["I"]) == 0
        for column, field in fields.items():
            key = (record.name, column)
            if key in REVERSED or (key in SHIFTS and is_first_sensor):
                value = value_of(log, field)
                new = changed_value(field, key, value)
                write_value(changed, field, type(value)(new))
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


def write_mistake(folder, mistake):
    """The mission file of a mistake, with its changed inputs beside it."""
    sections = sample_sections(mistake["base"])
    for name in ("log", "observations"):
        source = sections[name]
        path = CONFIGS / source["path"]
        source["path"] = str(path.resolve())
    sections["output"]["path"] = "results"
    sections = changed(sections, mistake["mission"])
    log = sections.get("log", {})
    if log.get("path", "").startswith("../sample_logs"):
        log["path"] = str((CONFIGS / log["path"]).resolve())
    recipes = mistake.get("files", {})
    for name, recipe in recipes.items():
        file, write = WRITERS[name]
        write(folder / file, recipe)
    if sections["output"]["path"] != "results":
        sections["output"]["path"] = "results"
        manifest = folder / "results" / "manifest.json"
        manifest.parent.mkdir()
        other = {
            "mission": "sample_bin",
            "fingerprint": "0",
            "outputs": [],
            "exit_code": 0,
        }
        manifest.write_text(json.dumps(other))
    path = folder / "mission.yaml"
    text = yaml.safe_dump(sections, sort_keys=False)
    path.write_text(text)
    return path
