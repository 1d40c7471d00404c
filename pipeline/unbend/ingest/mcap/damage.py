"""What could not be read of an MCAP file, and where."""

from collections import Counter
from collections.abc import Iterator

from unbend.ingest.mcap import messages
from unbend.messages import Message

NAMED = 8  # losses of one kind (code) that are named one by one; the others are counted


class Damage:
    """The losses of a file, with their bytes in ``bad_bytes``.

    Of each kind the first few are kept one by one in ``losses``; of the others only the bytes are.
    """

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
        """Enter a loss; the count of its message is in bytes."""
        self.bad_bytes += loss.count
        self._seen[loss.code] += 1
        if self._seen[loss.code] <= NAMED:
            self.losses.append(loss)
        else:
            self._more_bytes[loss.code] += loss.count

    def messages(self) -> Iterator[Message]:
        """The losses; those of a kind beyond the first few as one message with their bytes."""
        yield from self.losses
        for code, count in self._more_bytes.items():
            last_named = [loss for loss in self.losses if loss.code == code][-1]
            places = self._seen[code] - NAMED
            yield messages.more_places(like=last_named, places=places, count=count)
