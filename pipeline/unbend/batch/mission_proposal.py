"""A commented mission file from a log, observations and images; what they leave open is TODO."""

import json
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from jinja2 import Environment, StrictUndefined

from unbend.batch import messages
from unbend.config.yaml_text import TODO
from unbend.errors import MissionError
from unbend.flight.channels import ROLE_COLUMNS, Channel
from unbend.flight.evidence.quality import plausible_samples
from unbend.flight.exposures import trigger_notes
from unbend.flight.heights import height_system
from unbend.flight.image_names import NameSeries, name_series
from unbend.flight.mount import is_of_gimbal
from unbend.flight.roles import assign_roles
from unbend.ingest import open_log
from unbend.ingest.flight_log import utc_text
from unbend.ingest.overview import flight_of
from unbend.messages import Ledger
from unbend.tables.delimited import csv_names
from unbend.tables.geodata.geoid import package_geoid
from unbend.tables.imports.blocks import block_reader, damage_refused
from unbend.tables.imports.exif import read_image_times
from unbend.tables.observations import Observations, open_observations

_MOST_CAMERAS, _BATCH_ROWS, _MOST_BATCHES = 12, 250_000, 4

_HEIGHT = re.compile(r"^(h|z)(_.*)?$|height|elev|^alt", re.IGNORECASE)
_OPENSFM = "reconstruction.json"  # stands for the folder of its project


@cache
def tables() -> Mapping[str, Any]:
    """Names and units of ``proposal.toml``."""
    return tomllib.loads(resources.files(__package__).joinpath("proposal.toml").read_text("utf-8"))


@dataclass(frozen=True)
class Proposed:
    """A key of the mission file: its value as YAML, and a remark."""

    key: str
    value: str
    remark: str = ""


@dataclass(frozen=True)
class ProposedCamera:
    """A camera with its exposures; ``block`` is its name in the block that has it."""

    name: str
    channel: Proposed | None = None
    image: Proposed | None = None
    block: str = ""


@dataclass
class FoundLog:
    """What a log decides: its roles, its channels of exposures, and remarks in sentences."""

    events: tuple[Channel, ...] = ()
    remarks: list[str] = field(default_factory=list)
    roles: list[Proposed] = field(default_factory=list)
    compartment: str = ""
    takeoff: str = ""
    gimbals: str = ""
    trigger: str = ""


@dataclass
class FoundTable:
    """What a table of observations, or a block, decides."""

    format: str = ""
    images: tuple[str, ...] = ()
    remark: str = ""
    columns: list[Proposed] = field(default_factory=list)
    size: str = ""
    height: Proposed = Proposed(
        "height", TODO, "metres; {column: NAME} of the observations; {dem: dem.tif}; intersected"
    )
    reference: str = TODO
    heights: str = ""
    cameras: tuple[str, ...] = ()


def yaml_text(text: str) -> str:
    """A text as a YAML scalar, in quotes where it needs them.

    >>> yaml_text("flight.bin"), yaml_text("CAM[0]"), yaml_text("no: 1"), yaml_text("12")
    ('flight.bin', '"CAM[0]"', '"no: 1"', '"12"')
    """
    plain = re.fullmatch(r"(?!(?i:true|false|null)$)[A-Za-z./][\w./-]*", text)
    return text if plain else json.dumps(text, ensure_ascii=False)


def block_format(path: Path) -> str:
    """The program whose block a file or folder is, by its files; empty for a file of none."""
    if path.is_dir():
        files = {"cameras.bin": "colmap", "cameras.txt": "colmap", _OPENSFM: "opensfm"}
        found = next((name for file, name in files.items() if (path / file).is_file()), "")
        if not found:
            raise messages.folder_is_no_block(where=path, files=", ".join(files))
        return found
    if path.suffix.lower() == ".xml" and path.is_file():
        head = path.read_bytes()[:4000].lower()
        return "dbat" if b"dbat" in head else "metashape"
    return {".psz": "metashape", ".db": "colmap"}.get(path.suffix.lower(), "")


