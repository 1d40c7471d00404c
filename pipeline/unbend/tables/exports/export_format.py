"""What an export format is: its name, its options, what it is given, and what it writes.

Formats are registered in exports/__init__.py.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from unbend.atmosphere.series.profile_series import ProfileSeries
from unbend.flight.stations import Stations
from unbend.messages import Ledger
from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import Exposures
from unbend.refraction.ray import PublishedRays
from unbend.refraction.ray_table import RayTable
from unbend.tables.exports import messages
from unbend.tables.exports.export_frames import SEA_LEVEL_OF_RUN, ExportFrame, pixels_of_run
from unbend.tables.geodata.map_grids import MapGrid
from unbend.tables.geodata.object_points import matching_rows
from unbend.tables.pixels import PixelSystem
from unbend.tables.writing import parquet_settings
from unbend.units import Array, Integers


class ExportProgress(Protocol):
    """What an export reports while it is written, for a bar with a share."""

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step of ``total`` units."""

    def advance(self, count: int) -> None:
        """Add ``count`` finished units to the step."""


class NoProgress:
    """ExportProgress that nobody looks at."""

    def start(self, step: str, total: int | None = None) -> None:
        """Discard the step."""

    def advance(self, count: int) -> None:
        """Discard the units."""


NO_PROGRESS = NoProgress()


@dataclass(frozen=True)
class ExportCamera:
    """A camera in COLMAP's pixels, and whether a window bends its rays.

    ``pixel_mm`` is the width of its pixels, where it is known; ``has_refraction`` says that its
    calibration was estimated in flight, on images with refraction in.
    """

    camera: Camera
    has_window: bool
    pixel_mm: float = np.nan
    has_refraction: bool = False


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A finished run as an exporter sees it, rebuilt from its folder.

    ``exposures`` has the rows of ``stations``. ``parts`` are the Parquet files of the observations,
    in order, with coordinates in the system ``pixels``; ``metadata`` goes into every file that is
    written. ``rays`` are those of ``air``'s profiles. ``find_ground`` reads heights of all
    observations; ``database`` finds COLMAP's, of which they are the keypoints, and reads all of it.
    ``grid`` is the coordinate system that results are asked for in, ``progress`` gets every pass
    over observations and images.
    """

    mission: str
    stations: Stations
    exposures: Exposures
    air: ProfileSeries
    rays: tuple[RayTable | PublishedRays, ...]
    method: str
    cameras: Mapping[str, ExportCamera]
    find_ground: Callable[["FinishedRun"], Array]
    pixels: PixelSystem
    parts: tuple[Path, ...]
    metadata: Mapping[str, str]
    database: Callable[[], Path | None] = lambda: None
    grid: MapGrid | None = None
    progress: ExportProgress = NO_PROGRESS

    def rows_of(self, camera: str) -> Integers:
        """(n,) the stations of a camera that can be used, in the order of the table."""
        usable = (self.stations.camera == camera) & self.exposures.usable
        return np.flatnonzero(usable).astype(np.int64)

    @property
    def required_grid(self) -> MapGrid:
        """The coordinate system, of a format that always has one."""
        if self.grid is None:
            raise TypeError("this run was opened for a format without a coordinate system")
        return self.grid

    @cached_property
    def ground_m(self) -> Array:
        """(s,) ground that images are computed for, above sea level [m], NaN where none is."""
        return self.find_ground(self)

    def observations(
        self, columns: Sequence[str], most_rows: int | None = None
    ) -> Iterator[tuple[Integers, pa.Table]]:
        """Stations (n,), -1 for none, and columns of all observations or ``most_rows``: parts."""
        names = pa.array(self.stations.image, pa.string())
        rows = sum(pq.read_metadata(part).num_rows for part in self.parts)
        every = 1
        if most_rows is not None:
            every += rows // most_rows
        self.progress.start("reading observations", rows)
        for part in self.parts:
            with pq.ParquetFile(part, read_dictionary=["image", "status"]) as file:
                table = file.read(["image", *columns], use_threads=False)[::every]
            yield matching_rows(table["image"].combine_chunks(), names), table.select(columns)
            self.progress.advance(table.num_rows * every)


@dataclass(frozen=True)
class Option:
    """An option of a format. The command line shows and parses it as it is declared here.

    ``name`` : in the mapping of values; on the command line ``--name``, ``_`` written as ``-``.
    ``default``, ``minimum``, ``maximum`` : in ``unit``, limits included.
    """

    name: str
    kind: type[int] | type[float]
    default: int | float
    help: str
    unit: str = ""
    minimum: float = -np.inf
    maximum: float = np.inf

    @property
    def flag(self) -> str:
        return "--" + self.name.replace("_", "-")


Values = Mapping[str, Any]
"""The value of every option of a format, by name."""

PIXEL_UM = Option(
    "pixel_um",
    float,
    default=0.0,
    help="size of a pixel for the tables in mm; 0: as in cameras.<name>.metric",
    unit="um",
    minimum=0.0,
    maximum=200.0,
)


def pixel_mm(run: FinishedRun, camera: str, values: Values) -> float:
    """The size of a camera's pixels [mm], by `PIXEL_UM`, else its own; NaN if unknown."""
    return float(values[PIXEL_UM.name] * 1e-3 or run.cameras[camera].pixel_mm)


