"""A manifest as a whole: its plain values, and records made from them."""

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
    """The manifest of a run: ``values`` are all values of the file, from which records are made.

    ``where`` is the file, for refusals. A record is made when it is first read, because a manifest
    of another version may lack values of some records. Values without a field are ignored.
    """

    values: Mapping[str, Any]
    where: str = field(default="", compare=False)

    @cached_property
    def run(self) -> RunRecord:
        """The mission of the run, its inputs and versions, its exit code and its files."""
        return self._record(RunRecord, self.values)

    @cached_property
    def results(self) -> ResultsRecord:
        """The results of the run."""
        return self._record(ResultsRecord, self.values)

    @cached_property
    def sections(self) -> MissionSections:
        """The keys of the mission file that reports use."""
        return self._record(MissionSections, self.run.config)

    def with_values(self, changed: Mapping[str, Any]) -> Manifest:
        """A copy of the manifest with some values replaced or added."""
        return Manifest({**self.values, **changed}, self.where)

    def _record(self, kind: type[Record], values: Mapping[str, Any]) -> Record:
        """Make a record from values; refuses (MANIFEST-UNREADABLE) missing values and other types.

        ``kind`` is the class of the record.
        """
        try:
            reader = _reader_of(kind)  # type: ignore[arg-type]  # mypy: a class is not Hashable
            record: Record = reader.validate_python(values)
        except ValueError:  # pydantic's ValidationError
            raise manifest_not_ours(path=self.where) from None
        return record


@cache
def _reader_of(kind: type[Any]) -> TypeAdapter[Any]:
    """A pydantic reader that checks plain values and makes records of the class ``kind``.

    It takes 0.2 ms for all results of a mission.
    """
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
