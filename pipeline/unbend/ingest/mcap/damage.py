"""What could not be read of an MCAP file, and where."""

from collections import Counter
from collections.abc import Iterator

from unbend.ingest.mcap import messages
from unbend.messages import Message

LISTED_LOSSES = 8  # of one kind (code) that are named one by one; the others are counted


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

    def place_in_words(self, place: int) -> str:
        """The file and the byte offset of a place in it, for reports."""
        return f"{self._file}, byte {place}"

    def add(self, loss: Message) -> None:
        """Enter a loss, with a count in bytes."""
        self.bad_bytes += loss.count
        self._seen[loss.code] += 1
        if self._seen[loss.code] <= LISTED_LOSSES:
            self.losses.append(loss)
        else:
            self._more_bytes[loss.code] += loss.count

    def messages(self) -> Iterator[Message]:
        """The losses; those of a kind beyond the first few as one message with their bytes."""
        yield from self.losses
        for code, count in self._more_bytes.items():
            last_named = [loss for loss in self.losses if loss.code == code][-1]
            places = self._seen[code] - LISTED_LOSSES
            yield messages.more_places(like=last_named, places=places, count=count)
