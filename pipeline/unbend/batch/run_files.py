"""The files of a run's folder that hold its results, part by part, each whole at any time."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass

from unbend.batch.store import RunFolder, atomic_write
from unbend.flight.stations import Stations
from unbend.refraction.effect import FlightAir
from unbend.stages.correction import CorrectedPart, correct_parts, number_of_parts
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.statistics import Statistics
from unbend.tables.observations import Observations
from unbend.tables.writing import table_of_profiles, table_of_stations, write_parquet


@dataclass(frozen=True)
class PartsOfRun:
    """The parts of a run's observations as files ``observations/part-*.parquet``.

    Each part that is finished has a receipt. ``check`` raises an error if an input was changed. It
    is called before a part gets its name, and again before its receipt is written.
    """

    folder: RunFolder
    check: Callable[[], None] = lambda: None

    def finished(self, number: int) -> Statistics | None:
        """The counts of a part that an earlier run finished; None if the part must be made."""
        statistics: Statistics | None = self.folder.read_receipt(name_of_part(number))
        return statistics

    def write(self, part: CorrectedPart) -> Statistics:
        """Write a part, seal it, and write its receipt; returns the counts of the part.

        Several threads call this at the same time.
        """
        name = name_of_part(part.number)
        with atomic_write(self.folder.place(name)) as draft:
            write_parquet(part.table, draft)
            self.check()
        self.folder.seal(name)
        self.check()
        self.folder.write_receipt(name, part.statistics)
        return part.statistics


def name_of_part(number: int) -> str:
    """The name of the file of a part, counted from 0, in the folder of a run."""
    return f"observations/part-{number:05d}.parquet"


def correct_into(
    parts: PartsOfRun,
    observations: Observations,
    setup: CorrectionSetup,
    *,
    batch_rows: int,
    metadata: Mapping[str, str],
    progress: Callable[[int], None] = lambda _: None,
) -> Statistics:
    """Correct all observations and write them; parts that an earlier run finished are kept.

    Returns the counts of all parts. They are merged in the order of the parts, so that the sum is
    the same to the last bit whichever run made a part. ``progress`` is called with the number of
    rows of every part.
    """
    finished: dict[int, Statistics] = {}
    missing = []
    count = number_of_parts(observations, batch_rows)
    for number in range(count):
        statistics = parts.finished(number)
        if statistics is None:
            missing.append(number)
        else:
            finished[number] = statistics
    counts_of_missing = correct_parts(  # a generator, in the order of ``missing``
        observations,
        setup,
        parts.write,
        numbers=missing,
        batch_rows=batch_rows,
        metadata=metadata,
    )
    total = Statistics.of(setup.cameras)
    with closing(counts_of_missing):
        for number in range(count):
            statistics = finished[number] if number in finished else next(counts_of_missing)
            total.merge(statistics)
            progress(statistics.rows)
    return total


def write_tables(folder: RunFolder, stations: Stations, air: FlightAir) -> None:
    """Write and seal the stations and the profiles of a run."""
    tables = {
        "stations.parquet": table_of_stations(stations, air.series),
        "profile.parquet": table_of_profiles(air.adjustment, air.series),
    }
    for name, table in tables.items():
        write_parquet(table, folder.place(name))
        folder.seal(name)