@dataclass(frozen=True)
class GridUse:
    """How a format takes a coordinate system.

    ``default`` : the system where none is asked for, "" for none. ``needs_angles`` : it has angles
    against the grid. ``use`` : what is said of the export in place of the format's own ``use``.
    """

    default: str = ""
    needs_angles: bool = False
    use: str = ""


@dataclass(frozen=True)
class ExportFormat:
    """A format: its name, what it holds in words, the ending of its file, its writer, its options.

    ``write(run, values, path, ledger)`` writes one file at a path, or several into the folder that
    is there where the ending is "", and returns the number of rows; what is left out is entered in
    the ledger. ``use`` says in which frame it is, and what is to be switched off in the program
    that reads it. ``marked`` are the names of the files that hold observations without refraction
    and cannot say so, of a format of one file "". ``frame(run, values)`` is the frame of what is
    written; ``grid`` how a coordinate system is taken, None where there is one that fits alone.
    """

    name: str
    contents: str
    ending: str
    write: Callable[[FinishedRun, Values, Path, Ledger], int]
    frame: Callable[[FinishedRun, Values], ExportFrame]
    options: tuple[Option, ...] = ()
    use: str = ""
    marked: tuple[str, ...] = ()
    grid: GridUse | None = None

    def values(self, given: Values) -> dict[str, Any]:
        """The value of every option, given or by default.

        Raises ``ConfigError`` for an option of other formats, and for a value beyond the limits.
        """
        options = {option.name: option for option in self.options}
        for name, value in given.items():
            option = options.get(name)
            if option is None:
                raise messages.option_unknown(
                    where="--" + name.replace("_", "-"),
                    name=self.name,
                    options=", ".join(o.flag for o in self.options) or "none",
                )
            if not option.minimum <= value <= option.maximum:
                raise messages.option_out_of_range(
                    where=option.flag,
                    given=value,
                    lowest=option.minimum,
                    highest=option.maximum,
                    meaning=f"{option.help} [{option.unit}]" if option.unit else option.help,
                )
        return {option.name: option.default for option in self.options} | dict(given)


CORRECTIONS_USE = (
    "it contains refraction, but neither earth curvature nor a map projection: if it is applied, "
    "switch off the program's own correction of refraction (BINGO and Inpho have one; COLMAP, "
    "Metashape, Pix4D and ODM have none)"
)

Tables = tuple[pa.Schema, Iterator[pa.Table]]


def parquet_and_csv(
    name: str,
    contents: str,
    tables: Callable[[FinishedRun, Values, Ledger], Tables],
    options: tuple[Option, ...] = (),
) -> tuple[ExportFormat, ...]:
    """One table in two formats: ``name`` is written as Parquet, ``name``-csv as CSV.

    ``tables`` returns the schema and the tables that are written one after the other. They hold
    corrections, which `CORRECTIONS_USE` is about.
    """

    def write(
        writer: Callable[..., int],
        run: FinishedRun,
        values: Values,
        path: Path,
        ledger: Ledger,
    ) -> int:
        return writer(path, *tables(run, values, ledger))

    kinds = (name, ".parquet", write_parquet_stream), (f"{name}-csv", ".csv", write_csv_stream)
    return tuple(
        ExportFormat(
            form,
            contents,
            ending,
            partial(write, writer),
            frame=frame_of_corrections,
            options=options,
            use=CORRECTIONS_USE,
        )
        for form, ending, writer in kinds
    )


def frame_of_corrections(run: FinishedRun, _: Values) -> ExportFrame:
    """Image coordinates as the run has them, and heights above sea level."""
    return ExportFrame(pixels=pixels_of_run(run.pixels), ground_heights=SEA_LEVEL_OF_RUN)


def write_parquet_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """One Parquet file of all the tables; the number of rows."""
    rows = 0
    with pq.ParquetWriter(path, schema, **parquet_settings(schema)) as writer:
        for table in tables:
            writer.write_table(table)
            rows += table.num_rows
    return rows


def write_csv_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """One CSV file of all the tables, null as nothing; the number of rows.

    Numbers have all the digits that tell them apart. Arrow quotes all text or none: the text of a
    table is quoted where a value holds a comma, a quotation mark or the end of a line.
    """
    rows = 0
    with path.open("wb") as file:
        file.write((",".join(schema.names) + "\n").encode())
        for table in tables:
            texts = [column for column in table.columns if pa.types.is_string(column.type)]
            words = [str(word) for column in texts for word in column.unique().to_pylist()]
            style = "needed" if any(set(word) & set('",\r\n') for word in words) else "none"
            options = pa_csv.WriteOptions(include_header=False, quoting_style=style)
            pa_csv.write_csv(table, file, options)
            rows += table.num_rows
    return rows
