"""The missions of a command: which run, and which are unchanged; page and table of a campaign."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from unbend.batch import messages
from unbend.batch.execute import MissionEnd, shared_outputs
from unbend.batch.executors import Bug, Outcome
from unbend.batch.fingerprint import code_hash
from unbend.batch.plan import output_of
from unbend.batch.remote import Place
from unbend.batch.results import read_manifest
from unbend.batch.store import atomic_write
from unbend.batch.unchanged import find_unchanged
from unbend.config.campaign import Campaign, MissionRef, open_configs, refuse_twins
from unbend.errors import UnbendError, storage_errors
from unbend.exit_codes import EXIT_BUG
from unbend.report.campaign import Row, campaign_page, campaign_table, row_of, row_without
from unbend.tables.manifest.whole import Manifest

PAGE = "campaign.html"
TABLE = "campaign.parquet"
MARK = '<meta name="generator" content="unbend campaign">'

_HEAD_CHARACTERS = 2000  # of a page, which hold its mark and its digest
_MOST_LISTED = 20  # names that a refusal lists


class NamedMission(NamedTuple):
    """A mission with its name and where its results go."""

    ref: MissionRef
    name: str
    output: Path | Place


@dataclass(frozen=True)
class KnownMission:
    """A mission that is unchanged: what its manifest says of it, and its row of a page."""

    name: str
    output: Path
    exit_code: int
    row: Row | None


@dataclass(frozen=True)
class Selection:
    """Missions and their campaigns: which are refused, and which are unchanged."""

    missions: tuple[MissionRef, ...]
    campaigns: tuple[Campaign, ...]
    called: Mapping[MissionRef, NamedMission]
    refused: Mapping[MissionRef, UnbendError]
    known: Mapping[MissionRef, KnownMission]

    def is_unchanged(self, ref: MissionRef) -> bool:
        """Whether a mission is known not to run."""
        return ref in self.known

    def ends(
        self,
        run: Callable[[list[MissionRef]], Iterable[tuple[MissionRef, MissionEnd]]],
        *,
        again: bool = False,
    ) -> Generator[tuple[MissionRef, MissionEnd]]:
        """How each mission ended. ``run`` gets all but refused missions and unchanged ones.

        With ``again`` unchanged missions are run too.
        """
        waiting = []
        for ref in self.missions:
            if ref in self.refused:
                yield ref, self.refused[ref]
            elif again or ref not in self.known:
                waiting.append(ref)
            else:
                yield ref, self._repeated(self.known[ref])
        if waiting:
            yield from run(waiting)

    def _repeated(self, known: KnownMission) -> Outcome:
        """The outcome of an unchanged mission, with its manifest where that will be shown."""
        manifest = None
        if len(self.missions) == 1:
            manifest = read_manifest(known.output)
        return Outcome(
            name=known.name,
            output=known.output,
            manifest=manifest,
            exit_code=known.exit_code,
            repeated=True,
        )


def select_missions(
    configs: Iterable[Path],
    names: Sequence[str] = (),
    part: slice = slice(None),
    *,
    writes: bool = True,
) -> Selection:
    """The missions of mission and campaign files; of them ``names`` (or files), and a ``part``.

    Refuses (ConfigError) twins in a campaign, a name that no mission has (CAMPAIGN-MISSION), and
    with ``writes`` a page of somebody else.
    """
    missions, campaigns = open_configs(configs)
    known = known_missions(missions, with_rows=writes and bool(campaigns))
    listed = list(named_missions(missions, known))
    for campaign in campaigns:
        members = set(campaign.missions)
        refuse_twins(campaign, [mission for mission in listed if mission.ref in members])
        if writes:
            refuse_foreign_page(campaign.output)
    chosen = missions
    if names:
        chosen = missions_called(names, listed)
    return Selection(
        missions=tuple(chosen[part]),
        campaigns=tuple(campaigns),
        called={mission.ref: mission for mission in listed},
        refused=shared_outputs((mission.ref, mission.output) for mission in listed),
        known=known,
    )


def known_missions(
    missions: Iterable[MissionRef], *, with_rows: bool
) -> dict[MissionRef, KnownMission]:
    """The missions that are unchanged."""
    known = {}
    for ref in missions:
        unchanged = find_unchanged(ref)
        if unchanged is None:
            continue
        exit_code = unchanged.manifest.run.exit_code
        with suppress(UnbendError):  # its manifest lacks results: it is compared, or run again
            row = row_of(unchanged.manifest) if with_rows else None
            known[ref] = KnownMission(unchanged.name, unchanged.output, exit_code, row)
    return known


def named_missions(
    missions: Iterable[MissionRef], known: Mapping[MissionRef, KnownMission]
) -> Iterator[NamedMission]:
    """Missions whose files can be read, with their names and outputs."""
    for ref in missions:
        if ref in known:
            yield NamedMission(ref, known[ref].name, known[ref].output)
            continue
        with suppress(UnbendError):  # raised again, and reported, when the mission is run
            mission = ref.load()
            yield NamedMission(ref, mission.mission.name, output_of(mission, ref.folder))


def missions_called(names: Sequence[str], listed: Sequence[NamedMission]) -> list[MissionRef]:
    """The missions of some names or files; refuses (CAMPAIGN-MISSION) a name that none has."""
    wanted = set(names)
    not_met = set(names)
    chosen = []
    for mission in listed:
        names_of_mission = {mission.name, mission.ref.words[-1]}
        if names_of_mission & wanted:
            chosen.append(mission.ref)
        not_met -= names_of_mission
    if not_met:
        known = sorted(mission.name for mission in listed)
        raise messages.no_such_mission(name=next(iter(not_met)), known=known[:_MOST_LISTED])
    return chosen


def refuse_foreign_page(output: Path) -> None:
    """Refuse (STORAGE-NOT-OURS) to replace a page or table that no campaign has written."""
    present = [name for name in (PAGE, TABLE) if (output / name).exists()]
    if present and not is_page_ours(output, present):
        raise messages.files_not_ours(path=str(output), results=present)


def is_page_ours(output: Path, present: Sequence[str]) -> bool:
    """Whether a campaign wrote the page, or the table where that is alone."""
    if PAGE in present:
        return MARK in head_of(output / PAGE)
    # The page was removed, or a run ended between the two.
    from pyarrow.parquet import read_schema

    try:
        return b"unbend.campaign" in (read_schema(output / TABLE).metadata or {})
    except (OSError, ValueError):  # ValueError: no Parquet
        return False


def write_pages(chosen: Selection, ended: Mapping[MissionRef, MissionEnd]) -> Iterator[Path]:
    """Write page and table of each campaign, where they say something new; yields the pages."""
    for campaign in chosen.campaigns:
        rows = [page_row(chosen, ref, ended.get(ref), campaign.output) for ref in campaign.missions]
        content = json.dumps([code_hash(), campaign.name, rows])
        digest = hashlib.sha256(content.encode()).hexdigest()
        page = campaign.output / PAGE
        if not (campaign.output / TABLE).exists() or f'"{digest}"' not in head_of(page):
            write_page(campaign, rows, digest)
        yield page


def head_of(page: Path) -> str:
    """The beginning of a page, which says who wrote it and of what; "" where there is none."""
    try:
        with page.open(encoding="utf-8") as file:
            return file.read(_HEAD_CHARACTERS)
    except (OSError, ValueError):  # ValueError: no UTF-8
        return ""


def write_page(campaign: Campaign, rows: Sequence[Row], digest: str) -> None:
    """Write the table of a campaign, and last its page."""
    from unbend.tables.writing import write_parquet

    with storage_errors(campaign.output):
        campaign.output.mkdir(parents=True, exist_ok=True)
    with atomic_write(campaign.output / TABLE) as draft:
        write_parquet(campaign_table(campaign.name, rows), draft)
    with atomic_write(campaign.output / PAGE) as draft:
        draft.write_text(campaign_page(campaign.name, rows, digest), encoding="utf-8")


def page_row(chosen: Selection, ref: MissionRef, end: MissionEnd | None, page: Path) -> Row:
    """What the page in a folder shows of a mission."""
    name = ref.label
    output: Path | Place | None = None
    if ref in chosen.called:
        name = chosen.called[ref].name
        output = chosen.called[ref].output
    if isinstance(end, Outcome):
        output = end.output
    link = {} if output is None else {"results": link_to(output, page)}
    return {**row_of_end(chosen, ref, end, name, output), **link}


def row_of_end(
    chosen: Selection,
    ref: MissionRef,
    end: MissionEnd | None,
    name: str,
    output: Path | Place | None,
) -> Row:
    """What is known of a mission that ended now, or before, or never ran.

    The manifest at ``output`` is read only where ``end`` does not hold it.
    """
    is_repeated = end is None or (isinstance(end, Outcome) and end.repeated)
    if is_repeated and ref in chosen.known:
        known = chosen.known[ref].row
        if known is not None:
            return known
    if isinstance(end, UnbendError):
        return row_without(name, end.exit_code, end.code, end.what)
    if isinstance(end, Bug):
        return row_without(name, EXIT_BUG, "", "a bug in unbend")
    manifest = None if end is None else end.manifest
    if manifest is None and output is not None:
        manifest = read_manifest(output, damaged=True)
    return row_of_manifest(name, manifest)


def row_of_manifest(name: str, manifest: Manifest | None) -> Row:
    """What the manifest in a mission's folder says of it, unless it is another mission's."""
    if manifest is None or manifest.run.mission != name:
        return row_without(name, None, "", "it has no results yet")
    try:
        return row_of(manifest)
    except UnbendError as error:  # of a version whose results had other fields
        return row_without(name, None, error.code, error.what)


def link_to(output: Path | Place, page: Path) -> str:
    """Where the report of a mission lies, as seen from the folder of a page."""
    if isinstance(output, Place):
        published = read_manifest(output, damaged=True)
        attempt = "" if published is None else published.run.attempt
        return f"{output}/attempts/{attempt}"
    target = os.path.realpath(output)
    with suppress(ValueError):  # on another drive
        target = os.path.relpath(target, os.path.realpath(page))
    return Path(target).as_posix()


def run_chosen(ref: MissionRef, **options: Any) -> Outcome:
    """`run_mission`, which is imported by the process that runs it: a second of its time."""
    from unbend.batch.runs import run_mission

    return run_mission(ref, **options)
