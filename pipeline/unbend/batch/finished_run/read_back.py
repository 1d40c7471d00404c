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
from unbend.flight.stations import NO_TIME, SUSPECT, Stations
from unbend.geodesy import Gravity
from unbend.tables.manifest.file_names import MANIFEST
from unbend.tables.manifest.whole import Manifest
from unbend.units import Array, Names


def mission_of(manifest: Manifest, path: Path) -> Mission:
    """The mission file as the run understood it, from its manifest."""
    try:
        # As text, because strict models take from JSON what they gave to it.
        config = json.dumps(manifest.run.config)
        return Mission.model_validate_json(config)
    except ValidationError as error:
        raise messages.config_not_understood(
            path=str(path / MANIFEST), mistakes=error.error_count()
        ) from None


class _Columns:
    """The columns of ``stations.parquet``, which an older version may have written."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def number(self, name: str) -> Array:
        """(s,) numbers; NaN where the table has no such column."""
        if name not in self._table.schema.names:
            return np.full(self._table.num_rows, np.nan)
        return np.asarray(self._table[name].to_numpy(), dtype=np.float64)

    def angle(self, name: str) -> Array:
        """(s,) angles [rad] of a column in degrees."""
        return np.radians(self.number(f"{name}_deg"))

    def quaternion(self, prefix: str) -> Array:
        """(s, 4) quaternions, w first."""
        return np.stack([self.number(f"{prefix}_{axis}") for axis in "wxyz"], axis=1)

    def text(self, name: str) -> Names:
        """(s,) texts; empty where there is none."""
        values: list[str | None] = [None] * self._table.num_rows
        if name in self._table.schema.names:
            values = self._table[name].to_pylist()
        return np.array([value or "" for value in values], dtype=object)


def stations_of(table: pa.Table) -> Stations:
    """Stations from the table of ``stations.parquet``; the inverse of `table_of_stations`."""
    columns = _Columns(table)
    time_utc = table["time_utc"].cast(pa.int64())
    time = pc.fill_null(time_utc, int(NO_TIME)).to_numpy()
    status = columns.text("status")
    has_profile = table["profile_id"].is_valid().to_numpy()  # of suspect ones only those accepted
    derived: dict[str, Any] = {
        "time_ns": time.astype(np.int64),
        "quaternion": columns.quaternion("q"),
        "aircraft_quaternion": columns.quaternion("aircraft_q"),
        "status": status,
        "from_boot": np.zeros(0, np.bool_),  # not in the table: `Stations` makes it False for all
        "accepted": (status == SUSPECT) & has_profile,
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
    """Profiles of ``profile.parquet``, and which is each station's: the first if it has none."""
    names = pc.unique(table["profile_id"])
    profiles = []
    for name in names:
        of_profile = table.filter(pc.equal(table["profile_id"], name))
        profiles.append(TimedProfile(None, profile_of(of_profile)))
    number = pc.fill_null(pc.index_in(profile_id, value_set=names), 0)
    return ProfileSeries(tuple(profiles), np.asarray(number.to_numpy(), dtype=np.int64))


def profile_of(table: pa.Table) -> Profile:
    """The profile from a table as in ``profile.parquet``; the inverse of `table_of_profile`.

    The rows are the layers at their lower edges and then the top of the last layer, which repeats
    the base values of that layer. The refractivity is that of the run to 1e-15 of itself (6e-16 in
    the sample runs).
    """
    metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}

    def column(name: str) -> Array:
        return np.asarray(table[name].to_numpy(), dtype=np.float64)

    lower_edges = slice(None, -1)  # without the last row, the top
    top_m = column("geopotential_m")[-1]
    edge_m = np.append(column("geopotential_base_m")[lower_edges], top_m)
    vapour_at_edge = column("vapour_pressure_pa") / column("pressure_pa")
    layers = Layers(
        edge=edge_m,
        temperature=column("t_base_k")[lower_edges],
        lapse=column("lapse_k_per_m")[lower_edges],
        pressure=column("p_base_pa")[lower_edges],
        vapour=vapour_at_edge[lower_edges],
        vapour_slope=np.diff(vapour_at_edge) / np.diff(edge_m),
        source=tuple(table["source"].to_pylist()[lower_edges]),
    )
    latitude = None
    if metadata["latitude"]:
        latitude = float(np.radians(float(metadata["latitude"])))
    index = IndexModel(
        metadata["unbend.index"],
        float(metadata["unbend.wavelength_m"]),
        float(metadata["unbend.co2_ppm"]),
    )
    gravity = Gravity(float(metadata["g_phi"]), float(metadata["r_phi"]), latitude)
    name = "adjusted"
    if metadata["unbend.basis"] == "standard":
        name = metadata["unbend.standard"]
    return Profile(layers, gravity, index, name, float(metadata["unbend.constant_k_per_m"]))
