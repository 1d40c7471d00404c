"""The records that a walk through a DataFlash log finds, and the damage between them."""

from dataclasses import dataclass

import numpy as np

from unbend.ingest.buffers import view_of_bytes
from unbend.ingest.dataflash.dataflash_records import find_records


@dataclass(frozen=True)
class Walk:
    """Places and names of the records of a file in their order, and lengths by name."""

    places: np.ndarray
    names: np.ndarray
    lengths: dict[str, int]
    bad_bytes: int
    first_bad: int
    cut_bytes: int
    blocks: int

    def places_of(self, name):
        return self.places[self.names == name].tolist()

    @property
    def records(self) -> set[tuple[int, str]]:
        return set(zip(self.places.tolist(), self.names.tolist(), strict=True))


def walk(data):
    walker = find_records(view_of_bytes(data))
    names = np.array([definition.name for definition in walker.definitions])
    blocks = walker.kept_blocks
    numbers = np.concatenate([block.numbers for block in blocks])
    return Walk(
        places=np.concatenate([block.base + block.at.astype(np.int64) for block in blocks]),
        names=names[numbers],
        lengths={definition.name: definition.length for definition in walker.definitions},
        bad_bytes=walker.bad_bytes,
        first_bad=walker.first_bad,
        cut_bytes=walker.cut_bytes,
        blocks=len(blocks),
    )
