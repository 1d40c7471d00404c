"""Which rows of a camera's messages are exposures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.flight.clock import UNIX_US_FROM
from pipeline.ledger import Ledger


def distinct(table: NDArray[Any], name: str, ledger: Ledger) -> NDArray[np.intp]:
    """The rows of CAMERA_FEEDBACK that are exposures of a camera: no empty ones, each once.

    ArduPilot sends a row again while the next pulse is awaited, at times already with the next
    index: the time is what tells exposures apart, and the first row of a time has its index.
    """
    empty = (table["time_usec"] == 0) & (table["lat"] == 0) & (table["lng"] == 0)
    rows = np.flatnonzero(~empty)
    times, indices = table["time_usec"][rows], table["img_idx"][rows].astype(np.uint64)
    keys = np.where(times == 0, indices, times)
    first = np.sort(np.unique(keys, return_index=True)[1])
    empties, repeats = int(empty.sum()), int(rows.shape[0] - first.shape[0])
    if empties:
        ledger.note(
            "EVENT-EMPTY",
            f"{empties} of {table.shape[0]} rows have neither time nor place: no exposure",
            where=name,
            count=empties,
        )
    if repeats:
        ledger.note(
            "EVENT-REPEAT",
            f"{repeats} of {table.shape[0]} rows repeat the time of an exposure",
            where=name,
            count=repeats,
        )
    by_unix = int(np.count_nonzero(times[first] > UNIX_US_FROM))
    if by_unix:
        ledger.note(
            "EVENTS-TRIGGER-TIME",
            f"{by_unix} exposures have Unix time, as autopilots send it without a feedback pin: "
            "it is that of the trigger command, and the shutter opens later (70 to 160 ms were "
            "measured), which events.log.<camera>.delay_s takes into account",
            where=name,
            count=by_unix,
        )
    unseen = np.setdiff1d(indices, indices[first])
    if unseen.shape[0]:
        ledger.warning(
            "EVENT-NO-PULSE",
            f"{unseen.shape[0]} image indices never got a time of their own (the first is "
            f"{int(unseen[0])}): the camera was triggered and its feedback was lost",
            where=name,
            count=int(unseen.shape[0]),
        )
    return rows[first]


def taken(table: NDArray[Any], name: str, ledger: Ledger) -> NDArray[np.intp]:
    """The rows of CAMERA_IMAGE_CAPTURED that are images, each once.

    ``capture_result`` 0 says that the camera failed; a camera repeats a row that it was asked for
    again, with the same index and time.
    """
    failed = table["capture_result"] == 0
    rows = np.flatnonzero(~failed)
    keys = table["time_boot_ms"][rows].astype(np.int64) << 32
    keys |= table["image_index"][rows].astype(np.int64) & 0xFFFFFFFF
    first = np.sort(np.unique(keys, return_index=True)[1])
    failures, repeats = int(failed.sum()), int(rows.shape[0] - first.shape[0])
    if failures:
        ledger.warning(
            "EVENT-FAILED",
            f"{failures} of {table.shape[0]} rows say that the camera took no image",
            where=name,
            count=failures,
        )
    if repeats:
        ledger.note(
            "EVENT-REPEAT",
            f"{repeats} of {table.shape[0]} rows repeat an image",
            where=name,
            count=repeats,
        )
    return np.asarray(rows[first], np.intp)
