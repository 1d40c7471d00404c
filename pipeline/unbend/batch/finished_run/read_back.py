"""Mission, stations and profiles as values, from the files of a finished run."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import ValidationError

from unbend.atmosphere.layers import Layers
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.refractive_index import IndexModel
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.batch.finished_run import messages
from unbend.config import Mission
from unbend.config.mistakes import sentences_of
from unbend.flight.stations import NO_TIME, SUSPECT, Stations
from unbend.geodesy import Gravity
from unbend.tables.manifest.file_names import MANIFEST
from unbend.tables.manifest.whole import Manifest
from unbend.units import Array, Names


def mission_of(manifest: Manifest, path: Path) -> Mission:
    """The mission as the run understood it, from its manifest; ``path`` is the run's folder."""
    try:
        # As JSON text: a strict model refuses some values of JSON as Python objects, such as lists.
        config = json.dumps(manifest.run.config)
        return Mission.model_validate_json(config)
    except ValidationError as error:
        raise messages.config_not_understood(
            path=str(path / MANIFEST),
            mistakes=error.error_count(),
            first=first_mistake(error, dict(manifest.run.config)),
        ) from None


def first_mistake(error: ValidationError, config: dict[str, Any]) -> str:
    """A sentence on the first key of a mission file that its model refuses; "" if there is none."""
    sentences = sentences_of(
        error.errors(include_url=False),
        config,
        node=None,
    )
    return sentences[0] if sentences else ""


def numbers_of(table: pa.Table, name: str) -> Array:
    """(k,) numbers of a column; NaN for null."""
    values = table[name].to_numpy()
    return np.asarray(values, dtype=np.float64)


class _Columns:
    """The columns of ``stations.parquet``, which an older version may have written."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def number(self, name: str) -> Array:
        """(s,) numbers; NaN where the table has no such column."""
        if name not in self._table.schema.names:
            return np.full(self._table.num_rows, np.nan)
        return numbers_of(self._table, name)

    def angle(self, name: str) -> Array:
        """(s,) angles [rad] of a column in degrees."""
        return np.radians(self.number(f"{name}_deg"))

    def quaternion(self, prefix: str) -> Array:
        """(s, 4) quaternions, w first."""
        components = [self.number(f"{prefix}_{axis}") for axis in "wxyz"]
        return np.stack(components, axis=1)

    def text(self, name: str) -> Names:
        """(s,) texts; "" for null, and if the table has no such column."""
        if name not in self._table.schema.names:
            return np.full(self._table.num_rows, "", dtype=object)
        values = self._table[name].to_pylist()
        texts = [value or "" for value in values]
        return np.array(texts, dtype=object)


def stations_of(table: pa.Table) -> Stations:
    """Stations from the table of ``stations.parquet``; the inverse of `table_of_stations`."""
    columns = _Columns(table)
    time_utc = table["time_utc"].cast(pa.int64())
    time_ns = pc.fill_null(time_utc, int(NO_TIME))
    status = columns.text("status")
    has_profile = table["profile_id"].is_valid()  # a suspect station has one only if accepted
    is_suspect = status == SUSPECT
    derived: dict[str, Any] = {
        "time_ns": time_ns.to_numpy().astype(np.int64),
        "quaternion": columns.quaternion("q"),
        "aircraft_quaternion": columns.quaternion("aircraft_q"),
        "status": status,
        "from_boot": np.zeros(0, np.bool_),  # not in the table: `Stations` makes it False for all
        "accepted": is_suspect & has_profile.to_numpy(),
    }
    for name in ("lat", "lon", "sigma_tilt", "sigma_yaw"):
        derived[f"{name}_rad"] = columns.angle(name)
    for name in ("image", "camera", "suspect_reason"):
        derived[name] = columns.text(name)
    for field in fields(Stations):
        if field.name not in derived:
            derived[field.name] = columns.number(field.name)
    return Stations(**derived)


def air_of(table: pa.Table, profile_id: pa.ChunkedArray) -> ProfileSeries:
    """The profiles of ``profile.parquet``, and the number of each station's profile.

    ``profile_id`` (s,) is the identifier of the profile of each station; a station with null, or
    with an identifier that is not in the table, gets the first profile.
    """
    id_of_row = table["profile_id"]
    ids = pc.unique(id_of_row)
    profiles = []
    for identifier in ids:
        rows = table.filter(pc.equal(id_of_row, identifier))
        profile = profile_of(rows)
        profiles.append(TimedProfile(None, profile))
    number = pc.index_in(profile_id, value_set=ids)
    number = pc.fill_null(number, 0).to_numpy()
    return ProfileSeries(tuple(profiles), np.asarray(number, dtype=np.int64))


def text_metadata(table: pa.Table) -> dict[str, str]:
    """The metadata of a table as texts."""
    texts = {}
    for key, value in table.schema.metadata.items():
        texts[key.decode()] = value.decode()
    return texts


def profile_of(table: pa.Table) -> Profile:
    """The profile from its rows in ``profile.parquet``; the inverse of `table_of_profile`.

    The rows are the layers at their lower edges and then the top of the last layer, which repeats
    the base values of that layer. The refractivity is that of the run to 1e-15 of itself (6e-16 in
    the sample runs).
    """
    metadata = text_metadata(table)
    lower_edges = table.slice(0, table.num_rows - 1)  # without the last row, the top
    top_m = numbers_of(table, "geopotential_m")[-1]
    edge_m = np.append(numbers_of(lower_edges, "geopotential_base_m"), top_m)
    vapour_pa = numbers_of(table, "vapour_pressure_pa")
    vapour_at_edge = vapour_pa / numbers_of(table, "pressure_pa")
    vapour_slope = np.diff(vapour_at_edge) / np.diff(edge_m)
    layers = Layers(
        edge=edge_m,
        temperature=numbers_of(lower_edges, "t_base_k"),
        lapse=numbers_of(lower_edges, "lapse_k_per_m"),
        pressure=numbers_of(lower_edges, "p_base_pa"),
        vapour=vapour_at_edge[:-1],
        vapour_slope=vapour_slope,
        source=tuple(lower_edges["source"].to_pylist()),
    )
    latitude = None
    if metadata["latitude"]:
        latitude_deg = float(metadata["latitude"])
        latitude = float(np.radians(latitude_deg))
    index = IndexModel(
        metadata["unbend.index"],
        float(metadata["unbend.wavelength_m"]),
        float(metadata["unbend.co2_ppm"]),
    )
    gravity = Gravity(
        g_phi=float(metadata["g_phi"]),
        r_phi=float(metadata["r_phi"]),
        latitude_rad=latitude,
    )
    name = "adjusted"
    if metadata["unbend.basis"] == "standard":
        name = metadata["unbend.standard"]
    constant_k_per_m = float(metadata["unbend.constant_k_per_m"])
    return Profile(layers, gravity, index, name, constant_k_per_m)