def found_in_log(path: Path) -> FoundLog:
    """Read a log and decide what can be decided; refuses as `open_log`."""
    log, found = open_log(path), FoundLog()
    roles, notes = assign_roles(log.channels, {}, needs_cabin=False)
    plausible = {}
    for role, channel in roles.items():
        try:
            plausible[role] = plausible_samples(channel, role)[0]
        except MissionError as error:  # another unit than the log says
            found.roles.append(Proposed(role, TODO, f"{error.what}; {error.remedy}"))
    indoors = [entry.where for entry in notes if entry.code == "BARO-NOT-OUTSIDE"]
    found.compartment = ", ".join(indoors)
    asked = [entry.where.rpartition(".")[2] for entry in notes
             if entry.code in ("ROLE-AMBIGUOUS", "CHANNEL-MISSING")]  # fmt: skip
    for role in dict.fromkeys(asked):
        found.roles += questions_of_role(role, log.channels, found.compartment)
    listed = [f"{role} {channel.name}" for role, channel in roles.items() if role not in asked]
    first, last = utc_text(log.start_ns)[:19], utc_text(log.end_ns)[:19]
    minutes = log.duration_s / 60.0
    found.remarks = [f"{first} to {last} UTC, {minutes:.1f} minutes; {log.time_base}"]
    position, height = plausible.get("position"), plausible.get("height")
    if position is not None and len(position):
        lat, lon = (np.degrees(np.nanmedian(position[c])) for c in ("lat_rad", "lon_rad"))
        found.remarks.append(f"place: latitude {lat:.4f}, longitude {lon:.4f}")
    system, _ = height_system(plausible, None, package_geoid())
    if height is not None and height.height_column is not None:
        h = height[height.height_column]
        h = h[np.isfinite(h)]  # the column of a role has some
        above = "the sea" if height.height_column == "h_msl_m" else "the ellipsoid"
        home, of_home = system.home_h_msl_m, "the sea"
        if home is None and position is not None:
            home, of_home = flight_of(position, height).get("take_off_m"), above
        found.takeoff = "" if home is None else f"take-off {home:.0f} m above {of_home}"
        span = f"heights {h.min():.0f} to {h.max():.0f} m above {above} ({height.name})"
        found.remarks.append("; ".join(filter(None, (span, found.takeoff))))
    found.remarks.append(f"found by itself: {', '.join(listed)}")
    if indoors:
        why = "is in a closed compartment: it does not follow the height"
        found.remarks.append(f"{found.compartment} {why}")
    found.gimbals = ", ".join(c.name for c in log.channels if is_of_gimbal(c.source.message))
    found.events = best_of([c for c in log.channels if c.fits_role("events")])
    late = [c.name for c in found.events for entry in trigger_notes(log.channels, c)
            if entry.code == "EVENTS-TRIGGER-TIME"]  # fmt: skip
    late += [entry.where for entry in log.ledger if entry.code == "EVENTS-TRIGGER-TIME"]
    found.trigger = ", ".join(dict.fromkeys(late))
    return found


def best_of(channels: list[Channel]) -> tuple[Channel, ...]:
    """Those of the lowest rank."""
    best = min((c.rank for c in channels), default=0)
    return tuple(c for c in channels if c.rank == best)


def range_text(channel: Channel, role: str) -> str:
    """The range of a sensor's finite readings, in brackets; empty for other channels."""
    column = ROLE_COLUMNS[role][0]
    unit, factor, zero = tables()["units"].get(column, ("", 1.0, 0.0))
    values = channel[column]
    values = values[np.isfinite(values)] / factor - zero
    return f" ({values.min():.0f} to {values.max():.0f} {unit})" if unit and values.size else ""


def questions_of_role(role: str, channels: tuple[Channel, ...], compartment: str) -> list[Proposed]:
    """The questions about a role that several channels could play, or none."""
    able = best_of([c for c in channels if role in c.roles and c.fits_role(role)])
    if not able:
        none = f"no channel of the log has the {role}; null where stations.trajectory gives it"
        return [Proposed(role, TODO, none)]
    choices = " or ".join(c.name + range_text(c, role) for c in able)
    outside = Proposed(role, TODO, f"{choices}: the one outside; null to use none")
    if not compartment or not any(f"cabin_{role}" in c.roles for c in able):
        return [outside]
    inside = f"{choices}: the one in the compartment of {compartment}; null if there is none"
    return [outside, Proposed(f"cabin_{role}", TODO, inside)]


