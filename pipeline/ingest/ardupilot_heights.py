"""Heights of an ArduPilot log that are above the ellipsoid, because a parameter says so."""

from __future__ import annotations

from dataclasses import replace

from pipeline.flight.channels import Channel
from pipeline.ledger import Ledger

# AP_GPS.h, DriverOptions::HeightEllipsoid: the receiver's height goes through the filter as it is.
HEIGHT_OPTION = "GPS_DRV_OPTIONS"
_HEIGHT_ELLIPSOID = 1 << 4


def says_ellipsoid(value: float) -> bool:
    """Whether this value of `HEIGHT_OPTION` asks for heights above the ellipsoid.

    >>> says_ellipsoid(16.0), says_ellipsoid(0.0), says_ellipsoid(float("nan"))
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
    """Channels whose heights above sea level are really above the ellipsoid; a note says so."""
    ledger.note(
        "HEIGHT-ELLIPSOID",
        f"the parameter {HEIGHT_OPTION} says that GNSS heights are above the ellipsoid: so are "
        "all heights of this log, but those made of one and the undulation",
        where=where,
    )
    return [
        with_undulation(channel, ellipsoidal=True)
        if "undulation_m" in channel.columns
        else _renamed(channel)
        for channel in channels
    ]


def _renamed(channel: Channel) -> Channel:
    if "h_msl_m" not in channel.columns:
        return channel
    columns = dict(channel.columns)
    return replace(channel, columns={"h_ellipsoid_m": columns.pop("h_msl_m")} | columns)
