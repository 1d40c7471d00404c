"""Messages of the reader of MCAP logs: codes, and a function for each message and refusal."""

import math
from collections.abc import Sequence
from dataclasses import replace

from unbend.errors import Code, Counted, LogError
from unbend.ingest.messages import (
    LOG_BAD_BYTES,
    LOG_CRC,
    LOG_LINK_LOSS,
    LOG_NO_TABLE,
    LOG_TOO_LARGE,
    LOG_TRUNCATED,
    TIME_NO_UTC,
)
from unbend.messages import Message, fallback, finding, loss, note

# Damage of the file; the count is in bytes.


def file_beginning_damaged(*, where: str, count: int) -> Message:
    """The first bytes are not those of an MCAP."""
    return loss(
        LOG_BAD_BYTES,
        "the file does not begin as an MCAP: its first bytes are damaged or lost",
        where=where,
        count=count,
    )


def file_end_damaged(*, where: str, count: int) -> Message:
    """The mark of the format does not follow the footer, or other bytes follow the mark."""
    return loss(
        LOG_BAD_BYTES,
        "{extra} follow the end of the log, or its mark is damaged",
        one="{extra} follows the end of the log, or its mark is damaged",
        where=where,
        count=count,
        extra=Counted(count, "byte"),
    )


def not_a_record(*, where: str, count: int) -> Message:
    """Bytes between two proved records are not a record."""
    return loss(
        LOG_BAD_BYTES,
        "{count} bytes are not a record, or are part of a record with a damaged length",
        one="1 byte is not a record, or is part of a record with a damaged length",
        where=where,
        count=count,
    )


def definition_unreadable(*, where: str, count: int, opcode: int, reason: str) -> Message:
    """The library cannot parse a schema, channel or statistics record."""
    return loss(
        LOG_BAD_BYTES,
        "a definition (opcode {opcode}) cannot be read: {reason}",
        where=where,
        count=count,
        opcode=opcode,
        reason=reason,
    )


def chunk_head_invalid(*, where: str, count: int) -> Message:
    """The lengths in the head of a chunk contradict each other."""
    return loss(LOG_BAD_BYTES, "a chunk has no valid header", where=where, count=count)


def compression_unknown(*, where: str, count: int, compression: str) -> Message:
    """A chunk is compressed in a way that MCAP does not define."""
    return loss(
        LOG_BAD_BYTES,
        "a chunk is compressed with {compression!r}, which is unknown",
        where=where,
        count=count,
        compression=compression,
    )


def chunk_not_inflated(*, where: str, count: int, reason: str) -> Message:
    """The library cannot inflate a chunk."""
    return loss(
        LOG_BAD_BYTES,
        "a chunk cannot be decompressed ({reason})",
        where=where,
        count=count,
        reason=reason,
    )


def chunk_of_another_size(*, where: str, count: int, size: int, stated: int) -> Message:
    """A chunk inflates to another size than its head states.

    A chunk that is too large is not inflated to its end: ``size`` is then only more than stated.
    """
    inflated = str(Counted(size, "byte")) if size < stated else "more"
    return loss(
        LOG_BAD_BYTES,
        "a chunk is decompressed to {inflated}, but its header states {stated}",
        where=where,
        count=count,
        inflated=inflated,
        stated=stated,
    )


def chunk_not_records(*, where: str, count: int, size: int) -> Message:
    """Bytes inside an inflated chunk are not a record."""
    return loss(
        LOG_BAD_BYTES,
        "{count} of {size} bytes of a chunk are not a record",
        one="1 of {size} bytes of a chunk is not a record",
        where=where,
        count=count,
        size=size,
    )


def chunk_end_not_records(*, where: str, count: int, size: int) -> Message:
    """The last bytes of a large chunk are not a record."""
    return loss(
        LOG_BAD_BYTES,
        "the last {count} of {size} bytes of a chunk are not a record",
        where=where,
        count=count,
        size=size,
    )


def chunk_checksum_fails(*, where: str, count: int) -> Message:
    """The checksum in the head of a chunk is not that of its inflated records."""
    return loss(LOG_CRC, "a chunk fails its checksum", where=where, count=count)


def summary_checksum_fails(*, where: str) -> Message:
    """The checksum in the footer is not that of the summary."""
    return loss(
        LOG_CRC,
        "the summary is not at the place that the footer states, or fails its checksum",
        where=where,
    )


def data_checksum_fails(*, where: str) -> Message:
    """The checksum at the end of the data is not that of the data."""
    return loss(LOG_CRC, "the data section fails its checksum", where=where)


_NO_FOOTER = (
    "without the footer that a closed MCAP has: the recorder died or the copy is incomplete, and "
    "all later data is lost"
)


