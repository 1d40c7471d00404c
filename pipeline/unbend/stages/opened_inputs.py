"""What a mission reads, opened: tables as values, and readers that wait for what the log says."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import pyarrow as pa

from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.soundings.model_field import ModelField
from unbend.block.known_places import KnownPlaces
from unbend.flight.channels import Channel
from unbend.geodesy import GeoidGrid
from unbend.ingest import Log
from unbend.messages import Ledger, Notes
from unbend.tables.geodata.elevation import ElevationModel
from unbend.tables.imports.exif import ImageTimes
from unbend.tables.imports.stated import Stated
from unbend.tables.imports.user_tables import EventTable, OrientationTable
from unbend.tables.model_fields import FlightArea
from unbend.tables.observations import Observations
from unbend.units import Array, Names

ChannelReader = Callable[[Stated, Ledger], Channel]
"""Reads a trajectory, or exposures with positions, by what the mission file states of it."""


class SoundingReader(Protocol):
    """Reads a sounding for the time and place of a flight."""

    def __call__(
        self, ledger: Ledger, *, time_ns: int | None, latitude_rad: float, station_h_m: float
    ) -> Sounding:
        """The sounding; of several launches in a file the one nearest in time."""


class ElevationReader(Protocol):
    """Opens an elevation model; ``undulation`` (m,) of places [rad] brings it to sea level."""

    def __call__(
        self, *, undulation: Callable[[Array, Array], Array]
    ) -> tuple[ElevationModel, Notes]:
        """The model, and what is to be said of it."""


class ModelReader(Protocol):
    """Reads the part of a weather model that lies about a flight."""

    def __call__(self, area: FlightArea, ledger: Ledger) -> ModelField:
        """The fields about the flight."""


@dataclass(frozen=True, eq=False)
class WeatherModel:
    """A file of a weather model, by its ``name``."""

    name: str
    read: ModelReader


@dataclass(frozen=True, eq=False)
class ObjectPointTable:
    """The user's table of points: names (p,), other columns by quantity; ``where`` it is from."""

    name: pa.StringArray
    columns: Mapping[str, Array]
    where: str


@dataclass(frozen=True, eq=False)
class KnownImagePositions:
    """Images, and (m, 3) their latitude, longitude [rad] and height [m]."""

    image: Names
    position: Array


@dataclass(frozen=True, eq=False)
class BlockPoints:
    """Object points of a block (p, 3) in the frame of its images; ``rows`` are its image points."""

    name: pa.StringArray
    position: Array
    rows: Callable[[], Iterator[pa.RecordBatch]]


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """The inputs of a mission; None, or empty, where the mission file names none.

    ``geoid`` is a grid of the user's own, ``camera_names`` the mission's cameras by what a block
    calls them, ``camera_events`` read exposures with positions, by camera, ``block_places`` where
    the files of blocks say that images were, beside their orientations.
    """

    observations: Observations
    log: Log | None = None
    geoid: GeoidGrid | None = None
    trajectory: ChannelReader | None = None
    camera_events: Mapping[str, ChannelReader] = field(default_factory=dict)
    events: EventTable | None = None
    image_times: ImageTimes | None = None
    orientation: OrientationTable | None = None
    camera_names: Mapping[str, str] = field(default_factory=dict)
    known_positions: KnownImagePositions | None = None
    block_places: tuple[KnownPlaces, ...] = ()
    block_points: BlockPoints | None = None
    object_points: ObjectPointTable | None = None
    control: ObjectPointTable | None = None
    elevation: ElevationReader | None = None
    soundings: tuple[SoundingReader, ...] = ()
    weather_model: WeatherModel | None = None
