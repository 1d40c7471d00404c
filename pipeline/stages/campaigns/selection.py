"""The missions of a command: which run, and which are unchanged.

What the index knows of a mission is not read again.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.execute import MissionEnd, shared_outputs
from pipeline.batch.index import IndexEntry, look_up, remember
from pipeline.batch.object_store.place import Place
from pipeline.batch.outcomes import Outcome
from pipeline.batch.plan import located
from pipeline.batch.store import read_manifest
from pipeline.config.campaign import Campaign, MissionRef, open_configs, refuse_twins
from pipeline.errors import ConfigError, UnbendError
from pipeline.stages.campaigns.pages import refuse_foreign_page


@dataclass(frozen=True)
class Selection:
    """Missions in their order, and the campaigns that some are of.

    ``called`` : name and folder of results of all whose mission file can be read; ``refused`` those
    that share a folder of results with an earlier one; ``known`` what the index says.
    """

    missions: tuple[MissionRef, ...]
    campaigns: tuple[Campaign, ...]
    called: Mapping[MissionRef, tuple[str, Path | Place]]
    refused: Mapping[MissionRef, UnbendError]
    known: Mapping[MissionRef, IndexEntry]

    def is_unchanged(self, ref: MissionRef) -> bool:
        """Whether the index says that `run` would do nothing."""
        return ref in self.known and self.known[ref].unchanged

    def ends(
        self, run: Callable[[list[MissionRef]], Iterable[tuple[MissionRef, MissionEnd]]],
        *, again: bool = False,
    ) -> Generator[tuple[MissionRef, MissionEnd]]:  # fmt: skip
        """How each mission ended; what is not refused or unchanged is handed to ``run``.

        ``again`` : what is unchanged too. The manifest of what is unchanged is read if it is alone.
        """
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
    """The missions of mission files and campaign files; of them only those of ``names``.

    A name is that of a mission, or the path of its file; only a ``part`` is chosen. With ``writes``
    a page of somebody else is refused. Refuses
    (ConfigError) a campaign that is wrong, or has two missions of one name or folder
    (CAMPAIGN-SAME-NAME, CAMPAIGN-SAME-OUTPUT), and a name that no mission has (CAMPAIGN-MISSION).
    Nothing was touched then.
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
            output = located(mission.output.path, ref.folder)
            listed.append((ref, mission.mission.name, output))
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
    new = [
        ref for ref, end in ended.items()
        if isinstance(end, Outcome) and not (end.repeated and chosen.is_unchanged(ref))
    ]  # fmt: skip
    if new:
        from pipeline.report.page.campaign_page import row_of

        remember(new, row_of)


def run_chosen(ref: MissionRef, **options: Any) -> Outcome:
    """`run_mission`, which is imported by the process that runs it: a second of its time."""
    from pipeline.stages.story import run_mission

    return run_mission(ref, **options)