def found_in_table(path: Path) -> FoundTable:
    """Read a table of observations or a block; refuses as `open_observations`."""
    found, program = FoundTable(), block_format(path)
    if program:
        with damage_refused(path, program):
            found.cameras = tuple(block_reader(program).read_cameras(path))
        wanted: dict[str, str | None] = {name: name for name in tables()["columns"]}
        opened = open_observations(path, wanted, None, Ledger(), file_format=program)
        found.format, found.images = program, opened.images
        found.remark = f"{opened.rows} image points of {len(opened.images)} images"
        return found
    names = column_names(path)
    by_small = {name.lower(): name for name in reversed(names)}
    columns: dict[str, str | None] = {}
    for role, others in tables()["columns"].items():
        name = role if role in names else next((by_small[o] for o in others if o in by_small), None)
        columns[role] = name or role
        if names and name != role:
            choices = f"one of {', '.join(names)}" if name is None else "guessed by its name"
            found.columns.append(Proposed(role, yaml_text(name or TODO), choices))
    if any(column.value == TODO for column in found.columns):
        found.remark = "its images are not known until columns says which column has them"
        return found
    heights = [n for n in names if _HEIGHT.search(n) and n not in columns.values()]
    heights = ["h_g_m"] if "h_g_m" in heights else heights
    height = heights[0] if len(heights) == 1 else None
    opened = open_observations(path, columns, height, Ledger())
    found.images = opened.images
    found.remark = f"{opened.rows} rows of {len(opened.images)} images"
    if heights:
        value = f"{{column: {yaml_text(height) if height else TODO}}}"
        guessed = "" if height == "h_g_m" else "guessed by its name: heights of the points [m]"
        remark = guessed if height else f"one of {', '.join(heights)}"
        found.height = Proposed("height", value, remark)
    find_extent(opened, found)
    datums = {of for part, of in tables()["datums"].items() if height and part in height.lower()}
    if len(datums) == 1:
        found.reference = datums.pop()
        found.heights = f"guessed by the name of the column; {found.heights}"
    return found


def column_names(path: Path) -> list[str]:
    """The columns of a CSV or Parquet file; none of what is neither, or cannot be read."""
    if path.is_file() and path.suffix.lower() in (".csv", ".txt"):
        return csv_names(path)
    try:
        return list(pq.read_schema(path).names)
    except (OSError, ValueError):  # the reader of observations says what is wrong
        return []


def find_extent(opened: Observations, found: FoundTable) -> None:
    """Largest pixels and the heights of the first million rows, as remarks."""
    batches = list(islice(opened.batches(_BATCH_ROWS), _MOST_BATCHES))
    pixels = [np.concatenate([np.zeros(1), *(getattr(b, name) for b in batches)])
              for name in ("x_given_px", "y_given_px")]  # fmt: skip
    most, largest = np.nanpercentile(np.array(pixels), [99, 100], axis=1).round()
    found.size = f"99 % of the observations lie within {most[0]:.0f} x {most[1]:.0f} px, "
    found.size += f"all within {largest[0]:.0f} x {largest[1]:.0f}"
    ground = np.concatenate([np.empty(0), *(b.ground for b in batches if b.ground is not None)])
    if np.isfinite(ground).any():
        low, middle, high = np.nanpercentile(ground, [0.0, 50.0, 100.0])
        found.heights = f"the heights are {low:.0f} to {high:.0f} m, {middle:.0f} in the median"


