"""Page and table of a campaign, written where they do not say what they should."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.batch.index import keep_stamps, known_stamps
from pipeline.batch.keys import code_hash
from pipeline.batch.object_store.place import Place
from pipeline.batch.outcomes import Outcome
from pipeline.batch.store import atomic_write, read_manifest
from pipeline.errors import StorageError, UnbendError, storage_errors
from pipeline.exit_codes import EXIT_BUG

if TYPE_CHECKING:
    from pipeline.batch.execute import MissionEnd
    from pipeline.config.campaign import MissionRef
    from pipeline.stages.campaigns.selection import Selection

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
    """Write page and table of each campaign, unless they are there and say the same.

    Missions that did not run now are shown as their results are. Yields the paths of the pages.
    """
    for campaign in chosen.campaigns:
        page, table = campaign.output / PAGE, campaign.output / TABLE
        rows = [page_row(chosen, ref, ended.get(ref), campaign.output) for ref in campaign.missions]
        name = f"page {page.absolute()}"
        key = hashlib.sha256(json.dumps([code_hash(), campaign.name, rows]).encode()).hexdigest()
        if (known_stamps(name) or {}).get("key") != key:
            from pipeline.report.page.campaign_page import campaign_page, campaign_table
            from pipeline.tables.writing import write_parquet

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
    from pipeline.report.page.campaign_page import row_of, row_without

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
