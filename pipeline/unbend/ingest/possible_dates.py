"""Checks the dates of stamps that a log has as Unix time, such as ``header.stamp`` of ROS.

Times since boot are set to UTC by `boot_clock`, which checks the dates of its sources by the same
rule.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from unbend.flight.channels import Channel, TimeArray
from unbend.flight.survey_dates import latest_ns
from unbend.ingest import messages
from unbend.ingest.flight_log import Contents
from unbend.ingest.message_tables import Table
from unbend.ingest.utc_evidence import (
    EARLIEST_NS,
    ROLLOVER_NS,
    Witness,
    date_text,
    is_possible,
    is_utc,
    is_utc_time,
    missed_rollovers,
)
from unbend.messages import Ledger
from unbend.units import Mask

TableReader = Callable[[str, str | None], Table]


def with_possible_dates(
    contents: Contents, witnesses: Sequence[Witness], ledger: Ledger
) -> Contents:
    """The contents, with channels of an impossible date moved to a possible date.

    They are moved by rollovers of the GPS week, on which the other clocks decide: that of the
    recorder, and the ``witnesses`` (mission file, name of the file). If no date can be accepted,
    the times of these channels count from their first sample, and UTC is unknown.
    """
    impossible = [channel for channel in contents.channels if _is_impossible(channel)]
    if not impossible:
        return contents
    clocks = list(witnesses)
    if contents.recorded_ns is not None:
        clocks.insert(0, Witness("log_time", contents.recorded_ns))
    rollovers = _reported_rollovers(impossible, clocks, ledger)
    if rollovers:
        shift_ns = rollovers * ROLLOVER_NS
        sigma_s = contents.utc_sigma_s
    else:
        shift_ns = -min(int(channel.time_ns[0]) for channel in impossible)
        sigma_s = float("nan")
    channels = []
    for channel in contents.channels:
        is_moved = any(channel is other for other in impossible)
        channels.append(_later(channel, shift_ns, ledger) if is_moved else channel)
    return replace(
        contents,
        channels=tuple(channels),
        table=_later_table(contents, shift_ns),
        utc_sigma_s=sigma_s,
    )


def _reported_rollovers(
    impossible: Sequence[Channel], clocks: Sequence[Witness], ledger: Ledger
) -> int:
    """How many rollovers the ``impossible`` channels lack; 0 if no date can be accepted.

    Either result is reported.
    """
    stated_ns = min(_middle_ns(channel) for channel in impossible)
    stated_date = date_text(stated_ns)
    names = ", ".join(channel.name for channel in impossible)
    rollovers = missed_rollovers(stated_ns, clocks, of_receiver=False)
    if rollovers:  # None if no date can be accepted; 0 would mean that the date is possible
        ledger.add(
            messages.week_rollover(
                where=names,
                source="their stamps",
                count=len(impossible),
                stated=stated_date,
                moved=date_text(stated_ns + rollovers * ROLLOVER_NS),
                rollovers=rollovers,
                clocks=clocks,
            )
        )
        return rollovers
    ledger.add(
        messages.utc_not_accepted(
            where=names, source="their stamps", stated=stated_date, clocks=clocks
        )
    )
    ledger.add(messages.no_utc(where=names, utc_of="possible date"))
    return 0


def _middle_ns(channel: Channel) -> int:
    """The time of the middle sample of a channel [ns]."""
    return int(channel.time_ns[len(channel) // 2])


def _is_impossible(channel: Channel) -> bool:
    """Whether a channel has times that are UTC, but of an impossible date."""
    if not len(channel):
        return False
    middle_ns = _middle_ns(channel)
    states_utc = is_utc_time(middle_ns)
    return states_utc and not is_possible(middle_ns)


def _later(channel: Channel, shift_ns: int, ledger: Ledger) -> Channel:
    """The channel with its times later by a shift [ns].

    Samples with a shifted time that does not fit 64 bits are dropped, and reported as a loss.
    """
    can_move = _can_move(channel.time_ns, shift_ns)
    if not can_move.all():
        ledger.add(
            messages.stray_rows(
                channel=channel.name,
                first=int(np.argmin(can_move)),
                count=int(np.count_nonzero(~can_move)),
                total=len(channel),
            )
        )
        channel = channel.rows(can_move)
    return replace(channel, time_ns=channel.time_ns + shift_ns)


def _can_move(time_ns: TimeArray, shift_ns: int) -> Mask:
    """(n,) whether times [ns] still fit 64 bits when the shift [ns] is added."""
    limits = np.iinfo(np.int64)
    can_move: Mask
    if shift_ns > 0:
        can_move = time_ns <= limits.max - shift_ns
    else:
        can_move = time_ns >= limits.min - shift_ns
    return can_move


def _later_table(contents: Contents, shift_ns: int) -> TableReader | None:
    """A function like ``contents.table`` that adds the shift [ns] to impossible times."""
    table = contents.table
    if table is None:
        return None

    def later(name: str, instance: str | None) -> Table:
        columns = table(name, instance)
        if "time_ns" in columns:
            time_ns = columns["time_ns"]
            is_possible_time = (time_ns >= EARLIEST_NS) & (time_ns <= latest_ns())
            is_moved = is_utc(time_ns) & ~is_possible_time & _can_move(time_ns, shift_ns)
            columns["time_ns"] = np.where(is_moved, time_ns + shift_ns, time_ns)
        return columns

    return later
