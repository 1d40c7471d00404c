"""Check that the sections of a mission file name the same cameras."""

import difflib
from collections.abc import Collection, Mapping

from unbend.config.event_sources import EventsSection
from unbend.config.section import SectionError

SECTION_OF_ONE_CAMERA = "events.csv.camera"
"""This section names only one camera: other cameras then have no exposures."""


def cameras_by_section(
    mount: Collection[str], events: EventsSection | None
) -> dict[str, frozenset[str]]:
    """The names of cameras in each section that names cameras, by the key of the section.

    ``mount`` are the names under ``mount``.
    """
    named = {"mount": frozenset(mount)}
    if events is None:
        return named
    if events.log is not None:
        named["events.log"] = frozenset(events.log)
    if events.positions is not None:
        named["events.positions"] = frozenset(events.positions)
    if events.csv is not None and events.csv.camera is not None:
        named[SECTION_OF_ONE_CAMERA] = frozenset({events.csv.camera})
    return named


def check_table_of_exposures(cameras: Collection[str], events: EventsSection | None) -> None:
    """Refuse (SectionError) a table of exposures that leaves open of which camera a row is."""
    if events is None or events.csv is None or len(cameras) < 2:
        return
    if events.csv.camera is None and events.csv.columns.camera is None:
        raise SectionError(
            "events.csv must state which camera: camera or columns.camera",
            at=("events", "csv"),
        )


def check_camera_names(
    cameras: Collection[str],
    named: Mapping[str, frozenset[str]],
) -> None:
    """Refuse (SectionError) a name that is not under cameras, and a camera without an entry.

    ``named`` are the names under each other section, by the section's key.
    """
    for section, names in named.items():
        unknown = sorted(names.difference(cameras))
        if unknown:
            raise _unknown_camera(cameras, named, section, unknown[0])
    for section, names in named.items():
        without_entry = sorted(set(cameras) - names)
        if without_entry and section != SECTION_OF_ONE_CAMERA:
            name = without_entry[0]
            raise SectionError(
                f"camera {name!r} has no entry under {section}",
                at=("cameras", name),
            )


def _unknown_camera(
    cameras: Collection[str],
    named: Mapping[str, frozenset[str]],
    section: str,
    name: str,
) -> SectionError:
    """The error for a ``name`` in a section that is not under cameras.

    The mistake is in the section. But if another section has this name too, and none has the most
    similar name under cameras, the mistake is under cameras.
    """
    missing_in_section = sorted(set(cameras) - named[section])
    candidates = missing_in_section or sorted(cameras)
    nearest = difflib.get_close_matches(name, candidates, n=1, cutoff=0.0)[0]
    sections_with_name = [other for other, names in named.items() if name in names]
    has_nearest = any(nearest in names for names in named.values())
    if len(sections_with_name) > 1 and not has_nearest:
        sections = " and ".join(sections_with_name)
        return SectionError(
            f"cameras names camera {nearest!r}, but {sections} name camera {name!r}; perhaps "
            f"{name!r} under cameras?",
            at=("cameras", nearest),
        )
    return SectionError(
        f"{section} names camera {name!r}; perhaps {nearest!r}?",
        at=(*section.split("."), name),
    )
