"""What an export format is: its name, its options, what it is given, and what it writes.

Formats are registered in exports/__init__.py.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    """Receiver of the progress of an export, for a progress bar."""

    def start(self, step: str, total: int | None = None) -> None:
        """Begin a step of ``total`` units."""

    def advance(self, count: int) -> None:
        """Add ``count`` finished units to the step."""


class NoProgress:
    """ExportProgress that discards everything."""

    def start(self, step: str, total: int | None = None) -> None:
        """Discard the step."""

    def advance(self, count: int) -> None:
        """Discard the units."""


NO_PROGRESS = NoProgress()


@dataclass(frozen=True)
class ExportCamera:
    """A camera in COLMAP's pixels, and what exports need to know of it.

    ``has_window`` : it looks through a plane window, which bends its rays. ``pixel_mm`` : width of
    its pixels, NaN if they are not square or it is unknown. ``has_refraction`` : its calibration
    was estimated in flight, on images with refraction in.
    """

    camera: Camera
    has_window: bool
    pixel_mm: float = np.nan
    has_refraction: bool = False


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A finished run as an exporter sees it, rebuilt from its folder.

    ``exposures`` has the rows of ``stations``. ``rays`` has one entry for each of ``air.profiles``,
    computed by the ``method`` of refraction. ``parts`` are the Parquet files of the observations,
    in order, with coordinates in the system ``pixels``; ``metadata`` goes into each file that is
    written. ``find_ground`` computes `ground_m` from the heights of all observations. ``database``
    returns the path of the COLMAP database that the run read its observations from (keypoints),
    None without an unchanged one; it reads the whole file. ``grid`` is the coordinate system of the
    export, None without one; ``progress`` gets each pass over observations and images.
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

    def usable_rows(self, camera: str) -> Integers:
        """(n,) the rows of the usable stations of a camera, in the order of ``stations``."""
        usable = (self.stations.camera == camera) & self.exposures.usable
        return np.flatnonzero(usable).astype(np.int64)

    @property
    def required_grid(self) -> MapGrid:
        """``grid``, for formats that always have a coordinate system; TypeError without one."""
        if self.grid is None:
            raise TypeError("this run was opened for a format without a coordinate system")
        return self.grid

    @cached_property
    def ground_m(self) -> Array:
        """(s,) ground height of each station's image [m above sea level], NaN if unknown."""
        return self.find_ground(self)

    def observations(
        self, columns: Sequence[str], most_rows: int | None = None
    ) -> Iterator[tuple[Integers, pa.Table]]:
        """The observations part by part: (n,) rows of their stations, and a table of ``columns``.

        The row of a station is -1 for an image without a station. With ``most_rows``, every k-th
        observation of each part, with k so large that about ``most_rows`` or fewer are read.
        """
        images_of_stations = pa.array(self.stations.image, pa.string())
        rows = sum(pq.read_metadata(part).num_rows for part in self.parts)
        step = 1
        if most_rows is not None:
            step += rows // most_rows
        self.progress.start("reading observations", rows)
        for part in self.parts:
            with pq.ParquetFile(part, read_dictionary=["image", "status"]) as file:
                table = file.read(["image", *columns], use_threads=False)[::step]
            images = table["image"].combine_chunks()
            yield matching_rows(images, images_of_stations), table.select(columns)
            self.progress.advance(table.num_rows * step)


