"""Heights of an ArduPilot log that are above the ellipsoid, because a parameter says so."""

from collections.abc import Iterable, Mapping
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


def with_both_heights(
    channels: Iterable[Channel], parameters: Mapping[str, float], ledger: Ledger, where: str
) -> list[Channel]:
    """The channels with both heights, where the receiver gave the undulation with one of them.

    Where the autopilot's setting selects it, what stands as height above sea level is above the
    ellipsoid; ``where`` the settings stand.
    """
    ellipsoidal = selects_ellipsoid(parameters.get(HEIGHT_OPTION, 0.0))
    if ellipsoidal:
        ledger.note("HEIGHT-ELLIPSOID", where=where, height_option=HEIGHT_OPTION)
    result = []
    for channel in channels:
        columns = dict(channel.columns)
        undulation, logged = columns.pop("undulation_m", None), columns.get("h_msl_m")
        if logged is not None and undulation is not None:
            if ellipsoidal:
                columns |= {"h_ellipsoid_m": logged, "h_msl_m": logged - undulation}
            columns.setdefault("h_ellipsoid_m", logged + undulation)
        elif logged is not None and ellipsoidal:
            columns = {"h_ellipsoid_m": columns.pop("h_msl_m")} | columns
        result.append(replace(channel, columns=columns))
    return result
