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
from unbend.config.campaign import Campaign, MissionRef, open_configs, refuse_duplicates
from unbend.errors import StorageError, UnbendError, storage_errors
from unbend.exit_codes import EXIT_BUG
from unbend.report.campaign import Row, campaign_page, campaign_table, row_of, row_without
from unbend.tables.manifest.whole import Manifest

PAGE = "campaign.html"
TABLE = "campaign.parquet"
MARK = '<meta name="generator" content="unbend campaign">'

_HEAD_CHARACTERS = 2000  # at the beginning of a page, which contain its mark and its digest
_MOST_LISTED = 20  # names that a refusal lists


class NamedMission(NamedTuple):
    """A mission with its name and the folder or place of its results."""

    ref: MissionRef
    name: str
    output: Path | Place


@dataclass(frozen=True)
class UnchangedMission:
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
    """The missions that a command chose, their campaigns, and which of them need not run.

    missions : the chosen missions.
    campaigns : the campaigns of the files, with all their missions, chosen or not.
    named : name and output of each mission with a file that can be read, chosen or not.
    refused : missions that would write their results to the folder of an earlier mission.
    unchanged : missions that need not run, chosen or not.
    """

    missions: tuple[MissionRef, ...]
    campaigns: tuple[Campaign, ...]
    named: Mapping[MissionRef, NamedMission]
    refused: Mapping[MissionRef, UnbendError]
    unchanged: Mapping[MissionRef, UnchangedMission]

    def is_unchanged(self, ref: MissionRef) -> bool:
        """Whether a mission is unchanged, so that it need not run."""
        return ref in self.unchanged

    def ends(
        self,
        run: Callable[[list[MissionRef]], Iterable[tuple[MissionRef, MissionEnd]]],
        *,
        run_unchanged: bool = False,
    ) -> Generator[tuple[MissionRef, MissionEnd]]:
        """Yield how each chosen mission ended: refused and unchanged ones first, then the others.

        The others are passed to ``run`` together. ``run_unchanged`` passes unchanged missions too.
        """
        to_run = []
        for ref in self.missions:
            if ref in self.refused:
                yield ref, self.refused[ref]
            elif run_unchanged or ref not in self.unchanged:
                to_run.append(ref)
            else:
                yield ref, self._outcome_of_unchanged(self.unchanged[ref])
        if to_run:
            yield from run(to_run)

    def _outcome_of_unchanged(self, mission: UnchangedMission) -> Outcome:
        """The outcome of an unchanged mission, with its manifest if it is the only chosen one."""
        manifest = None
        if len(self.missions) == 1:  # of several missions no manifest is shown
            manifest = read_manifest(mission.output)
        return Outcome(
            name=mission.name,
            output=mission.output,
            manifest=manifest,
            exit_code=mission.exit_code,
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
    the slice of these missions that this job of several runs. ``writes`` : the command will write
    the pages of campaigns.

    Refuses (ConfigError) missions of a campaign with the same name or the same results, and
    (CAMPAIGN-MISSION) a name that no mission has; with ``writes`` also (STORAGE-NOT-OURS) to
    replace a page that another program wrote.
    """
    missions, campaigns = open_configs(configs)
    will_write_pages = writes and bool(campaigns)
    unchanged = unchanged_missions(missions, with_rows=will_write_pages)
    named = list(named_missions(missions, unchanged))
    for campaign in campaigns:
        members = set(campaign.missions)
        refuse_duplicates(campaign, [mission for mission in named if mission.ref in members])
        if writes:
            refuse_foreign_page(campaign.output)
    chosen = missions
    if names:
        chosen = missions_by_name(names, named)
    return Selection(
        missions=tuple(chosen[part]),
        campaigns=tuple(campaigns),
        named={mission.ref: mission for mission in named},
        refused=shared_outputs((mission.ref, mission.output) for mission in named),
        unchanged=unchanged,
    )


def unchanged_missions(
    missions: Iterable[MissionRef], *, with_rows: bool
) -> dict[MissionRef, UnchangedMission]:
    """The missions that are unchanged; ``with_rows`` adds the row of each on a campaign's page."""
    unchanged = {}
    for ref in missions:
        result = find_unchanged(ref)
        if result is None:
            continue
        exit_code = result.manifest.run.exit_code
        # A manifest without the values of a row is an older version's. Its mission is left out, and
        # takes the full comparison.
        with suppress(UnbendError):
            row = row_of(result.manifest) if with_rows else None
            unchanged[ref] = UnchangedMission(result.name, result.output, exit_code, row)
    return unchanged


def named_missions(
    missions: Iterable[MissionRef], unchanged: Mapping[MissionRef, UnchangedMission]
) -> Iterator[NamedMission]:
    """Missions with their names and outputs; a mission is left out if its file cannot be read."""
    for ref in missions:
        if ref in unchanged:
            yield NamedMission(ref, unchanged[ref].name, unchanged[ref].output)
            continue
        with suppress(UnbendError):  # raised again, and reported, when the mission is run
            mission = ref.load()
            yield NamedMission(ref, mission.mission.name, output_of(mission, ref.folder))


def missions_by_name(names: Sequence[str], missions: Sequence[NamedMission]) -> list[MissionRef]:
    """The missions with the given names or files, in the order of ``missions``.

    Refuses (CAMPAIGN-MISSION) a name that no mission has.
    """
    wanted = set(names)
    without_mission = set(names)
    chosen = []
    for mission in missions:
        argument = mission.ref.run_arguments[-1]  # the file; or the name, in a campaign
        names_of_mission = {mission.name, argument}
        if names_of_mission & wanted:
            chosen.append(mission.ref)
        without_mission -= names_of_mission
    if without_mission:
        name = next(iter(without_mission))
        all_names = sorted(mission.name for mission in missions)
        raise messages.no_such_mission(name=name, known=all_names[:_MOST_LISTED])
    return chosen


def refuse_foreign_page(output: Path) -> None:
    """Refuse (STORAGE-NOT-OURS) to replace a page or table that unbend did not write."""
    foreign = foreign_pages(output)
    if foreign:
        raise messages.pages_not_ours(path=str(output), pages=foreign)


def foreign_pages(output: Path) -> list[str]:
    """The names of page and table of a campaign that are in a folder, and not of unbend."""
    page = output / PAGE
    table = output / TABLE
    foreign = []
    if page.exists() and MARK not in head_of(page):
        foreign.append(PAGE)
    if table.exists() and not is_table_ours(table):
        foreign.append(TABLE)
    return foreign


def is_table_ours(table: Path) -> bool:
    """Whether unbend wrote the table of a campaign; False if it cannot be read."""
    from pyarrow.parquet import read_schema

    if not table.is_file():  # reading a pipe might never end
        return False
    try:
        return b"unbend.campaign" in (read_schema(table).metadata or {})
    except (OSError, ValueError):  # ValueError: no Parquet
        return False


def write_pages(chosen: Selection, ended: Mapping[MissionRef, MissionEnd]) -> Iterator[Path]:
    """Write page and table of each campaign, unless both exist with the same content.

    Yields the path of each campaign's page. The content is compared by a digest of all that the
    page is made of, which the page contains.
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
    """The beginning of a page, with its mark and digest; "" if the page cannot be read."""
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
    """The row of a mission on a campaign's page, with a link to its results.

    ``end`` is how the mission ended; None for a mission that this command did not run. The row has
    no link if the mission file cannot be read.
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

    ``end`` is None for a mission that did not end in this command. Reading the manifest at
    ``output`` is the last resort, as it takes time: ``end`` or ``chosen`` may have its values.
    """
    has_not_run_now = end is None or (isinstance(end, Outcome) and end.repeated)
    if has_not_run_now and ref in chosen.unchanged:
        row = chosen.unchanged[ref].row
        if row is not None:
            return row
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
    """The row of a mission called ``name``, from the manifest in its output folder.

    Without a manifest, or with that of a mission of another name, the row states that the mission
    has no results yet.
    """
    if manifest is None or manifest.run.mission != name:
        return row_without(name, None, "", "it has no results yet")
    try:
        return row_of(manifest)
    except UnbendError as error:  # the results of an older version had other fields
        return row_without(name, None, error.code, error.what)


def link_to(output: Path | Place, page_folder: Path) -> str:
    """The link from a campaign's page to the results of a mission.

    It is a path relative to the folder of the page, or the URL of the published files. Another
    drive of Windows gives an absolute path.
    """
    if isinstance(output, Place):
        published = read_manifest(output, ignore_damaged=True)
        attempt = "" if published is None else published.run.attempt
        return f"{output}/attempts/{attempt}"
    target = os.path.realpath(output)
    with suppress(ValueError):  # on another drive
        target = os.path.relpath(target, os.path.realpath(page_folder))
    return Path(target).as_posix()


def run_chosen(ref: MissionRef, **options: Any) -> Outcome:
    """Run a mission; ``options`` are those of `run_mission`.

    The import takes a second, and so is done only in the process that runs missions.
    """
    from unbend.batch.runs import run_mission

    return run_mission(ref, **options)
