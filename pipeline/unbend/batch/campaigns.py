"""The missions of a command: which run, and which the index knows; page and table of a campaign."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unbend.batch.changes import IndexEntry, keep_stamps, known_stamps, look_up, remember
from unbend.batch.execute import MissionEnd, shared_outputs
from unbend.batch.executors import Outcome
from unbend.batch.keys import code_hash
from unbend.batch.object_store import Place
from unbend.batch.plan import located
from unbend.batch.store import atomic_write, read_manifest
from unbend.config.campaign import Campaign, MissionRef, open_configs, refuse_twins
from unbend.errors import ConfigError, StorageError, UnbendError, storage_errors
from unbend.exit_codes import EXIT_BUG

PAGE, TABLE = "campaign.html", "campaign.parquet"
MARK = '<meta name="generator" content="unbend campaign">'


def refuse_foreign_page(output: Path) -> None:
    """Refuse (STORAGE-NOT-OURS) to replace a page or table that no campaign has written."""
    there = [name for name in (PAGE, TABLE) if (output / name).exists()]
    with suppress(OSError, ValueError):  # ValueError: no UTF-8, or no Parquet
        if not there:
            return
        if PAGE in there:
            ours = MARK in (output / PAGE).read_text(encoding="utf-8")[:2000]
        else:  # the page was removed, or a run ended between the two
            from pyarrow.parquet import read_schema

            ours = b"unbend.campaign" in (read_schema(output / TABLE).metadata or {})
        if ours:
            return
    raise StorageError.of("STORAGE-NOT-OURS", output, results=", ".join(there))


def write_pages(chosen: Selection, ended: Mapping[MissionRef, MissionEnd]) -> Iterator[Path]:
    """Write page and table of each campaign, unless they say the same; yields the pages' paths."""
    for campaign in chosen.campaigns:
        page, table = campaign.output / PAGE, campaign.output / TABLE
        rows = [page_row(chosen, ref, ended.get(ref), campaign.output) for ref in campaign.missions]
        name = f"page {page.absolute()}"
        key = hashlib.sha256(json.dumps([code_hash(), campaign.name, rows]).encode()).hexdigest()
        if (known_stamps(name) or {}).get("key") != key:
            from unbend.report.html import campaign_page, campaign_table
            from unbend.tables.writing import write_parquet

            with storage_errors(campaign.output):
                campaign.output.mkdir(parents=True, exist_ok=True)
            with atomic_write(table) as draft:
                write_parquet(campaign_table(campaign.name, rows), draft)
            with atomic_write(page) as draft:
                draft.write_text(campaign_page(campaign.name, rows), encoding="utf-8")
            keep_stamps(name, [page, table], key=key)
        yield page


def page_row(
    chosen: Selection, ref: MissionRef, end: MissionEnd | None, page: Path
) -> Mapping[str, Any]:
    """What the page in a folder shows of a mission."""
    name, folder = chosen.called.get(ref, (ref.label, None))
    folder, at = (end.output if isinstance(end, Outcome) else folder), {}
    if isinstance(folder, Place):
        published = read_manifest(folder, damaged=True) or {"attempt": ""}
        at = {"results": f"{folder}/attempts/{published['attempt']}"}
    elif folder is not None:
        away, home = os.path.realpath(folder), os.path.realpath(page)
        with suppress(ValueError):  # on another drive
            away = os.path.relpath(away, home)
        at = {"results": Path(away).as_posix()}
    repeated = end is None or (isinstance(end, Outcome) and end.repeated)
    if repeated and chosen.is_unchanged(ref):
        return {**chosen.known[ref].row, **at}
    from unbend.report.html import row_of, row_without

    if isinstance(end, Outcome):
        return {**row_of(end.manifest), **at}
    if isinstance(end, UnbendError):
        return row_without(name, end.exit_code, end.code, end.what)
    if end is not None:
        return row_without(name, EXIT_BUG, "", "a bug in unbend")
    manifest = None if folder is None else read_manifest(folder, damaged=True)
    if manifest is None or manifest["mission"] != name:
        return row_without(name, None, "", "it has no results yet")
    return {**row_of(manifest), **at}


