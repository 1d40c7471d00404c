"""Tables of an ArduPilot log, binary or text -> channels, in UTC by the GNSS receivers."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.flight.channels import ROLE_COLUMNS, Channel, Source, TimeArray
from unbend.flight.clock import SECONDS_PER_WEEK, STRAY_ROWS, utc_of_gps
from unbend.ingest.attitude import QUATERNION
from unbend.ingest.boot_clock import BootClock, fit_clock
from unbend.ingest.buffers import FileView, copy_rows, gather
from unbend.ingest.channel_builder import DecodedRows, channel_of, with_both_heights
from unbend.ingest.dataflash import messages
from unbend.ingest.dataflash.dataflash_records import RecordBlock, RecordWalker
from unbend.ingest.dataflash.record_definitions import HEADER
from unbend.ingest.dataflash.record_tables import INSTANCE_FIELDS
from unbend.ingest.field_maps import MAPS, MessageMap, extract, is_number, message_maps
from unbend.ingest.limits import SeriesLimit
from unbend.ingest.message_tables import PLACE, Table
from unbend.ingest.timelines import Stamps, Timeline, microseconds, nanoseconds, report_timeline
from unbend.ingest.utc_evidence import Witness
from unbend.ingest.utc_readings import UtcReadings, rows_of
from unbend.messages import Ledger
from unbend.units import Integers, Mask, whole_numbers

RECEIVERS = ("GPS", "GPS2")
_WEEKS = 1 << 13  # GPS weeks until 2137; single wrong weeks below do not change a median
_MS_PER_WEEK = SECONDS_PER_WEEK * 1000
_UTC_FIELDS = {"GMS", "GWk", "Status"}  # of a receiver
_FIELDS_OF_TIME = (*_UTC_FIELDS, "Week", "T")  # ... with their names until 2015
STRAY_SHARE = 100  # times as many rows has another instance, if one with few rows is damage

MESSAGES: Mapping[str, MessageMap] = message_maps("dataflash")

# Accuracy and the ellipsoidal height come in a message of their own, at the time of the GPS row.
ACCURACY_MESSAGES = {"GPS": "GPA", "GPS2": "GPA2"}
_ACCURACY_MAP = message_maps("dataflash_accuracy")["GPA"]
# Statistics of a logger, of its card and of its link: Dp counts messages dropped since boot.
DROP_COUNTERS = ("DSF", "DMS")
ACCURACY_FIELDS = [field for column in _ACCURACY_MAP.columns for field in column.fields]


def texts_of(message: str, field: str, table: Table) -> tuple[str, ...] | None:
    """The text of each row of MSG, EV or ERR, from the given field.

    MSG has texts. EV and ERR have numbers, which get their names from `MAPS`; ERR also has an error
    code. None if the field is absent or of another kind.

    >>> texts_of("ERR", "Subsys", {"Subsys": np.array([16], "u1"), "ECode": np.array([2], "u1")})
    ('ERR EKFCHECK 2',)
    """
    values = table.get(field)
    kind = "U" if message == "MSG" else "u"
    if values is None or values.dtype.kind != kind:
        return None
    if message == "MSG":
        return tuple(values.tolist())
    name_of_number = MAPS["dataflash_numbers"][message]
    error_codes = [""] * values.shape[0]
    if "ECode" in table:
        error_codes = table["ECode"].tolist()
    texts = []
    for number, error_code in zip(values.tolist(), error_codes, strict=True):
        name = name_of_number.get(str(number), number)
        texts.append(f"{message} {name} {error_code}".strip())
    return tuple(texts)


def instance_of(table: Table) -> NDArray[Any]:
    """(n,) number of the instance (sensor, core) of each row; -1 in messages without instances.

    Only integers are instances: the field I of PID messages is an integral gain.
    """
    for field in INSTANCE_FIELDS:
        if field in table and table[field].dtype.kind in "iu":
            return table[field]
    return np.full(_length(table), -1, np.int8)


def _length(table: Table) -> int:
    """How many rows a table has."""
    for column in table.values():
        return len(column)
    return 0


def stamps(data: FileView, walker: RecordWalker) -> Iterator[Stamps]:
    """Read the log; yield places and times since boot [ns] of records that begin with a time.

    When all is yielded, the ``walker`` knows all records.
    """
    for block in walker.blocks():
        time_fields = [form.time_field for form in walker.definitions]
        places, time_us = _times_of_block(data, block, time_fields)
        if places.size:
            yield places, time_us * 1000


def _times_of_block(
    data: FileView, block: RecordBlock, time_fields: list[str]
) -> tuple[Integers, TimeArray]:
    """Places in the file and times since boot [us] of the records that begin with a time.

    ``time_fields``: for each definition TimeUS or TimeMS if that is its first field, else "".
    """
    has_time = np.array([bool(field) for field in time_fields])[block.numbers]
    offsets = block.at[has_time].astype(np.int64)
    if not offsets.size:
        return offsets, offsets
    raw = data.array(block.base, block.end())
    time_us = microseconds(gather(raw, offsets + HEADER, 8).view("<u8"))
    is_definition_in_ms = np.array([field == "TimeMS" for field in time_fields])
    if is_definition_in_ms.any():  # TimeMS has 4 bytes, not the 8 that were read
        in_ms = is_definition_in_ms[block.numbers[has_time]]
        time_ms = gather(raw, offsets[in_ms] + HEADER, 4).view("<u4")
        time_us[in_ms] = time_ms * np.int64(1000)
    return offsets + block.base, time_us


def clock_of(
    line: Timeline,
    tables: Mapping[str, Table],
    ledger: Ledger,
    witnesses: Sequence[Witness] = (),
) -> tuple[BootClock, str]:
    """The clock of a log from the rows of its GNSS receivers, and the origin of its UTC in words.

    ``witnesses``: other clocks that know its date.
    """
    report_timeline(line, ledger)
    sources: list[UtcReadings] = []
    for name in RECEIVERS:
        if name in tables:
            sources += _receiver_utc(tables[name], name, ledger)
    clock = fit_clock(
        line, sources, ledger, utc_of="GPS row with a fix and a week", witnesses=witnesses
    )
    return clock, _time_base(clock)


def _time_base(clock: BootClock) -> str:
    """Where the UTC of a log comes from, in words."""
    unknown = clock.utc_known.count(False)
    if unknown:
        boots = len(clock.fits)
        return f"vehicle clock; UTC is unknown in {unknown} of {boots} boots"
    rows = 0
    for fit in clock.fits:
        if fit is not None:
            rows += fit.rows
    return f"vehicle clock, set to UTC by the median of {rows} GPS rows"


def _receiver_utc(table: Table, name: str, ledger: Ledger) -> Iterator[UtcReadings]:
    """The UTC readings of each receiver (instance) in a table of GPS rows.

    None, with a report, if the table lacks a field. Rows with an impossible week or time are left
    out.
    """
    absent = sorted(_UTC_FIELDS - set(table))
    if absent:
        count = table[PLACE].size
        ledger.add(messages.no_utc_fields(message=name, count=count, fields=absent))
        return
    week = table["GWk"]
    week_ms = table["GMS"].astype(np.float64)  # integers of 16 bits cannot be compared with a week
    is_week_known = (week > 0) & (week < _WEEKS)
    is_time_known = (week_ms >= 0) & (week_ms < _MS_PER_WEEK)
    has_utc = is_week_known & is_time_known
    instance = instance_of(table)
    for number in np.unique(instance[has_utc]):
        rows = has_utc & (instance == number)
        receiver = table  # if all rows are of this receiver, they are not copied: a log may be long
        if not bool(rows.all()):
            needed_fields = (PLACE, "TimeUS", *_UTC_FIELDS)
            receiver = {field: table[field][rows] for field in needed_fields}
        label = name
        if number >= 0:
            label = f"{name}[{number}]"
        places = receiver[PLACE]
        yield rows_of(
            label,
            places=places,
            boot_ns=nanoseconds(receiver["TimeUS"]),
            utc_ns=utc_of_gps(receiver["GWk"], receiver["GMS"] / 1000.0),
            usable=np.ones(places.shape, np.bool_),
            fix=receiver["Status"],
            from_gps_week=True,
        )


def wanted_fields() -> dict[str, Callable[[str], bool]]:
    """The names of the messages that are read, each with a test whether a field of it is read."""
    always = {"TimeUS", "TimeMS", *INSTANCE_FIELDS}
    fields: dict[str, set[str]] = {}
    for name, spec in MESSAGES.items():
        fields[name] = always | spec.fields | {spec.id_field, spec.text_field}
    for name in RECEIVERS:
        fields[name] |= set(_FIELDS_OF_TIME)
    for name in ACCURACY_MESSAGES.values():
        fields[name] = always | set(ACCURACY_FIELDS)
    fields["ERR"] |= {"ECode"}
    fields["PARM"] = {"TimeUS", "Name", "Value"}
    for name in DROP_COUNTERS:
        fields[name] = {"TimeUS", "TimeMS", "Dp"}
    return {name: names.__contains__ for name, names in fields.items()}


def channels_of(
    tables: dict[str, Table],
    parameters: Mapping[str, float],
    clock: BootClock,
    ledger: Ledger,
) -> tuple[Channel, ...]:
    """The channels of the messages in `MESSAGES`.

    Their tables are removed from ``tables``, so that no table is in memory twice.
    """
    channels = []
    limit = SeriesLimit()
    for message, spec in MESSAGES.items():
        rows_of_message = _rows_of_message(message, spec, tables, clock, ledger, limit=limit)
        for rows in rows_of_message:
            channel = channel_of(rows, spec, ledger)
            if channel is not None:
                channels.append(channel)
    limit.report(ledger, "")
    return tuple(with_both_heights(channels, parameters, ledger, "PARM"))


class _RowTimes(NamedTuple):
    """The UTC [ns] and the boot of (n,) rows of a message; ``good``: False for stray times."""

    time_ns: TimeArray
    boot: NDArray[np.int16]
    good: Mask


def _row_times(table: Table, clock: BootClock) -> _RowTimes:
    """The times of the rows of a table."""
    places = table[PLACE]
    utc_ns = clock.utc(places, nanoseconds(table["TimeUS"]))
    boot = clock.line.boot_of(places)
    return _RowTimes(
        time_ns=copy_rows(utc_ns),
        boot=copy_rows(boot),
        good=clock.line.good(places),
    )


def _rows_of_message(
    message: str,
    spec: MessageMap,
    tables: dict[str, Table],
    clock: BootClock,
    ledger: Ledger,
    *,
    limit: SeriesLimit,
) -> Iterator[DecodedRows]:
    """Yield the rows of each instance of a message, from which its channels are built.

    The table of the message, and that of its accuracy, are removed from ``tables``: memory has its
    peak here.
    """
    if message not in tables:
        return
    table = tables.pop(message)
    times = _row_times(table, clock)
    if spec.text_field:
        yield from _text_rows(message, spec, table, times, ledger)
        return
    accuracy_message = ACCURACY_MESSAGES.get(message, "")
    if accuracy_message in tables:
        table = _join_accuracy(table, tables.pop(accuracy_message))
        spec = replace(spec, columns=spec.columns + _ACCURACY_MAP.columns)
    _report_fields(message, spec, table, ledger)
    is_named = spec.id_field in table
    instance = table[spec.id_field] if is_named else instance_of(table)
    table = dict(table)
    del table[PLACE]
    values = extract(table, spec.columns, copy_rows, used_up=table)  # frees fields one by one
    del table  # frees the fields that become no column
    distinct_instances = np.unique(instance)
    if not is_named and not spec.event:  # a name or an exposure may rightly come once
        distinct_instances = _without_stray_instances(message, instance, ledger)
    for number in limit.admitted(distinct_instances.tolist(), instance):
        has_label = is_named or number >= 0  # -1 means a message without instances
        label = str(number) if has_label else None
        name = f"{message}[{label}]" if has_label else message
        source = Source(message, label)
        rows = DecodedRows(
            name=name,
            source=source,
            time_ns=times.time_ns,
            boot=times.boot,
            columns=values,
        )
        yield _chosen(rows, (instance == number) & times.good)


def _text_rows(
    message: str,
    spec: MessageMap,
    table: Table,
    times: _RowTimes,
    ledger: Ledger,
) -> Iterator[DecodedRows]:
    """The rows of a message of texts from the autopilot; none, with a report, without texts."""
    texts = texts_of(message, spec.text_field, table)
    if texts is None:
        ledger.add(messages.no_text_field(message=message, field=spec.text_field))
        return
    rows = DecodedRows(
        name=message,
        source=Source(message),
        time_ns=times.time_ns,
        boot=times.boot,
        columns={},
        labels={"text": texts},
    )
    yield _chosen(rows, times.good)


def _chosen(rows: DecodedRows, chosen: Mask) -> DecodedRows:
    """The rows that the mask selects; not copied if it selects all."""
    return rows if chosen.all() else rows.take(chosen)


def _without_stray_instances(
    message: str,
    instance: NDArray[Any],
    ledger: Ledger,
) -> NDArray[Any]:
    """The distinct numbers in ``instance`` (n,), without those that are damage (flipped bits).

    An instance is damage if it has at most `STRAY_ROWS` rows, and another instance has
    `STRAY_SHARE` times as many.
    """
    numbers, counts = np.unique(instance, return_counts=True)
    most = int(counts.max(initial=0))
    stray = (counts <= STRAY_ROWS) & (counts * STRAY_SHARE <= most)
    if stray.any():
        message_of_stray = messages.stray_instances(
            message=message,
            count=int(counts[stray].sum()),
            numbers=numbers[stray].tolist(),
            most=most,
            main=int(numbers[np.argmax(counts)]),
        )
        ledger.add(message_of_stray)
    return np.asarray(numbers[~stray])


def _report_fields(message: str, spec: MessageMap, table: Table, ledger: Ledger) -> None:
    """Report fields that are not numbers, and columns of the roles for which there is no field."""
    fields_without_numbers = set()
    columns_without_numbers = set()
    columns_with_numbers = set()
    for column in spec.columns:
        for field in column.fields:
            if field not in table:
                continue
            if is_number(table[field]):
                columns_with_numbers.add(column.name)
            else:
                fields_without_numbers.add(field)
                columns_without_numbers.add(column.name)
    count = _length(table)
    if fields_without_numbers:
        fields = sorted(fields_without_numbers)
        ledger.add(messages.fields_not_numbers(message=message, count=count, fields=fields))
    absent = _reported_columns(spec) - columns_with_numbers - columns_without_numbers
    if absent:
        columns = sorted(absent)
        ledger.add(messages.columns_without_field(message=message, count=count, columns=columns))


def _reported_columns(spec: MessageMap) -> set[str]:
    """The columns of the roles of a message that are reported here if they are absent.

    `channel_of` reports the absence of the others.
    """
    needed: set[str] = set()
    for role in spec.roles:
        needed |= set(ROLE_COLUMNS[role])
    needed.discard("event_index")  # `channel_of` numbers exposures itself
    if spec.attitude or spec.position:
        needed -= {*QUATERNION, "lat_rad", "lon_rad"}
    if spec.position:
        needed.add("h_msl_m")
    return needed


_FARTHER_THAN_ALL = 1 << 40  # [bytes] longer than any log: pairs with it rank behind all others
_TIME_BITS = 52  # 2^52 us are 142 years: the instance fits above the time
_INSTANCE_MASK = 0x3FF  # ten bits above the time: the sign of int64 stays free


def _join_accuracy(fixes: Table, accuracies: Table) -> Table:
    """The table of fixes with the fields of accuracy of equal instance and time; NaN without."""
    fields = [field for field in ACCURACY_FIELDS if field in accuracies]
    if not fields or "TimeUS" not in accuracies or not accuracies[PLACE].size:
        return fixes
    keyed_fixes = _Keyed(_key(fixes), fixes[PLACE])
    keyed_accuracies = _Keyed(_key(accuracies), accuracies[PLACE])
    # row i of both tables belongs together, as in all logs without damage
    if np.array_equal(keyed_fixes.key, keyed_accuracies.key):
        return fixes | {field: accuracies[field] for field in fields}
    fix_rows, accuracy_rows = _nearest_pairs(keyed_fixes, keyed_accuracies)
    joined = dict(fixes)
    for field in fields:
        joined[field] = np.full(keyed_fixes.key.shape, np.nan)
        joined[field][fix_rows] = accuracies[field][accuracy_rows]
    return joined


class _Keyed(NamedTuple):
    """The rows of a table: their keys, of instance and time, and their places in the log."""

    key: Integers
    places: Integers


class _Pairs(NamedTuple):
    """(n,) pairs of a fix and an accuracy with equal keys: their rows in the two tables.

    ``distances``: how far apart the two are in the log [bytes].
    """

    fix_rows: Integers
    accuracy_rows: Integers
    distances: Integers


def _nearest_pairs(fixes: _Keyed, accuracies: _Keyed) -> tuple[Integers, Integers]:
    """Pair fixes with accuracies of equal keys; returns the rows of both, (n,) each.

    Each row is in one pair at most. Pairs in which the accuracy follows the fix are preferred; then
    those that are nearer in the log. A fix has no accuracy if that is in a better pair.
    """
    keys = np.concatenate([fixes.key, accuracies.key])
    places = np.concatenate([fixes.places, accuracies.places])
    by_key_and_place = np.lexsort((places, keys))
    following = _neighbours(fixes, accuracies, by_key_and_place, shift=0)
    preceding = _neighbours(fixes, accuracies, by_key_and_place, shift=-1)
    fix_rows = np.concatenate([following.fix_rows, preceding.fix_rows])
    accuracy_rows = np.concatenate([following.accuracy_rows, preceding.accuracy_rows])
    ranks = np.concatenate([following.distances, preceding.distances + _FARTHER_THAN_ALL])
    pairs = np.argsort(ranks, kind="stable")  # indices into the rows above, best first
    pairs = _first_with_each_row(pairs, fix_rows)
    pairs = _first_with_each_row(pairs, accuracy_rows)
    return fix_rows[pairs], accuracy_rows[pairs]


def _first_with_each_row(pairs: Integers, rows: Integers) -> Integers:
    """Keep from ``pairs`` (indices into ``rows``, best first) the first with each row."""
    _, first = np.unique(rows[pairs], return_index=True)
    return pairs[np.sort(first)]


def _neighbours(
    fixes: _Keyed,
    accuracies: _Keyed,
    by_key_and_place: Integers,
    *,
    shift: int,
) -> _Pairs:
    """Pair each fix with the accuracy of its key that follows (``shift`` 0) or precedes it (-1).

    ``by_key_and_place``: the rows of both tables in this order; rows of the accuracies are numbered
    on from the last fix.
    """
    count_of_fixes = fixes.key.shape[0]
    is_accuracy = by_key_and_place >= count_of_fixes
    ordered_accuracy_rows = by_key_and_place[is_accuracy] - count_of_fixes
    positions_of_fixes = np.flatnonzero(~is_accuracy)
    # the number of accuracies before a fix is the index of the first accuracy behind it
    following = np.cumsum(is_accuracy)[positions_of_fixes]
    neighbour = following + shift
    has_neighbour = (neighbour >= 0) & (neighbour < ordered_accuracy_rows.shape[0])
    fix_rows = by_key_and_place[positions_of_fixes[has_neighbour]]
    accuracy_rows = ordered_accuracy_rows[neighbour[has_neighbour]]
    has_same_key = fixes.key[fix_rows] == accuracies.key[accuracy_rows]
    fix_rows = fix_rows[has_same_key]
    accuracy_rows = accuracy_rows[has_same_key]
    distances = np.abs(fixes.places[fix_rows] - accuracies.places[accuracy_rows])
    return _Pairs(fix_rows, accuracy_rows, distances)


def _key(table: Table) -> Integers:
    """(n,) the instance and the time of each row as one number; instance -1 (none) becomes 0."""
    instance = whole_numbers(instance_of(table), -1, _INSTANCE_MASK)
    number_from_0 = (instance + 1) & _INSTANCE_MASK
    time_us = microseconds(table["TimeUS"])
    return np.asarray(time_us + (number_from_0 << _TIME_BITS), np.int64)
