"""The files of a run's folder that hold its results, part by part, each whole at any time."""

from collections.abc import Callable
from dataclasses import dataclass

import pyarrow as pa

from unbend.batch.store import RunFolder, atomic_write
from unbend.flight.stations import Stations
from unbend.refraction.effect import FlightAir
from unbend.stages.statistics import Statistics
from unbend.tables.writing import table_of_profiles, table_of_stations, write_parquet


@dataclass(frozen=True)
class PartsOfRun:
    """Parts as ``observations/part-*.parquet`` of a run, each with a receipt when it is written.

    ``check`` comes before each of the two: it refuses inputs that changed.
    """

    folder: RunFolder
    check: Callable[[], None] = lambda: None

    def finished(self, number: int) -> Statistics | None:
        """The counts of a part whose receipt says that it is whole."""
        found: Statistics | None = self.folder.read_receipt(_name(number))
        return found

    def write(self, number: int, table: pa.Table, statistics: Statistics) -> None:
        """Write, seal and receipt a part."""
        name = _name(number)
        with atomic_write(self.folder.place(name)) as draft:
            write_parquet(table, draft)
            self.check()
        self.folder.seal(name)
        self.check()
        self.folder.write_receipt(name, statistics)


def _name(number: int) -> str:
    return f"observations/part-{number:05d}.parquet"


def write_tables(folder: RunFolder, stations: Stations, air: FlightAir) -> None:
    """Write the tables of the stations and of the air."""
    tables = {
        "stations.parquet": table_of_stations(stations, air.series),
        "profile.parquet": table_of_profiles(air.adjustment, air.series),
    }
    for name, table in tables.items():
        write_parquet(table, folder.place(name))
        folder.seal(name)
