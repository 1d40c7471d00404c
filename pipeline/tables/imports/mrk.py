"""DJI's ``Timestamp.MRK``: one line an image, with time, position and offset of the antenna.

A line is: number of the image, GPS seconds of the week, [week], offset from the antenna to the
camera north, east and downwards [mm], latitude, longitude [deg], ellipsoidal height [m], sigmas
north, east and up [m], quality (50 fixed, 34 float, 16 single, 0 none). DJI's manuals call the
position that "after compensation": it is the camera's.
"""

import re
from pathlib import Path

import numpy as np

from pipeline.errors import InputError
from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger
from pipeline.tables.imports.stated import Stated, channel_of_rows, read_text
from pipeline.tables.text_columns import numbers, split_lines, utc_of_weeks

_MILLIMETRE = 1e-3
_LINE = r"\[.*\].*,N.*,E.*,V.*,Lat.*,Lon.*,Ellh.*,.*,.*,Q"
_NAMES = (
    "index", "seconds", "week", "N", "E", "V", "Lat", "Lon", "Ellh", "sd_n", "sd_e", "sd_u", "Q",
)  # fmt: skip


def read_mrk(path: Path, stated: Stated, ledger: Ledger) -> Channel:
    """Events with the position of the camera, and the way from the antenna to it.

    ``event_index`` is the image's number, ``offset_north_m``, ``offset_east_m``, ``offset_down_m``
    lead from the antenna to the camera. Positions of quality 0 are unknown.
    """
    lines = read_text(path)
    of_mrk = np.array([re.search(_LINE, line) is not None for line in lines])
    if not of_mrk.any():
        raise InputError.of("IMPORT-FORMAT/mrk", path)
    table = split_lines(lines, _NAMES, r"\s*(?:\[|\]|,[A-Za-z]*|\s)\s*")
    value = {name: numbers(table[name]) for name in _NAMES}
    readable = of_mrk & np.isfinite(list(value.values())).all(axis=0)
    time_ns = utc_of_weeks(value["week"], value["seconds"], stated.system_of(path, ledger, "gpst"))
    lost = (value["Q"] == 0) | ((value["Lat"] == 0.0) & (value["Lon"] == 0.0))
    if bool(lost.any()):
        what = (
            f"{int(lost.sum())} of {lost.size} images have no position (quality 0), the first is "
            f"number {value['index'][np.argmax(lost)]:.0f}"
        )
        ledger.loss("IMPORT-NO-POSITION", what, where=path.name, count=int(lost.sum()))
    if single := int(np.sum(value["Q"] == 16)):
        ledger.warning("TRAJECTORY-SINGLE", where=path.name, count=single, total=lost.size)
    columns = {
        "event_index": value["index"],
        "offset_north_m": value["N"] * _MILLIMETRE,
        "offset_east_m": value["E"] * _MILLIMETRE,
        "offset_down_m": value["V"] * _MILLIMETRE,
        "lat_rad": np.where(lost, np.nan, np.radians(value["Lat"])),
        "lon_rad": np.where(lost, np.nan, np.radians(value["Lon"])),
        stated.height_column(path, ledger, "ellipsoid"): np.where(lost, np.nan, value["Ellh"]),
        "sigma_h_m": np.hypot(value["sd_n"], value["sd_e"]) / np.sqrt(2.0),
        "sigma_v_m": value["sd_u"],
        "solution_quality": value["Q"],
    }
    return channel_of_rows(path, "MRK", time_ns, columns, ledger, readable=readable)
