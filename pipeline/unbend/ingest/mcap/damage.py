"""What could not be read of an MCAP file, and where."""

from collections import Counter
from collections.abc import Iterator

from unbend.ingest.mcap import messages
from unbend.messages import Message

NAMED = 8  # losses of one kind that are named one by one


class Damage:
    """Losses with their bytes; of many of a kind the first are named, the others counted."""

    def __init__(self, file: str = "") -> None:
        self.losses: list[Message] = []
        self.bad_bytes = 0
        self._file = file
        self._seen: Counter[str] = Counter()
        self._more_bytes: Counter[str] = Counter()

    def at(self, place: int) -> str:
        """A place of the file, in words."""
        return f"{self._file}, byte {place}"

    def add(self, loss: Message) -> None:
        """Enter a loss; its count is in bytes."""
        self.bad_bytes += loss.count
        self._seen[loss.code] += 1
        if self._seen[loss.code] <= NAMED:
            self.losses.append(loss)
        else:
            self._more_bytes[loss.code] += loss.count

    def messages(self) -> Iterator[Message]:
        """The losses, those beyond the first few of a kind as one."""
        yield from self.losses
        for code, count in self._more_bytes.items():
            last_named = [loss for loss in self.losses if loss.code == code][-1]
            places = self._seen[code] - NAMED
            yield messages.more_places(like=last_named, places=places, count=count)
