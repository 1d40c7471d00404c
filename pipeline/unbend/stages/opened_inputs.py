"""The opened inputs of a mission: tables as values, and readers that need values of the log."""

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
"""Reads a trajectory, or exposures with positions, as a channel.

Units and systems are those that the mission file states (`Stated`).
"""


class SoundingReader(Protocol):
    """Reads a sounding for the time and place of a flight."""

    def __call__(
        self, ledger: Ledger, *, time_ns: int | None, latitude_rad: float, station_h_m: float
    ) -> Sounding:
        """The sounding; if its file has several launches, the one nearest to the flight in time.

        ``time_ns`` and ``latitude_rad`` are those of the flight, the time None if unknown;
        ``station_h_m`` is the stated height of the launch site above sea level, NaN if not stated.
        """


class ElevationReader(Protocol):
    """Opens an elevation model, and converts ellipsoidal heights to heights above sea level.

    ``undulation`` gives the geoid's heights [m] (m,) at latitudes and longitudes [rad].
    """

    def __call__(
        self, *, undulation: Callable[[Array, Array], Array]
    ) -> tuple[ElevationModel, Notes]:
        """The model above sea level, and notes on it."""


class ModelReader(Protocol):
    """Reads the part of a weather model that surrounds a flight."""

    def __call__(self, area: FlightArea, ledger: Ledger) -> ModelField:
        """The fields in the area and time of the flight."""


@dataclass(frozen=True, eq=False)
class WeatherModel:
    """The name of a weather model's file, for messages, and the function that reads it."""

    name: str
    read: ModelReader


@dataclass(frozen=True, eq=False)
class ObjectPointTable:
    """The user's table of points: names (p,), and columns (p,) by quantity.

    ``where`` names the table in messages.
    """

    name: pa.StringArray
    columns: Mapping[str, Array]
    where: str


@dataclass(frozen=True, eq=False)
class KnownImagePositions:
    """Names of images (m,), and (m, 3) their latitude, longitude [rad] and height [m]."""

    image: Names
    position: Array


@dataclass(frozen=True, eq=False)
class BlockPoints:
    """Object points of a block: names (p,), and positions (p, 3) in the frame of its images.

    ``rows`` reads the block's image points, batch by batch.
    """

    name: pa.StringArray
    position: Array
    rows: Callable[[], Iterator[pa.RecordBatch]]


@dataclass(frozen=True, eq=False)
class OpenedInputs:
    """The inputs of a mission; None or empty for each that the mission file does not name.

    geoid : the user's own grid; without it the package's grid is used.
    camera_events : readers of exposures with positions, by camera.
    camera_names : the mission's name of each camera, by its name in the block.
    known_positions : of some images, which place the frame of a block or confirm it.
    block_places : positions of images that a block's files give in addition to its orientations.
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