def no_footer(*, where: str, count: int) -> Message:
    """The file ends between two records."""
    return loss(LOG_TRUNCATED, f"the file ends {_NO_FOOTER}", where=where, count=count)


def record_cut_off(*, where: str, count: int, length: int, opcode: int) -> Message:
    """The file ends in a record."""
    return loss(
        LOG_TRUNCATED,
        "a record of {length} (opcode {opcode}) where {left} are left: it ends " + _NO_FOOTER,
        one="a record of {length} (opcode {opcode}) where {left} is left: it ends " + _NO_FOOTER,
        where=where,
        count=count,
        length=Counted(length, "byte"),
        opcode=opcode,
        left=Counted(count, "byte"),
    )


def more_places(*, like: Message, places: int, count: int) -> Message:
    """Further damage of the kind of ``like``, the last of those that are named one by one."""
    values = {"places": Counted(places, "more place")}
    return replace(like, text="{places} like that", count=count, values=values)


# What is larger than reason allows.


def chunk_too_large(
    *, where: str, count: int, packed: int, size: int, largest: int, ratio: int, free: int
) -> Message:
    """A chunk would inflate to more than any recorder writes.

    The limit is ``largest`` [bytes], and beyond ``free`` [bytes] ``ratio`` times the packed size.
    """
    return loss(
        LOG_TOO_LARGE,
        (
            "a chunk of {packed} would be decompressed to {size}; the limit is {largest}, and "
            "beyond {free} it is {ratio} times the size of the chunk: it is skipped"
        ),
        where=where,
        count=count,
        packed=Counted(packed, "byte"),
        size=size,
        largest=largest,
        ratio=ratio,
        free=free,
    )


def chunks_too_large(
    *, where: str, count: int, packed: int, size: int, left: int, limit: int
) -> Message:
    """All chunks together would inflate to more bytes than a file of this size may have."""
    return loss(
        LOG_TOO_LARGE,
        (
            "a chunk of {packed} would be decompressed to {size}; all chunks of a file of this "
            "size may have {limit} bytes, and {left} of these remain: it is skipped"
        ),
        where=where,
        count=count,
        packed=Counted(packed, "byte"),
        size=size,
        left=left,
        limit=limit,
    )


def definition_too_large(*, where: str, count: int, opcode: int) -> Message:
    """A schema, channel or statistics record of many MiB."""
    return loss(
        LOG_TOO_LARGE,
        "a definition of {length} (opcode {opcode}) is skipped",
        where=where,
        count=count,
        length=Counted(count, "byte"),
        opcode=opcode,
    )


def too_many_messages(*, where: str, count: int, rows: int, left: int, limit: int) -> Message:
    """All chunks together contain more messages than a file of this size may have."""
    return loss(
        LOG_TOO_LARGE,
        (
            "a chunk contains {rows} messages; all chunks of a file of this size may contain "
            "{limit}, and {left} of these remain: they are skipped"
        ),
        where=where,
        count=count,
        rows=rows,
        left=left,
        limit=limit,
    )


def objects_too_large(*, topic: str, count: int, limit: int) -> Message:
    """Messages of JSON or protobuf, parsed one by one, exceed what a file of this size may have."""
    return loss(
        LOG_TOO_LARGE,
        "{count} messages are not parsed: all messages of JSON and protobuf of a file of this size "
        "may have {limit} bytes",
        one="1 message is not parsed: all messages of JSON and protobuf of a file of this size may "
        "have {limit} bytes",
        where=topic,
        count=count,
        limit=limit,
    )


def too_many_elements(*, file: str, count: int) -> Message:
    """Messages have more texts and elements of sequences than a log of this size may have."""
    return loss(
        LOG_TOO_LARGE,
        (
            "{count} messages are not decoded: they have more elements of sequences that must be "
            "read one by one than a file of this size may have"
        ),
        one=(
            "1 message is not decoded: it has more elements of sequences that must be read one by "
            "one than a file of this size may have"
        ),
        where=file,
        count=count,
    )


def too_many_names(*, topic: str, count: int, most: int) -> Message:
    """The messages of a topic have more names than a log of values has."""
    return loss(
        LOG_TOO_LARGE,
        "{count} messages come after {most} different names: their values are not read",
        one="1 message comes after {most} different names: its values are not read",
        where=topic,
        count=count,
        most=most,
    )


# Contradictions, and messages that are missing.

LOG_INCONSISTENT = Code(
    "LOG-INCONSISTENT",
    means="The counts or definitions of the log contradict its content.",
    effect="The data that was read is used. If a definition occurs twice, the first is used.",
    remedy="Copy the log again, or recover it with the mcap tool.",
)


def summary_elsewhere(*, where: str, stated: int, found: int) -> Message:
    """The summary does not begin where the data end."""
    return loss(
        LOG_INCONSISTENT,
        (
            "the footer states that the summary begins at byte {stated}, but the data end at "
            "{found}: a part of the file is missing"
        ),
        where=where,
        stated=stated,
        found=found,
    )