@dataclass(frozen=True)
class Option:
    """An option of a format. The command line shows and parses it as it is declared here.

    ``name`` : its key in `Values`. ``kind`` : the type that its text is converted to.
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
        """The option on the command line: ``--name``, with ``-`` for ``_``."""
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
    """The size of a camera's pixels [mm]: that of `PIXEL_UM`, or if it is 0 that of the run.

    NaN if it is unknown.
    """
    size_of_option_mm = values[PIXEL_UM.name] * 1e-3
    if size_of_option_mm:
        return float(size_of_option_mm)
    return float(run.cameras[camera].pixel_mm)


@dataclass(frozen=True)
class GridUse:
    """How a format takes a coordinate system (--crs).

    ``default`` : the system without --crs, "" for none. ``needs_angles`` : the format has angles
    against the grid, so that a geographic system is refused. ``use`` : with --crs, the text that
    replaces the format's own ``use``.
    """

    default: str = ""
    needs_angles: bool = False
    use: str = ""


@dataclass(frozen=True)
class ExportFormat:
    """A format of ``unbend export``.

    ``contents`` : in words, for the help. ``ending`` : of its file; "" for a format of several
    files, which are written into a folder. ``write(run, values, path, ledger)`` writes the file at
    a path, or the files into the existing folder at it, and returns the number of rows; what is
    left out is entered in the ledger. ``frame(run, values)`` is the frame of what is written.
    ``use`` tells the user what to switch off in the program that reads it. ``marked`` : names of
    the files of observations without refraction in which no mark of that fits, so that the sidecar
    marks them; ("",) for a format of one file. ``grid`` : how a coordinate system is taken; None
    for a format with a fixed frame, which refuses --crs.
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

    def values(self, stated_values: Values) -> dict[str, Any]:
        """The value of each option: the stated one, or the default.

        Raises ``ConfigError`` for an option of other formats, and for a value beyond the limits.
        """
        options = {option.name: option for option in self.options}
        for name, value in stated_values.items():
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
        return {option.name: option.default for option in self.options} | dict(stated_values)


CORRECTIONS_USE = (
    "it contains refraction, but neither earth curvature nor a map projection: if it is applied, "
    "switch off the program's own correction of refraction (BINGO and Inpho have one; COLMAP, "
    "Metashape, Pix4D and ODM have none)"
)

Tables = tuple[pa.Schema, Iterator[pa.Table]]
"""The schema of a table, and the table in parts."""


def parquet_and_csv(
    name: str,
    contents: str,
    tables: Callable[[FinishedRun, Values, Ledger], Tables],
    options: tuple[Option, ...] = (),
) -> tuple[ExportFormat, ...]:
    """Two formats of one table of corrections: ``name`` is Parquet, ``name``-csv is CSV.

    ``tables(run, values, ledger)`` returns the schema, and the parts that are written one after the
    other.
    """

    def format_of(
        format_name: str,
        ending: str,
        write_stream: Callable[[Path, pa.Schema, Iterable[pa.Table]], int],
    ) -> ExportFormat:
        def write(run: FinishedRun, values: Values, path: Path, ledger: Ledger) -> int:
            schema, parts = tables(run, values, ledger)
            return write_stream(path, schema, parts)

        return ExportFormat(
            format_name,
            contents,
            ending,
            write,
            frame=frame_of_corrections,
            options=options,
            use=CORRECTIONS_USE,
        )

    return (
        format_of(name, ".parquet", write_parquet_stream),
        format_of(f"{name}-csv", ".csv", write_csv_stream),
    )


def frame_of_corrections(run: FinishedRun, _: Values) -> ExportFrame:
    """The frame of corrections: the run's image coordinates, ground heights above sea level."""
    return ExportFrame(pixels=pixels_of_run(run.pixels), ground_heights=SEA_LEVEL_OF_RUN)


def write_parquet_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """Write tables one after the other as one Parquet file; returns the number of rows."""
    rows = 0
    with pq.ParquetWriter(path, schema, **parquet_settings(schema)) as writer:
        for table in tables:
            writer.write_table(table)
            rows += table.num_rows
    return rows


def write_csv_stream(path: Path, schema: pa.Schema, tables: Iterable[pa.Table]) -> int:
    """Write tables one after the other as one CSV file; returns the number of rows.

    Null is an empty field. Numbers have as many digits as distinguish them from their neighbours.
    Arrow quotes all texts of a table or none: they are quoted if one contains a comma, a quotation
    mark or the end of a line.
    """
    rows = 0
    with path.open("wb") as file:
        file.write((",".join(schema.names) + "\n").encode())
        for table in tables:
            text_columns = [column for column in table.columns if pa.types.is_string(column.type)]
            words = [str(word) for column in text_columns for word in column.unique().to_pylist()]
            style = "needed" if any(set(word) & set('",\r\n') for word in words) else "none"
            options = pa_csv.WriteOptions(include_header=False, quoting_style=style)
            pa_csv.write_csv(table, file, options)
            rows += table.num_rows
    return rows
