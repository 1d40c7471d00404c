"""The files of a run's folder that hold its results, part by part, each whole at any time."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from unbend.batch.executors import Slices, Worker, make_parts
from unbend.batch.store import RunFolder, atomic_write
from unbend.errors import storage_errors
from unbend.flight.stations import Stations
from unbend.refraction.effect import FlightAir
from unbend.stages.correction import CorrectionSetup, correct_stream
from unbend.stages.statistics import Statistics
from unbend.tables.observations import Observations
from unbend.tables.writing import table_of_profiles, table_of_stations, write_parquet


@dataclass(frozen=True)
class PartsOfRun:
    """Parts as ``observations/part-*.parquet`` of a run, each with a receipt when it is written.

    ``check`` comes before each of the two: it refuses changed inputs, and a run that has ended.
    """

    folder: RunFolder
    check: Callable[[], None] = lambda: None
    verify: bool = True

    def finished(self, number: int) -> Statistics | None:
        """The counts of a part whose receipt says that it is whole; by its size unless verified."""
        found: Statistics | None = self.folder.read_receipt(_name(number), verify=self.verify)
        return found

    def write(self, number: int, table: pa.Table, statistics: Statistics) -> None:
        """Write, seal and receipt a part, whole at any time: another process may write it too."""
        name = _name(number)
        with atomic_write(self.folder.place(name)) as draft:
            write_parquet(table, draft)
            self.check()
        self.folder.seal(name)
        self.check()
        self.folder.write_receipt(name, statistics)


def _name(number: int) -> str:
    return f"observations/part-{number:05d}.parquet"


def parts_of(path: Path, batch_rows: int) -> int:
    """How many parts a table has that lets read slices of it alone (Parquet); 0 for others."""
    rows = 0
    if path.suffix.lower() == ".parquet":
        with suppress(OSError, pa.ArrowException):  # said where the table is opened
            rows = pq.read_metadata(path).num_rows
    return math.ceil(rows / batch_rows)


def correct_in_slices(
    observations: Observations,
    setup: CorrectionSetup,
    parts: PartsOfRun,
    *,
    workers: Sequence[Worker],
    progress: Callable[[int], None],
    **named: Any,
) -> Statistics:
    """`correct_stream` by several workers; counts are merged in order, the same to the last bit."""
    make = partial(correct_stream, observations, setup, **named)
    if not workers:
        return make(parts=parts, progress=progress)
    rows = observations.rows_of_part(named["batch_rows"])
    count = math.ceil(observations.rows / rows)
    missing = [number for number in range(count) if parts.finished(number) is None]
    with storage_errors(parts.folder.path):
        slices = Slices.of(parts.folder.staging, missing, len(workers))
        parts_of_workers = replace(parts, check=partial(check_wanted, slices, parts.check))
        make_all = partial(make, parts=parts_of_workers)
        make_parts(make_all, slices, workers, lambda made: progress(made * rows))
    # What a worker left unmade is made here.
    return make(parts=replace(parts, verify=False))


def check_wanted(slices: Slices, check: Callable[[], None]) -> None:
    """Raise OSError where the run that slices belong to has ended, then check."""
    (slices.folder / "setup").open("rb").close()
    check()


def write_tables(folder: RunFolder, stations: Stations, air: FlightAir) -> None:
    for name, table in (
        ("stations.parquet", table_of_stations(stations, air.series)),
        ("profile.parquet", table_of_profiles(air.adjustment, air.series)),
    ):
        write_parquet(table, folder.place(name))
        folder.seal(name)