def data_end_missing(*, where: str, stated: int) -> Message:
    """The log has a footer, but no record that ends the data."""
    return loss(
        LOG_INCONSISTENT,
        (
            "the footer states that the summary begins at byte {stated}, but no record ends the "
            "data: a part of the file is missing"
        ),
        where=where,
        stated=stated,
    )


def data_end_twice(*, where: str) -> Message:
    """A second record ends the data."""
    return loss(
        LOG_INCONSISTENT,
        "the data end a second time: their checksum here is not checked",
        where=where,
    )


def definitions_differ(*, file: str, count: int, examples: Sequence[str]) -> Message:
    """Schemas or channels of one number are defined twice, in different ways."""
    return loss(
        LOG_INCONSISTENT,
        "{count} definitions come twice and differ ({examples}): the first is used",
        one="1 definition comes twice and differs ({examples}): the first is used",
        where=file,
        count=count,
        examples=", ".join(examples),
    )


def statistics_differ(*, file: str, read: int, stated: int, topics: Sequence[str]) -> Message:
    """The log's statistics state other counts than were read; ``topics``: those that differ."""
    differ = f"; they differ for {', '.join(topics)}" if topics else ""
    return loss(
        LOG_INCONSISTENT,
        "{messages} read, the log's statistics state {stated}{differ}",
        where=file,
        count=max(abs(stated - read), 1),  # in all they may agree while those of topics differ
        messages=f"{Counted(read, 'message')} {'was' if read == 1 else 'were'}",
        stated=stated,
        differ=differ,
    )


LOG_NO_STATISTICS = Code(
    "LOG-NO-STATISTICS",
    means="The log has no statistics. So it cannot be checked whether the log is complete.",
    effect="None.",
    remedy="Nothing.",
)


def no_statistics(*, file: str) -> Message:
    """An undamaged log does not state how many messages it has."""
    return note(
        LOG_NO_STATISTICS,
        "the log has no statistics: it cannot be checked whether the log is complete",
        where=file,
    )


def no_channel_of_messages(*, file: str, count: int) -> Message:
    """The definition of a channel is missing; the count is in messages."""
    return loss(
        LOG_BAD_BYTES,
        "{count} messages belong to no channel",
        one="1 message belongs to no channel",
        where=file,
        count=count,
    )


def lost_by_recorder(*, topic: str, count: int) -> Message:
    """The sequence numbers of a topic have gaps."""
    return finding(
        LOG_LINK_LOSS,
        "the log is incomplete: {count} messages are missing by their sequence numbers: the "
        "recorder did not get them, or they are damaged",
        one="the log is incomplete: 1 message is missing by its sequence number: the recorder did "
        "not get it, or it is damaged",
        where=topic,
        count=count,
    )


LOG_REORDERED = Code(
    "LOG-REORDERED",
    means=(
        "The order of the messages in the file differs from the order of their numbers and times."
    ),
    effect="They are sorted.",
    remedy="Nothing.",
)


def messages_reordered(*, topic: str, first: int, count: int, total: int) -> Message:
    """A topic's messages are sorted by their sequence numbers; their times are then in order."""
    return note(
        LOG_REORDERED,
        (
            "{count} of {total} messages are not in the order of their numbers and times: they are "
            "sorted"
        ),
        where=f"{topic}, first at row {first}",
        count=count,
        total=total,
    )


# Topics that are not read.

LOG_NOT_ROS2 = Code(
    "LOG-NOT-ROS2",
    means="A topic is encoded neither as ROS 2 CDR nor as protobuf or JSON.",
    effect="It is counted, not read.",
    remedy="Record it in one of these encodings, if it is needed.",
)


def encoding_not_read(*, topic: str, schema: str, encoding: str, schema_encoding: str) -> Message:
    """A wanted message is in an encoding that is not read."""
    return note(
        LOG_NOT_ROS2,
        "{schema} is encoded as {encoding} with a {schema_encoding} schema, not as ROS 2 CDR, "
        "protobuf or JSON: counted, not read",
        where=topic,
        schema=schema,
        encoding=encoding,
        schema_encoding=schema_encoding,
    )


LOG_NO_PROTOBUF = Code(
    "LOG-NO-PROTOBUF",
    means="A topic is protobuf, and the package mcap-protobuf-support is not installed.",
    effect="The topic is not read.",
    remedy="pip install mcap-protobuf-support.",
)


def protobuf_not_installed(*, topic: str, schema: str) -> Message:
    """A wanted message is protobuf, without the package that decodes it."""
    return loss(
        LOG_NO_PROTOBUF,
        "{schema} is protobuf, which needs the package mcap-protobuf-support: counted, not read",
        where=topic,
        schema=schema,
    )


