"""DJI's ``Timestamp.MRK``: one line an image, with time, position and offset of the antenna.

A line is: number of the image, GPS seconds of the week, [week], offset from the antenna to the
camera north, east and downwards [mm], latitude, longitude [deg], ellipsoidal height [m], sigmas
north, east and up [m], quality (50 fixed, 34 float, 16 single, 0 none). DJI's manuals call the
position that "after compensation": it is the camera's.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import (
    Stated,
    channel_of_rows,
    height_column,
    not_of_format,
    read_text,
    time_system,
    utc_of_week_seconds,
)

_NUMBER = r"\s*([-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*"
_LINE = re.compile(
    rf"^\s*([0-9]+)\s+{_NUMBER}\s+\[{_NUMBER}\]{_NUMBER},N{_NUMBER},E{_NUMBER},V{_NUMBER},Lat"
    rf"{_NUMBER},Lon{_NUMBER},Ellh{_NUMBER},{_NUMBER},{_NUMBER}\s+([0-9]+),Q"
)
_MILLIMETRE = 1e-3


def read_mrk(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Events with the position of the camera, and the way from the antenna to it.

    ``event_index`` is the image's number, ``offset_north_m``, ``offset_east_m``, ``offset_down_m``
    lead from the antenna to the camera. Positions of quality 0 are unknown.
    """
    lines = [line for line in read_text(path) if line.strip()]
    found = [_LINE.match(line) for line in lines]
    if not any(found):
        raise not_of_format(path, "no line is like '1  400373.488877  [2264]  -40,N  0,E  86,V  "
                            "44.4,Lat  1.2,Lon  359.5,Ellh  0.03, 0.03, 0.05  16,Q'")  # fmt: skip
    nothing = (np.nan,) * 13
    value = np.array([[float(v) for v in m.groups()] if m else nothing for m in found]).T
    system = time_system(path, stated, "gpst")
    time_ns = utc_of_week_seconds(path, value[1], stated, system, value[2])
    lost = (value[12] == 0) | ((value[6] == 0.0) & (value[7] == 0.0))
    if bool(lost.any()):
        ledger.loss(
            "IMPORT-NO-POSITION",
            f"{int(lost.sum())} of {lost.size} images have no position (quality 0), the first is "
            f"number {int(value[0][np.argmax(lost)])}",
            where=path.name,
            count=int(lost.sum()),
        )
    columns = {
        "event_index": value[0],
        "offset_north_m": value[3] * _MILLIMETRE,
        "offset_east_m": value[4] * _MILLIMETRE,
        "offset_down_m": value[5] * _MILLIMETRE,
        "lat_rad": np.where(lost, np.nan, np.radians(value[6])),
        "lon_rad": np.where(lost, np.nan, np.radians(value[7])),
        height_column(path, stated, "ellipsoid"): np.where(lost, np.nan, value[8]),
        "sigma_h_m": np.hypot(value[9], value[10]) / np.sqrt(2.0),
        "sigma_v_m": value[11],
        "solution_quality": value[12],
    }
    single = int(np.count_nonzero(value[12] == 16))
    if single:
        ledger.warning(
            "TRAJECTORY-SINGLE",
            f"{single} of {lost.size} images have a single-point position (quality 16): metres, "
            "not centimetres",
            where=path.name,
            count=single,
        )
    return channel_of_rows(path, "MRK", time_ns, columns, ledger,
                           readable=np.array([m is not None for m in found]))  # fmt: skip
