"""Senders of MAVLink messages: components of systems."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.ingest.message_tables import rows_by_value
from unbend.units import Rows

_COMPONENTS = 256  # that a system can have: the number is a byte


class Sender(NamedTuple):
    """A component of a system.

    >>> Sender(1, 100).number, Sender.of_number(356), str(Sender(1, 100))
    (356, Sender(system=1, component=100), 'system 1, component 100')
    """

    system: int
    component: int

    @classmethod
    def of_number(cls, number: int) -> "Sender":
        """The sender with this `number`."""
        return cls(*divmod(number, _COMPONENTS))

    @property
    def number(self) -> int:
        """System and component as one number, as in the column ``source`` of messages."""
        return self.system * _COMPONENTS + self.component

    def __str__(self) -> str:
        return f"system {self.system}, component {self.component}"


def sender_numbers(
    system: NDArray[np.uint8],
    component: NDArray[np.uint8],
) -> NDArray[np.uint16]:
    """The numbers (`Sender.number`) of (n,) systems and components."""
    numbers = system.astype(np.uint16) * _COMPONENTS
    numbers += component
    return numbers


def systems_of(numbers: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The systems of (n,) numbers of senders."""
    return np.asarray(numbers // _COMPONENTS, np.uint16)


def components_of(numbers: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The components of (n,) numbers of senders."""
    return np.asarray(numbers % _COMPONENTS, np.uint16)


def by_sender(rows: NDArray[Any]) -> Iterator[tuple[Sender, Rows | slice]]:
    """The senders in the column ``source`` (`Sender.number`) of messages, and the rows of each."""
    numbers = rows["source"]
    is_one_sender = numbers.size > 0 and bool(np.all(numbers == numbers[0]))
    if is_one_sender:
        sender = Sender.of_number(int(numbers[0]))
        yield sender, slice(None)
        return
    for number, rows_of_sender in rows_by_value(numbers):
        yield Sender.of_number(number), rows_of_sender
