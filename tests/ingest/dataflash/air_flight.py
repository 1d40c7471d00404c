"""A DataFlash log of forty seconds: air data, a receiver and a position. What was lost of a log."""

import numpy as np

from tests.ingest.written_logs import DataFlashWriter

ROWS = 400
BARO = 23
WORDS = np.arange(
    1,
    33,
    dtype="<i2",
)
NOT_NUMBERS = {
    "a": WORDS.tobytes(),
    "N": b"wet",
}
FORMS = {
    "GPS": ("QBBIHLLe", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt"),
    "BARO": ("QBfc", "TimeUS,I,Press,Temp"),
    "HYGR": ("QBff", "TimeUS,Id,Humidity,Temp"),
    "POS": ("QLLe", "TimeUS,Lat,Lng,Alt"),
}


def flight(message="", field="", letter=""):
    """The log, in which a field of a message may have another letter: an array or a text."""
    writer = DataFlashWriter()
    changed = FORMS[message][1].split(",").index(field) if message else -1
    for kind, (name, (letters, columns)) in enumerate(FORMS.items(), BARO - 1):
        if name == message:
            letters = letters[:changed] + letter + letters[changed + 1 :]
        writer.define(
            kind,
            name,
            letters,
            columns,
        )
    for k in range(ROWS):
        time_us = 1_000_000 + k * 100_000
        height_m = 600.0 + 0.5 * k
        rows = {
            "GPS": [time_us, 0, 3, 1000 + 100 * k, 2300, 47.0, 8.0, height_m],
            "BARO": [time_us, 0, 95_000.0 - k, 20.0],
            "HYGR": [time_us, 0, 55.0, 9.0],
            "POS": [time_us, 47.0, 8.0, height_m],
        }
        if message:
            rows[message][changed] = NOT_NUMBERS[letter]
        for name, values in rows.items():
            writer.row(name, *values)
    return writer


def losses(log):
    """Code, place and count of each loss."""
    return [(entry.code, entry.where, entry.count) for entry in log.ledger if entry.kind == "loss"]
