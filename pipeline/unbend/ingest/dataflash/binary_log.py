"""ArduPilot DataFlash logs (.bin): the entry of this format for the registry, and its reader."""

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path

from unbend.ingest.buffers import open_view
from unbend.ingest.dataflash import messages
from unbend.ingest.dataflash.dataflash_channels import stamps, wanted_fields
from unbend.ingest.dataflash.dataflash_contents import contents_of
from unbend.ingest.dataflash.dataflash_records import RecordWalker, find_records
from unbend.ingest.dataflash.record_definitions import START
from unbend.ingest.dataflash.record_tables import decode
from unbend.ingest.flight_log import Contents, LogFormat
from unbend.ingest.message_tables import Table
from unbend.ingest.timelines import timeline
from unbend.ingest.utc_evidence import Witness
from unbend.messages import Ledger


def read_log(path: Path, ledger: Ledger, witnesses: Sequence[Witness] = ()) -> Contents:
    """The contents of a binary log; ``witnesses`` are other clocks that know its date."""
    wanted = wanted_fields()
    with open_view(path) as data:
        walker = RecordWalker(data, wanted)
        line = timeline(stamps(data, walker))  # reads the file: now the walker knows all records
        tables = decode(walker, wanted)
    walker.report_bytes(ledger, path.name, "record")
    for definition in walker.refused:
        if walker.bad_bytes:  # these may be records of this definition
            ledger.add(messages.bad_definition(file=path.name, definition=definition))
        else:
            ledger.add(messages.unused_bad_definition(file=path.name, definition=definition))
    return contents_of(
        walker,
        walker.message_counts(),
        line,
        tables,
        ledger,
        reread=partial(read_tables, path),
        witnesses=witnesses,
    )


def _is_binary(head: bytes) -> bool:
    """Whether a file begins with the definition of a record."""
    return head.startswith(START)


DATAFLASH = LogFormat("dataflash", "ArduPilot DataFlash", (".bin",), _is_binary, read_log)


def read_tables(path: Path, names: Collection[str] | None = None) -> dict[str, Table]:
    """All messages of some types (``names`` None: of every type), with all fields and `PLACE`.

    A table by the name of its type. A type without messages in the file has no table.
    """
    with open_view(path) as data:
        walker = find_records(data, names)
        chosen = walker.message_counts() if names is None else names
        return decode(walker, dict.fromkeys(chosen, _every_field))


def _every_field(name: str) -> bool:
    """The test for a wanted field that accepts each field."""
    return True