@dataclass(frozen=True)
class Selection:
    """Missions, their campaigns; ``called`` : names, folders; ``known`` : what the index says."""

    missions: tuple[MissionRef, ...]
    campaigns: tuple[Campaign, ...]
    called: Mapping[MissionRef, tuple[str, Path | Place]]
    refused: Mapping[MissionRef, UnbendError]
    known: Mapping[MissionRef, IndexEntry]

    def is_unchanged(self, ref: MissionRef) -> bool:
        return ref in self.known and self.known[ref].unchanged

    def ends(
        self, run: Callable[[list[MissionRef]], Iterable[tuple[MissionRef, MissionEnd]]],
        *, again: bool = False,
    ) -> Generator[tuple[MissionRef, MissionEnd]]:  # fmt: skip
        """How each mission ended; what is not refused or (but for ``again``) unchanged is run."""
        waiting = []
        for ref in self.missions:
            if ref in self.refused:
                yield ref, self.refused[ref]
            elif again or not self.is_unchanged(ref):
                waiting.append(ref)
            else:
                entry = self.known[ref]
                manifest = (read_manifest(entry.output) if len(self.missions) == 1 else None) or {}
                yield ref, Outcome(entry.name, entry.output, manifest, entry.exit_code, True)
        if waiting:
            yield from run(waiting)


def select_missions(
    configs: Iterable[Path], names: Sequence[str] = (), part: slice = slice(None),
    *, writes: bool = True,
) -> Selection:  # fmt: skip
    """The missions of mission and campaign files; of them ``names`` (or files), and a ``part``.

    Refuses (ConfigError) twins in a campaign, a name that no mission has (CAMPAIGN-MISSION), and
    with ``writes`` a page of somebody else.
    """
    missions, campaigns = open_configs(configs)
    known = look_up(missions)
    listed: list[tuple[MissionRef, str, Path | Place]] = []
    for ref in missions:
        if ref in known:
            listed.append((ref, known[ref].name, known[ref].output))
            continue
        with suppress(UnbendError):  # raised again, and reported, when the mission is run
            mission = ref.load()
            listed.append((ref, mission.mission.name, located(mission.output.path, ref.folder)))
    for campaign in campaigns:
        own = {*campaign.missions}
        refuse_twins(campaign, [item for item in listed if item[0] in own])
        if writes:
            refuse_foreign_page(campaign.output)
    called = {ref: (name, folder) for ref, name, folder in listed}
    words = {ref: {name, ref.words[-1]} for ref, (name, _) in called.items()}
    for name in {*names} - {word for of in words.values() for word in of}:
        there = ", ".join(sorted(of for of, _ in called.values())[:20])
        raise ConfigError.of("CAMPAIGN-MISSION", name=name, known=there)
    chosen = [ref for ref in missions if not names or words.get(ref, set()) & {*names}]
    shared = shared_outputs((ref, folder) for ref, _, folder in listed)
    return Selection(tuple(chosen[part]), tuple(campaigns), called, shared, known)


def keep_unchanged(chosen: Selection, ended: Mapping[MissionRef, MissionEnd]) -> None:
    """Let the index know the missions that are done, so that the next run need not read them."""
    done = {ref: end for ref, end in ended.items() if isinstance(end, Outcome)}
    new = [ref for ref, end in done.items() if not (end.repeated and chosen.is_unchanged(ref))]
    if new:
        from unbend.report.html import row_of

        remember(new, row_of)


def run_chosen(ref: MissionRef, **options: Any) -> Outcome:
    """`run_mission`, which is imported by the process that runs it: a second of its time."""
    from unbend.batch.runs import run_mission

    return run_mission(ref, **options)
