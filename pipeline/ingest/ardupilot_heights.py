"""Heights of an ArduPilot log that are above the ellipsoid, because a parameter says so."""

from __future__ import annotations

from dataclasses import replace

from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger

# AP_GPS.h, DriverOptions::HeightEllipsoid: the receiver's height goes through the filter as it is.
HEIGHT_OPTION = "GPS_DRV_OPTIONS"
_HEIGHT_ELLIPSOID = 1 << 4


def selects_ellipsoid(value: float) -> bool:
    """Whether this value of `HEIGHT_OPTION` selects heights above the ellipsoid.

    >>> selects_ellipsoid(16.0), selects_ellipsoid(0.0), selects_ellipsoid(float("nan"))
    (True, False, False)
    """
    # Parameters are floats; a damaged one may hold anything.
    return 0.0 <= value < 2**15 and bool(int(value) & _HEIGHT_ELLIPSOID)


def with_undulation(channel: Channel, *, ellipsoidal: bool = False) -> Channel:
    """The channel with both heights, where the receiver gave the undulation with one of them.

    ``ellipsoidal`` says that what stands as height above sea level is above the ellipsoid.
    """
    columns = dict(channel.columns)
    undulation = columns.pop("undulation_m", None)
    if undulation is None:
        return channel
    logged = columns.get("h_msl_m")
    if logged is not None and ellipsoidal:
        columns |= {"h_ellipsoid_m": logged, "h_msl_m": logged - undulation}
    elif logged is not None and "h_ellipsoid_m" not in columns:
        columns["h_ellipsoid_m"] = logged + undulation
    return replace(channel, columns=columns)


def with_ellipsoidal_heights(channels: list[Channel], ledger: Ledger, where: str) -> list[Channel]:
    """The channels of a log whose "heights above sea level" are above the ellipsoid."""
    ledger.note(
        "HEIGHT-ELLIPSOID",
        f"the parameter {HEIGHT_OPTION} selects GNSS heights above the ellipsoid: all heights of "
        "this log are, except those that are computed with the undulation",
        where=where,
    )
    result = []
    for channel in channels:
        columns = dict(channel.columns)
        if "undulation_m" in columns:
            channel = with_undulation(channel, ellipsoidal=True)
        elif "h_msl_m" in columns:
            columns = {"h_ellipsoid_m": columns.pop("h_msl_m")} | columns
            channel = replace(channel, columns=columns)
        result.append(channel)
    return result