def proposed_cameras(
    log: FoundLog | None, images: tuple[str, ...], of_block: tuple[str, ...] = ()
) -> list[ProposedCamera]:
    """The cameras by the names of the images, each with the channel that counts as they do."""
    events = () if log is None else log.events
    series = name_series(images)
    if len(series) > max(_MOST_CAMERAS, len(events)):
        series = [NameSeries("", 0, "", (0,), has_number=False)]
    if of_block and len(of_block) != len(series):
        series = []
    index = {c.name: c["event_index"].astype(int).tolist() for c in events}
    names: list[str] = []
    count = max(len(series) or (len(of_block) or len(events)), 1)
    cameras = []
    for number in range(count):
        one = series[number] if series else None
        name = (one.camera if one else "") or ("camera" if count == 1 else f"camera_{number + 1}")
        name = name if name not in names else f"{name}_{number + 1}"
        names.append(name)
        # The log's own numbers decide; where it has none, as many images as events do.
        counts = {"index": index, "n": {c: range(1, len(own) + 1) for c, own in index.items()}}
        fitting = {by: [c for c in of if one is not None and one.counts_as(of[c])]
                   for by, of in counts.items()}  # fmt: skip
        beside = {c: one.strays(own) for c, own in index.items()} if one is not None else {}
        if not any(fitting.values()):
            fitting["index"] = [c for c, far in beside.items() if far]
        by = next((by for by, found in fitting.items() if found), "*")
        fits = fitting.get(by, [])
        others = [s for s in series if s is not one]
        fired = [counts[by][c] for c in fits]
        rivals = any(s.counts_as(of) or s.strays(of) for s in others for of in fired)
        channel = image = None
        if one is None and count == len(events):
            remark = "guessed: a camera for each channel; name it by the camera that is fired"
            remark *= count > 1
            channel = Proposed("channel", yaml_text(events[number].name), remark)
        elif len(events) == count == 1 or (len(fits) == 1 and not rivals):
            channel = Proposed("channel", yaml_text(fits[0] if fits else events[0].name))
        elif events:
            listed = " or ".join(f"{c} ({len(index[c])} events)" for c in fits or index)
            channel = Proposed("channel", TODO, f"{listed}: which of them fires this camera")
        if events and one is None:
            remark = "names of its images; {index} is the log's number, as in IMG_{index:04d}.JPG"
            image = Proposed("image", TODO, remark)
        elif events and one is not None and fits:
            far = beside[fits[0]]
            like = [number for number in one.numbers if number not in far]
            remark = f"guessed: {len(like)} images count as the log does, {like[0]} to {like[-1]}"
            remark += f"; not {one.listed(far)}" * bool(far)
        elif events and one is not None:
            by_log = f"; or {one.pattern('index')}, if these are the log's numbers"
            remark = f"numbers and tie points assign {len(one.numbers)} images"
            remark += by_log * one.has_number
        if events and one is not None:
            image = Proposed("image", json.dumps(one.pattern(by), ensure_ascii=False), remark)
        block = of_block[number] if len(of_block) == count else ""
        cameras.append(ProposedCamera(name, channel, image, block))
    return cameras


def propose_mission(log: Path, observations: Path | None, images: Path | None, out: Path) -> str:
    """The text of a mission file, to be written to ``out``, from whose folder paths count.

    ``log`` may be a block with orientations, alone; ``images`` is a folder of images, or
    exiftool's table of them. Refuses (IMAGES-OTHER) images of which none is in the observations.
    """

    def relative(path: Path | None) -> str:
        if path is None:
            return TODO
        try:
            return yaml_text(Path(os.path.relpath(path, out.parent)).as_posix())
        except ValueError:  # another drive of Windows
            return yaml_text(str(path.absolute()))

    log = log.parent if log.name == _OPENSFM else log
    if observations is not None and observations.name == _OPENSFM:
        observations = observations.parent
    alone = observations is None and bool(block_format(log))
    found = None if alone else found_in_log(log)
    observations = log if alone else observations
    table = FoundTable() if observations is None else found_in_table(observations)
    times = None if images is None else read_image_times(images, "", Ledger())
    if times is not None and table.images and not times.rows_of(table.images):
        raise messages.other_images(
            where=images, absent=str(table.images[0]), present=str(times.file[0])
        )
    files = () if times is None else tuple(Path(str(name)).name for name in times.file)
    cameras = proposed_cameras(found, table.images or files, table.cameras)
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", log.stem).strip("-._")[:100] or "mission"
    template = resources.files(__package__).joinpath("mission.yaml.j2").read_text("utf-8")
    made = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    made.filters["remark"] = as_remark
    return made.from_string(template).render(
        mission=yaml_text(name), file=out.name, log=relative(log), found=found,
        observations=relative(observations), table=table, images=images and relative(images),
        zone="" if times is None or times.is_utc else TODO, cameras=cameras,
        has_reference=bool(observations and (observations / "reference_lla.json").is_file()),
    )  # fmt: skip


def as_remark(text: str) -> str:
    """A remark at the end of a line, on this line whatever it cites."""
    shown = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
    return f"  # {shown}" if shown else ""
