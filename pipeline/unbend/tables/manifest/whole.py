"""A manifest as a whole: plain values and their records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from unbend.tables.manifest.messages import manifest_not_ours
from unbend.tables.manifest.results import ResultsRecord
from unbend.tables.manifest.run import RunRecord
from unbend.tables.manifest.sections import MissionSections

if TYPE_CHECKING:
    from pydantic import TypeAdapter

Record = TypeVar("Record")


@dataclass(frozen=True)
class Manifest:
    """The manifest of a run: its plain values, with all that a file holds, and their records.

    ``where`` is the file, which a refusal names. Values without a field are ignored. Records are
    made when they are first read: results of another version may lack what theirs needs.
    """

    values: Mapping[str, Any]
    where: str = field(default="", compare=False)

    @cached_property
    def run(self) -> RunRecord:
        """Which run this is, how it ended, and its files."""
        return self._record(RunRecord, self.values)

    @cached_property
    def results(self) -> ResultsRecord:
        """What the run found."""
        return self._record(ResultsRecord, self.values)

    @cached_property
    def sections(self) -> MissionSections:
        """What the mission file says."""
        return self._record(MissionSections, self.run.config)

    def with_values(self, changed: Mapping[str, Any]) -> Manifest:
        """The manifest with some values replaced or added."""
        return Manifest({**self.values, **changed}, self.where)

    def _record(self, kind: type[Record], values: Mapping[str, Any]) -> Record:
        """A record of values; refuses (MANIFEST-UNREADABLE) missing ones and other types."""
        try:
            reader = _reader_of(kind)  # type: ignore[arg-type]  # mypy: a class is not Hashable
            record: Record = reader.validate_python(values)
        except ValueError:  # pydantic's ValidationError
            raise manifest_not_ours(path=self.where) from None
        return record


@cache
def _reader_of(kind: type[Any]) -> TypeAdapter[Any]:
    """Checks plain values and makes records of a kind: 0.2 ms for all results of a mission."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
