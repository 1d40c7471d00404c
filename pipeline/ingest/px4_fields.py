"""Which messages of PX4 are wanted: it logs the same ones to .ulg and, over ROS 2, to MCAP.

``timestamp`` counts microseconds since boot.
"""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.ingest.channel_builder import DecodedRows
from pipeline.ingest.fields import MessageMap, message_maps
from pipeline.ledger import Ledger
from pipeline.units import Array

UTC_FIELD = "time_utc_usec"
"""Unix time [us] in the messages of receivers, beside their time since boot."""

CAPTURE_UTC_FIELD = "timestamp_utc"
"""Unix time [us] of an exposure by the autopilot's own clock, which it sets now and then."""

_FAILED = 0.0  # of ``result``: 1 is success, -1 a camera that does not answer (CameraCapture.msg)


MESSAGES: Mapping[str, MessageMap] = message_maps("px4")
"""By the name of the message in px4_msgs."""


def topic_of(message: str) -> str:
    """The topic under which PX4 logs a message.

    >>> topic_of("VehicleGpsPosition")
    'vehicle_gps_position'
    """
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", message).lower()


TOPICS: Mapping[str, MessageMap] = {topic_of(name): spec for name, spec in MESSAGES.items()}


def captured_rows(rows: DecodedRows, ledger: Ledger) -> DecodedRows:
    """The rows of a camera without those that report that it took no image.

    An index that is 0 in all of several rows is dropped: mavros never fills it in.
    """
    columns: dict[str, Array] = dict(rows.columns)
    failed = columns.pop("result", np.ones(len(rows))) == _FAILED
    index = columns.get("event_index", np.empty(0))
    if index.shape[0] > 1 and not index.any():
        del columns["event_index"]
        what = f"all {len(rows)} rows have the index 0: they are numbered from 0 in order"
        ledger.note("EVENT-NO-INDEX", what, where=rows.name, count=len(rows))
    rows = replace(rows, columns=columns)
    if not failed.any():
        return rows
    what = f"{int(failed.sum())} of {len(rows)} rows report that the camera took no image"
    ledger.warning("EVENT-FAILED", what, where=rows.name, count=int(failed.sum()))
    return rows.take(~failed)
