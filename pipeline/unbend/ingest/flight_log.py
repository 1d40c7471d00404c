"""The result of reading a log, and what the reader of a log format provides."""

import difflib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unbend.flight.channels import Channel
from unbend.ingest import messages
from unbend.ingest.message_tables import Table
from unbend.ingest.utc_evidence import ClockAssessment, Witness, is_utc_time
from unbend.messages import LOSSES, Ledger
from unbend.notebook import html_table

SIMILAR_NAMES = 3  # most names that the refusal of an unknown name suggests
LEAST_SIMILARITY = 0.5  # of a suggested name, by difflib: half of the letters


@dataclass(frozen=True)
class SecondClock:
    """A clock of a computer, in a log whose other times are of the vehicle's clock.

    channels : names of the channels with times of this clock.
    ahead_s : by how much it seems to be ahead of UTC by the vehicle's clock [s]; NaN if unknown.
    sigma_s : standard deviation of the difference of the two clocks [s].
    """

    channels: frozenset[str]
    ahead_s: float
    sigma_s: float


@dataclass(frozen=True, eq=False)
class Contents:
    """The result of reading a file of one format.

    messages : the number of messages by type or topic, wanted or not.
    channels : the decoded channels; in a `Log` they are sorted by name, and none is empty.
    bad_bytes : how many bytes belong to no valid message.
    lost_messages : how many messages are missing by the log's own numbers.
    boots : how many power-ups of the vehicle the log covers.
    time_base : where its UTC comes from, in words.
    table : decodes all messages of a type, or those of one instance; None if the format cannot.
    parameters : the settings of the vehicle as last logged.
    utc_sigma_s : sigma of its UTC [s], NaN where unknown.
    clocks : how good each clock of the log is.
    second_clock : the other clock of the log, None if all times are of one.
    recorded_ns : when it was recorded, by the recorder's clock [Unix ns]; None where unknown.
    unread_encodings : the encodings of messages that are not read, each with one of its topics.
    """

    messages: Mapping[str, int]
    channels: tuple[Channel, ...]
    bad_bytes: int
    lost_messages: int
    boots: int
    time_base: str
    table: Callable[[str, str | None], Table] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    utc_sigma_s: float = float("nan")
    clocks: tuple[ClockAssessment, ...] = ()
    second_clock: SecondClock | None = None
    recorded_ns: int | None = None
    unread_encodings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class LogFormat:
    """A log format and its reader.

    name : in results; title : in messages to the user.
    extensions : in lower case with the dot, the usual one first.
    matches : whether the first 64 KiB of a file look like this format.
    read : decodes the wanted messages; enters in the ledger what is damaged or skipped. The
        witnesses are further clocks that know the date.
    """

    name: str
    title: str
    extensions: tuple[str, ...]
    matches: Callable[[bytes], bool]
    read: Callable[[Path, Ledger, Sequence[Witness]], Contents]


