"""A commented mission file from a log, observations and images; what they leave open is TODO."""

import os
import re
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined, Template

from unbend.batch import messages
from unbend.batch.proposal.log_facts import facts_of_log
from unbend.batch.proposal.proposed_cameras import proposed_cameras
from unbend.batch.proposal.table_facts import (
    OPENSFM_FILE,
    TableFacts,
    block_format,
    facts_of_observations,
)
from unbend.batch.proposal.values import yaml_text
from unbend.config.yaml_text import TODO
from unbend.messages import Ledger
from unbend.tables.imports.exif import ImageTimes, read_image_times

LONGEST_NAME = 100  # characters of a mission's name


def propose_mission(log: Path, observations: Path | None, images: Path | None, out: Path) -> str:
    """The text of a mission file that will be written to ``out``; it is not written here.

    Paths in it are relative to the folder of ``out``. ``log`` may be a block with orientations:
    without ``observations`` the block also has these, and no log is read. ``images`` is a folder of
    images, or exiftool's table of them. Refuses (IMAGES-OTHER) images if none of them is in the
    observations.
    """
    log = folder_of_project(log)
    observations = None if observations is None else folder_of_project(observations)
    if observations is None and block_format(log):
        observations = log
        log_facts = None
    else:
        log_facts = facts_of_log(log)
    table = TableFacts() if observations is None else facts_of_observations(observations)

    names = table.images
    zone = ""
    if images is not None:
        times = read_image_times(images, "", Ledger())
        refuse_other_images(images, times, table.images)
        names = table.images or tuple(Path(str(file)).name for file in times.file)
        zone = "" if times.is_utc else TODO
    channels = () if log_facts is None else log_facts.events
    has_reference = False
    if observations is not None:
        has_reference = (observations / "reference_lla.json").is_file()
    name = mission_name(log)
    return mission_template().render(
        mission=yaml_text(name),
        results=yaml_text(f"results/{name}"),
        file=out.name,
        log=path_text(log, out),
        log_facts=log_facts,
        observations=path_text(observations, out),
        table=table,
        images=None if images is None else path_text(images, out),
        zone=zone,
        cameras=proposed_cameras(channels, names, table.cameras),
        has_reference=has_reference,
    )


def folder_of_project(path: Path) -> Path:
    """The folder of an OpenSfM project, if ``path`` is its file; any other path unchanged."""
    return path.parent if path.name == OPENSFM_FILE else path


def refuse_other_images(images: Path, times: ImageTimes, observed: tuple[str, ...]) -> None:
    """Refuse (IMAGES-OTHER) ``images`` if none of their files is among the ``observed`` images.

    ``observed`` are the names of images in the observations; () accepts any files.
    """
    if observed and not times.rows_of(observed):
        raise messages.other_images(
            where=images, absent=str(observed[0]), present=str(times.file[0])
        )


def mission_name(log: Path) -> str:
    """The name of the log's file, with characters that a mission's name may not have replaced."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", log.stem).strip("-._")
    return name[:LONGEST_NAME] or "mission"


def path_text(path: Path | None, out: Path) -> str:
    """A path as YAML, relative to the folder of the mission file ``out``; TODO for None."""
    if path is None:
        return TODO
    try:
        return yaml_text(Path(os.path.relpath(path, out.parent)).as_posix())
    except ValueError:  # another drive of Windows
        return yaml_text(str(path.absolute()))


def mission_template() -> Template:
    """The Jinja template of proposed mission files, with the filter ``remark``."""
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters["remark"] = as_remark
    text = resources.files(__package__).joinpath("mission.yaml.j2").read_text("utf-8")
    return environment.from_string(text)


def as_remark(text: str) -> str:
    """A text as a YAML comment at the end of a line; "" for an empty text.

    Line breaks and other characters that do not print are replaced.
    """
    on_one_line = " ".join(text.split())
    shown = "".join(c if c.isprintable() else "?" for c in on_one_line)
    return f"  # {shown}" if shown else ""
