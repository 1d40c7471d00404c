"""The missions of a command: each a file, with what a campaign says for all of its missions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from pipeline.config.reading import mission_of, read_yaml
from pipeline.config.sections import Mission


@dataclass(frozen=True)
class MissionRef:
    """A mission to run, small and of plain values: it can be sent to another process or machine.

    ``path`` is its file, and relative paths resolve from the folder of that. ``defaults`` are the
    sections that stand where the file has none of its own, as JSON.
    """

    path: Path
    defaults: str = ""

    @classmethod
    def of(cls, mission: MissionRef | Path | str) -> MissionRef:
        """The reference itself, or that of a mission file alone."""
        return mission if isinstance(mission, MissionRef) else cls(Path(mission))

    @property
    def folder(self) -> Path:
        """The folder from which its relative paths resolve."""
        return self.path.parent

    def load(self) -> Mission:
        """Read and check the mission file; refuses as `load_mission` does."""
        defaults = json.loads(self.defaults) if self.defaults else None
        values, node = read_yaml(self.path)
        return mission_of(values, node, str(self.path), defaults)