LOG_SCHEMA = Code(
    "LOG-SCHEMA",
    means="The schema of a topic cannot be parsed.",
    effect="The topic is not read.",
    remedy="Record it with a valid schema.",
)


def schema_not_parsed(*, topic: str, schema: str, reason: str) -> Message:
    """The definition of a wanted message is damaged, or uses what is not read."""
    return loss(
        LOG_SCHEMA,
        "the schema of {schema} cannot be parsed ({reason}): the topic is not read",
        where=topic,
        schema=schema,
        reason=reason,
    )


LOG_DECODE = Code(
    "LOG-DECODE",
    means="Messages of a topic cannot be decoded, or have other values where numbers are needed.",
    effect="They are missing.",
    remedy="Check the recorder and the schema of the topic.",
)


def messages_not_decoded(*, topic: str, schema: str, count: int) -> Message:
    """Messages do not fit their schema; JSON of the user's own has none."""
    if not schema:
        return loss(
            LOG_DECODE,
            "{count} messages cannot be read as JSON objects",
            one="1 message cannot be read as a JSON object",
            where=topic,
            count=count,
        )
    return loss(
        LOG_DECODE,
        "{count} messages do not fit their schema {schema}",
        one="1 message does not fit its schema {schema}",
        where=topic,
        count=count,
        schema=schema,
    )


def values_not_numbers(*, topic: str, count: int) -> Message:
    """Values of wanted fields are texts or objects."""
    return loss(
        LOG_DECODE,
        "{count} values are not numbers, although numbers are needed: they are missing",
        one="1 value is not a number, although a number is needed: it is missing",
        where=topic,
        count=count,
    )


def topic_without_table(*, file: str, name: str, reason: str) -> LogError:
    """A topic gives no table, because it cannot be decoded."""
    return LogError(
        LOG_NO_TABLE,
        "{name} has no rows that can be written as a table: {reason}",
        where=file,
        remedy="choose another topic that `unbend inspect` lists",
        name=name,
        reason=reason,
    )


# Time.

TIME_LOG_TIME = Code(
    "TIME-LOG-TIME",
    means=(
        "Messages have no time stamp, or their time stamp has no relation to UTC. The recorder's "
        "time is used."
    ),
    effect="Exposures may be late by the delay of the transport.",
    remedy="Record header.stamp, or GNSS messages.",
)


def set_by_log_time(*, boot: int, count: int, sigma_s: float) -> Message:
    """No GNSS message of a boot ties the time since boot to UTC."""
    return fallback(
        TIME_LOG_TIME,
        (
            "time counts from boot, and no GNSS message with a fix gives its UTC: the clock is set "
            "by the recorder's time, and UTC is accurate to {sigma_s:.0f} s (1 sigma)"
        ),
        where=f"boot {boot}",
        count=count,
        sigma_s=sigma_s,
    )


TIME_TWO_CLOCKS = Code(
    "TIME-TWO-CLOCKS",
    means=(
        "A log has channels with times of the vehicle's clock and channels with times of a "
        "computer's clock. The recorder's times show how far the clocks differ."
    ),
    effect=(
        "Times are not changed. The sigma of the difference is in the sigmas of stations that are "
        "made of channels of both clocks."
    ),
    remedy=(
        "Let the computer and the vehicle use one clock (PX4: UXRCE_DDS_SYNCT), or use exposures "
        "of the vehicle's clock."
    ),
)


def two_clocks(*, channels: Sequence[str], ahead_s: float, sigma_s: float) -> Message:
    """Some channels for stations have times of a computer's clock, others of the vehicle's.

    ``ahead_s``: by how much the computer's clock seems to be ahead, NaN if unknown.
    """
    measured = f", which seems {ahead_s:+.2f} s ahead of the vehicle's"
    if math.isnan(ahead_s):
        measured = ""
    return fallback(
        TIME_TWO_CLOCKS,
        "the times are of a computer's clock{measured}; sigma of the difference {sigma_s:.2f} s",
        where=", ".join(channels),
        measured=measured,
        sigma_s=sigma_s,
    )


def messages_without_stamp(*, topic: str, count: int) -> Message:
    """Messages have no time of their own."""
    return fallback(
        TIME_LOG_TIME,
        "{count} messages have no header.stamp: the recorder's time is used",
        one="1 message has no header.stamp: the recorder's time is used",
        where=topic,
        count=count,
    )


def stamps_before_2001(*, topic: str) -> Message:
    """Time stamps are neither UTC nor a time since boot."""
    return fallback(
        TIME_NO_UTC,
        (
            "time stamps before 2001 are not UTC (simulated time?): events in this log can be "
            "used, matching by UTC is impossible"
        ),
        where=topic,
    )
