"""Which DataFlash messages are wanted, their instances, and what their numbers of texts mean."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.fields import MessageMap, columns_of_group, message_maps
from pipeline.ingest.log import Table

INSTANCE_FIELDS = ("I", "Instance", "Id", "C")


def instance_of(table: Table) -> NDArray[Any]:
    """The instance of each row, -1 where the message has none.

    Only integers tell instances apart: in PID messages I is a term of the controller.
    """
    for field in INSTANCE_FIELDS:
        if field in table and table[field].dtype.kind in "iu":
            return table[field]
    rows = len(next(iter(table.values()))) if table else 0
    return np.full(rows, -1, np.int8)


MESSAGES: Mapping[str, MessageMap] = message_maps("dataflash")

# What EV and ERR mean, as far as they concern the filter and the receivers (AP_Logger.h); in ERR
# the second number is 0 where the trouble is over.
EVENTS = {60: "EKF_ALT_RESET", 62: "EKF_YAW_RESET", 67: "GPS_PRIMARY_CHANGED"}
ERRORS = {
    3: "COMPASS", 7: "FAILSAFE_GPS", 11: "GPS", 12: "CRASH_CHECK", 16: "EKFCHECK",
    17: "FAILSAFE_EKFINAV", 18: "BARO", 24: "EKF_PRIMARY", 29: "FAILSAFE_VIBE",
    31: "FAILSAFE_DEADRECKON",
}  # fmt: skip


def texts_of(message: str, field: str, table: Table) -> tuple[str, ...] | None:
    """What the autopilot says in each row of MSG, EV or ERR; None where no text is defined.

    >>> texts_of("ERR", "Subsys", {"Subsys": np.array([16], "u1"), "ECode": np.array([2], "u1")})
    ('ERR EKFCHECK 2',)
    """
    words = table.get(field)
    if words is None or words.dtype.kind != ("U" if message == "MSG" else "u"):
        return None
    if message == "MSG":
        return tuple(words.tolist())
    names = EVENTS if message == "EV" else ERRORS
    codes = table["ECode"].tolist() if "ECode" in table else [""] * words.shape[0]
    pairs = zip(words.tolist(), codes, strict=True)
    return tuple(f"{message} {names.get(number, number)} {code}".strip() for number, code in pairs)


# Accuracy and the ellipsoidal height come in a message of their own, at the time of the GPS row.
ACCURACY_MESSAGES = {"GPS": "GPA", "GPS2": "GPA2"}
ACCURACY = columns_of_group("accuracy")