@dataclass(frozen=True, eq=False, kw_only=True)
class Log(Contents):
    """A log that was read; its ``ledger`` lists what was repaired, assumed, skipped and lost.

    ``start_ns``, ``end_ns``: Unix time [ns] of the first and the last sample of any channel.
    """

    path: Path
    format: str
    sha256: str
    size_bytes: int
    start_ns: int
    end_ns: int
    ledger: Ledger

    def __repr__(self) -> str:
        """Name, format and time of the log, and how much is in it."""
        begin = utc_or_none(self.start_ns)
        since = "UTC unknown" if begin is None else f"from {begin[:19].replace('T', ' ')} UTC"
        count = sum(self.messages.values())
        losses = sum(message.kind in LOSSES for message in self.ledger)
        return (
            f"<Log {self.path.name}: {self.format}, {self.duration_s:.1f} s, {since}; "
            f"{len(self.channels)} channels, {count:,} messages of {len(self.messages)} types, "
            f"{self.bad_bytes:,} bad bytes, {losses} losses and findings>"
        )

    def _repr_html_(self) -> str:
        """The channels, as a notebook shows them."""
        columns = {
            "channel": [channel.name for channel in self.channels],
            "samples": [len(channel) for channel in self.channels],
            "rate_hz": [round(channel.rate_hz, 2) for channel in self.channels],
            "columns": [", ".join(sorted(channel.columns)) for channel in self.channels],
        }
        return html_table(repr(self), columns)

    @property
    def has_utc(self) -> bool:
        """Whether all times are UTC; if False, the times of some boots count from the boot."""
        return is_utc_time(self.start_ns)

    @property
    def duration_s(self) -> float:
        """The time from the first sample to the last [s]."""
        return (self.end_ns - self.start_ns) / 1e9

    def channel(self, name: str) -> Channel:
        """The channel of that name. Raises LogError (LOG-NO-CHANNEL), with the names that exist."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        available = _available(name, [channel.name for channel in self.channels])
        raise messages.no_channel(path=str(self.path), name=name, available=available)

    def to_pandas(self, name: str) -> Any:
        """One channel as a pandas DataFrame, indexed by time.

        The index is UTC; in boots without UTC it is the time since boot, counted from 1970 (see
        ``has_utc``). Raises LogError (LOG-NO-CHANNEL).
        """
        return self.channel(name).to_pandas()

    def message_types(self) -> dict[str, int]:
        """Every message type or topic of the log, wanted or not, with its count."""
        return dict(self.messages)

    def message(self, name: str, instance: str | None = None) -> Table:
        """All messages of one type as columns of one length, with the log's names and units.

        ``name``: a type or topic of `message_types`, or a channel, upper or lower case.
        ``instance``: only the messages of this instance. None: those of the instance of the channel
        if ``name`` is a channel, else all. The rows are in the order of the file, damaged ones
        included. Raises LogError (LOG-NO-TYPE, LOG-NO-TABLE).
        """
        kind, instance_of_channel = self._type_of(name)
        if instance is None:
            instance = instance_of_channel
        if kind not in self.messages:
            available = _available(kind, sorted(self.messages))
            raise messages.no_message_type(path=str(self.path), name=kind, available=available)
        columns = self.table(kind, instance) if self.table else {}
        if not columns:
            raise messages.no_table(path=str(self.path), name=kind, instance=instance)
        return columns

    def _type_of(self, name: str) -> tuple[str, str | None]:
        """The message type that a user's name means; the instance too if it is that of a channel.

        Tried in this order: a type as written, a type in upper or lower case, a channel. An unknown
        name is returned as it is, with the instance None.
        """
        if name in self.messages:
            return name, None
        for kind in self.messages:
            if kind.lower() == name.lower():
                return kind, None
        for channel in self.channels:
            if channel.name.lower() == name.lower():
                return channel.source.message, channel.source.instance
        return name, None

    def message_to_pandas(self, name: str, instance: str | None = None) -> Any:
        """All messages of one type as a pandas DataFrame."""
        import pandas as pd

        columns: dict[str, Any] = {}
        for column_name, column in self.message(name, instance).items():
            # a field that is an array itself is one object a row
            columns[column_name] = column if column.ndim == 1 else list(column)
        return pd.DataFrame(columns)

    def to_json_dict(self) -> dict[str, Any]:
        """A summary of the log for ``unbend inspect --json``."""
        from unbend.ingest.overview import receivers_of, roles_of, vehicles_of

        vehicles = vehicles_of(self.channels)
        flight, roles = roles_of(self.channels)
        if vehicles:  # with several, "flight" and "roles" of the log are those of the first vehicle
            flight = vehicles[0]["flight"]
            roles = vehicles[0]["roles"]
        return {
            "format": self.format,
            "sha256": self.sha256,
            "size_bytes": self.size_bytes,
            "messages": self.messages,
            "bad_bytes": self.bad_bytes,
            "lost_messages": self.lost_messages,
            "boots": self.boots,
            "channels": [describe(channel) for channel in self.channels],
            "start_utc": utc_or_none(self.start_ns),
            "end_utc": utc_or_none(self.end_ns),
            "duration_s": self.duration_s,
            "flight": flight,
            "roles": roles,
            "vehicles": vehicles,
            "receivers": receivers_of(self.channels),
            "time_base": self.time_base,
            "clocks": [vars(assessment) for assessment in self.clocks],
            "ledger": self.ledger.rows(),
        }


def _available(name: str, names: list[str]) -> str:
    """The ``names`` that a log has, in words; those similar to the unknown ``name`` come first."""
    similar = difflib.get_close_matches(name, names, n=SIMILAR_NAMES, cutoff=LEAST_SIMILARITY)
    listed = f"this log has {', '.join(names)}"
    if not similar:
        return listed
    return f"perhaps {', '.join(similar)}? {listed}"


def utc_text(time_ns: int) -> str:
    """Unix time [ns] as ISO 8601 with microseconds.

    >>> utc_text(1_482_451_200_000_000_000)
    '2016-12-23T00:00:00.000000Z'
    """
    return f"{np.datetime64(time_ns // 1000, 'us')}Z"


def utc_or_none(time_ns: int) -> str | None:
    """A time of a log [ns] as ISO 8601 if it is UTC; None if it counts from a boot.

    >>> utc_or_none(90_000_000_000) is None
    True
    """
    return utc_text(time_ns) if is_utc_time(time_ns) else None


def describe(channel: Channel) -> dict[str, Any]:
    """A summary of a channel for ``unbend inspect --json``."""
    steps = np.diff(channel.time_ns) / 1e9
    # events and texts come irregularly, and fewer than three samples have no rate
    has_rate = "events" not in channel.roles and bool(channel.columns) and len(channel) >= 3
    rows_before_gaps = []
    if has_rate:
        rows_before_gaps = np.flatnonzero(steps > channel.gap_limit_s()).tolist()
    listed_gaps = []
    for row in rows_before_gaps:
        start = utc_or_none(int(channel.time_ns[row]))
        listed_gaps.append({"start_utc": start, "seconds": float(steps[row])})
    return {
        "name": channel.name,
        "roles": list(channel.roles),
        "columns": sorted(channel.columns),
        "samples": len(channel),
        "rate_hz": channel.rate_hz,
        "start_utc": utc_or_none(int(channel.time_ns[0])),
        "end_utc": utc_or_none(int(channel.time_ns[-1])),
        "gaps": listed_gaps,
    }


def hash_file(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
