"""What pymavlink reads of a DataFlash log, message by message; its index of places is not used."""

import contextlib
from collections import defaultdict

from pymavlink.DFReader import DFReader_binary


def library_messages(reader):
    """All messages of a DFReader, which is closed behind the last one."""
    with contextlib.closing(reader):
        while (message := reader.recv_msg()) is not None:
            yield message


def as_text(binary):
    """What a ground station writes: one message a line, scaled fields in their unit."""
    lines = []
    for message in library_messages(DFReader_binary(str(binary))):
        cells = [str(getattr(message, field)) for field in message.get_fieldnames()]
        lines.append(", ".join([message.get_type(), *cells]))
    return "\n".join(lines) + "\n"


def library_tables(reader):
    """All cells, by the name of the message and by the field."""
    tables = defaultdict(lambda: defaultdict(list))
    for message in library_messages(reader):
        columns = tables[message.get_type()]
        for field in message.get_fieldnames():
            columns[field].append(getattr(message, field))
    return tables
