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
from unbend.errors import StorageError, UnbendError, storage_errors
from unbend.exit_codes import EXIT_BUG
from unbend.report.campaign import Row, campaign_page, campaign_table, row_of, row_without
from unbend.tables.manifest.whole import Manifest

PAGE = "campaign.html"
TABLE = "campaign.parquet"
MARK = '<meta name="generator" content="unbend campaign">'

_HEAD_CHARACTERS = 2000  # at the beginning of a page; its mark and its digest stand there
_MOST_LISTED = 20  # names that a refusal lists


class NamedMission(NamedTuple):
    """A mission with its name and where its results go."""

    ref: MissionRef
    name: str
    output: Path | Place


@dataclass(frozen=True)
class KnownMission:
    """A mission that need not run, because its results are there and nothing changed.

    ``exit_code`` is that of the run that made the results. ``row`` is the mission's row of a
    campaign's page; None where no page will be written.
    """

    name: str
    output: Path
    exit_code: int
    row: Row | None


@dataclass(frozen=True)
class Selection:
    """The missions that a command chose, their campaigns, and what is known before any runs.

    missions : the chosen missions.
    campaigns : the campaigns of the files, with all their missions, chosen or not.
    named : name and output of each mission of the files that can be read.
    refused : missions whose results would go to the folder of an earlier mission.
    known : missions that are unchanged.
    """

    missions: tuple[MissionRef, ...]
    campaigns: tuple[Campaign, ...]
    named: Mapping[MissionRef, NamedMission]
    refused: Mapping[MissionRef, UnbendError]
    known: Mapping[MissionRef, KnownMission]

    def is_unchanged(self, ref: MissionRef) -> bool:
        """Whether a mission is unchanged, so that it need not run."""
        return ref in self.known

    def ends(
        self,
        run: Callable[[list[MissionRef]], Iterable[tuple[MissionRef, MissionEnd]]],
        *,
        again: bool = False,
    ) -> Generator[tuple[MissionRef, MissionEnd]]:
        """Yield how each chosen mission ended: refused and unchanged ones first, then the others.

        The others are handed to ``run`` together; with ``again`` unchanged missions are among them.
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
        """The outcome of an unchanged mission, with its manifest if it is the only mission."""
        manifest = None
        if len(self.missions) == 1:  # of several missions no manifest is shown
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
    """Choose among the missions of mission files and campaign files.

    ``names`` are names or files of missions; without names all missions are chosen. ``part`` is
    the share of one of several jobs in these. ``writes`` says whether pages will be written.

    Refuses (ConfigError) missions of a campaign with the same name or the same results, and
    (CAMPAIGN-MISSION) a name that no mission has; with ``writes`` also (STORAGE-NOT-OURS) a
    campaign whose page another program wrote.
    """
    missions, campaigns = open_configs(configs)
    will_write_pages = writes and bool(campaigns)
    known_runs = known_missions(missions, with_rows=will_write_pages)
    listed = list(named_missions(missions, known_runs))
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
        named={mission.ref: mission for mission in listed},
        refused=shared_outputs((mission.ref, mission.output) for mission in listed),
        known=known_runs,
    )


def known_missions(
    missions: Iterable[MissionRef], *, with_rows: bool
) -> dict[MissionRef, KnownMission]:
    """The missions that are unchanged, ``with_rows`` with their rows of a page."""
    known_runs = {}
    for ref in missions:
        unchanged = find_unchanged(ref)
        if unchanged is None:
            continue
        exit_code = unchanged.manifest.run.exit_code
        # A manifest without the values of a row is an older version's: the mission is then not
        # known to be unchanged, and takes the full comparison.
        with suppress(UnbendError):
            row = row_of(unchanged.manifest) if with_rows else None
            known_runs[ref] = KnownMission(unchanged.name, unchanged.output, exit_code, row)
    return known_runs


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
        argument = mission.ref.words[-1]  # the file; or the name, in a campaign
        names_of_mission = {mission.name, argument}
        if names_of_mission & wanted:
            chosen.append(mission.ref)
        not_met -= names_of_mission
    if not_met:
        known_names = sorted(mission.name for mission in listed)
        raise messages.no_such_mission(name=next(iter(not_met)), known=known_names[:_MOST_LISTED])
    return chosen


def refuse_foreign_page(output: Path) -> None:
    """Refuse (STORAGE-NOT-OURS) to replace a page or table that no campaign has written."""
    present = [name for name in (PAGE, TABLE) if (output / name).exists()]
    if present and not is_page_ours(output, present):
        raise messages.files_not_ours(path=str(output), results=present)


def is_page_ours(output: Path, present: Sequence[str]) -> bool:
    """Whether a campaign wrote the page, or the table if only that is there.

    ``present`` are the names of those that are there, one at least.
    """
    if PAGE in present:
        return MARK in head_of(output / PAGE)
    # Only the table is there: the page was removed, or a run ended after it wrote the table.
    from pyarrow.parquet import read_schema

    if not (output / TABLE).is_file():  # reading a pipe might never end
        return False
    try:
        return b"unbend.campaign" in (read_schema(output / TABLE).metadata or {})
    except (OSError, ValueError):  # ValueError: no Parquet
        return False


def write_pages(chosen: Selection, ended: Mapping[MissionRef, MissionEnd]) -> Iterator[Path]:
    """Write page and table of each campaign, unless both are there and say the same already.

    Yields the path of each campaign's page. The page holds the digest of all that it is made of.
    """
    for campaign in chosen.campaigns:
        rows = [page_row(chosen, ref, ended.get(ref), campaign.output) for ref in campaign.missions]
        content = json.dumps([code_hash(), campaign.name, rows])
        digest = hashlib.sha256(content.encode()).hexdigest()
        page = campaign.output / PAGE
        if not (campaign.output / TABLE).exists() or f'"{digest}"' not in head_of(page):
            write_page(campaign, rows, digest)
        yield page


def head_of(page: Path) -> str:
    """The beginning of a page, with its mark and digest; "" of a page that cannot be read."""
    if not page.is_file():  # reading a pipe might never end
        return ""
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


def page_row(chosen: Selection, ref: MissionRef, end: MissionEnd | None, page_folder: Path) -> Row:
    """What a campaign's page shows of a mission, with a link to its results if these have a place.

    ``end`` is how the mission ended; None for a mission that this command did not run.
    """
    name = ref.label
    output: Path | Place | None = None
    if ref in chosen.named:
        name = chosen.named[ref].name
        output = chosen.named[ref].output
    if isinstance(end, Outcome):
        output = end.output
    row = row_of_end(chosen, ref, end, name, output)
    if output is None:
        return row
    if isinstance(end, StorageError) and isinstance(output, Place):
        return {**row, "results": str(output)}  # a store that hangs is not asked again
    link = str(output)
    with suppress(StorageError):
        link = link_to(output, page_folder)
    return {**row, "results": link}


def row_of_end(
    chosen: Selection,
    ref: MissionRef,
    end: MissionEnd | None,
    name: str,
    output: Path | Place | None,
) -> Row:
    """The row of a mission that ended in this command, or in an earlier one, or never ran.

    The manifest at ``output`` is read only where neither ``end`` nor ``chosen`` has what it says.
    """
    has_not_run_now = end is None or (isinstance(end, Outcome) and end.repeated)
    if has_not_run_now and ref in chosen.known:
        known_row = chosen.known[ref].row
        if known_row is not None:
            return known_row
    if isinstance(end, UnbendError):
        return row_without(name, end.exit_code, end.code, end.what)
    if isinstance(end, Bug):
        return row_without(name, EXIT_BUG, "", "a bug in unbend")
    manifest = None if end is None else end.manifest
    if manifest is None and output is not None:
        try:
            manifest = read_manifest(output, ignore_damaged=True)
        except StorageError as error:  # in object storage that does not answer
            return row_without(name, None, error.code, error.what)
    return row_of_manifest(name, manifest)


def row_of_manifest(name: str, manifest: Manifest | None) -> Row:
    """The row of a mission by the manifest in its folder.

    Without a manifest, or with that of a mission of another name, the row says that the mission
    has no results yet.
    """
    if manifest is None or manifest.run.mission != name:
        return row_without(name, None, "", "it has no results yet")
    try:
        return row_of(manifest)
    except UnbendError as error:  # of a version whose results had other fields
        return row_without(name, None, error.code, error.what)


def link_to(output: Path | Place, page_folder: Path) -> str:
    """Where the report of a mission lies, as seen from the folder of a page."""
    if isinstance(output, Place):
        published = read_manifest(output, ignore_damaged=True)
        attempt = "" if published is None else published.run.attempt
        return f"{output}/attempts/{attempt}"
    target = os.path.realpath(output)
    with suppress(ValueError):  # on another drive
        target = os.path.relpath(target, os.path.realpath(page_folder))
    return Path(target).as_posix()


def run_chosen(ref: MissionRef, **options: Any) -> Outcome:
    """Run a mission. The import takes a second, and only in the process that runs missions."""
    from unbend.batch.runs import run_mission

    return run_mission(ref, **options)
