"""What pymavlink reads of a DataFlash log, message by message; its index of places is not used."""

import contextlib
from collections import defaultdict


def library_messages(reader):
    """All messages of a DFReader, which is closed behind the last one."""
    with contextlib.closing(reader):
        while (message := reader.recv_msg()) is not None:
            yield message


def library_tables(reader):
    """All cells, by the name of the message and by the field."""
    tables = defaultdict(lambda: defaultdict(list))
    for message in library_messages(reader):
        columns = tables[message.get_type()]
        for field in message.get_fieldnames():
            columns[field].append(getattr(message, field))
    return tables
