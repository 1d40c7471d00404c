"""Which formats of soundings there are, and which one a text is in."""

import math
from collections.abc import Callable

from pipeline.atmosphere.soundings import igra, plain, wyoming
from pipeline.atmosphere.soundings.level_checks import check_levels
from pipeline.atmosphere.soundings.levels import RawLevels, Sounding
from pipeline.errors import InputError
from pipeline.ledger import Ledger
from pipeline.units import NANOSECONDS_PER_SECOND

FAR_HOURS = 6.0
"""A sounding farther in time is reported: the boundary layer has changed."""


FORMATS: dict[str, tuple[Callable[[str], bool], Callable[[str, str, Ledger], list[RawLevels]]]] = {
    "igra_derived": (igra.is_derived, igra.parse_derived),
    "igra": (igra.is_igra, igra.parse_igra),
    "wyoming_csv": (wyoming.is_csv, wyoming.parse_csv),
    "wyoming_list": (wyoming.is_list, wyoming.parse_list),
    "csv": (plain.is_plain, plain.parse_plain),
}
"""How a text in a format is recognised and read. In this order a text is tried; the first that
recognises it reads it."""


def parse_sounding(
    text: str,
    ledger: Ledger,
    *,
    where: str = "sounding",
    format_name: str = "auto",
    time_ns: int | None = None,
    latitude_rad: float = math.nan,
    station_h_m: float = math.nan,
) -> Sounding:
    """The sounding of a text, in whichever format; of several the one nearest in time.

    Parameters
    ----------
    text : IGRA v2 (soundings or derived), University of Wyoming list or CSV, or a plain CSV with
        columns such as h_m, pressure_hpa, temperature_c, dew_point_c.
    where : the file's name, for refusals and the ledger.
    format_name : one of `FORMATS`, or ``auto``.
    time_ns : of the flight [Unix ns]; needed to choose where the text holds several soundings.
    latitude_rad, station_h_m : [rad], [m above sea level] where the text has none.

    Raises ``InputError``: no such format, wrong units, contradictory heights, fewer than five
    levels. Repairs are counted in the ledger.

    >>> text = "h_m,pressure_hpa,temperature_c\\n" + "".join(
    ...     f"{h},{1013.25 * (1 - 2.25577e-5 * h) ** 5.25588},{15 - 0.0065 * h}\\n"
    ...     for h in range(0, 5000, 500))
    >>> parse_sounding(text, Ledger()).temperature_k.round(2).tolist()[:3]
    [288.15, 284.9, 281.65]
    """
    name = format_name
    if name == "auto":
        name = next((name for name, (is_it, _) in FORMATS.items() if is_it(text)), "")
        if not name:
            begins = text.lstrip()[:60].splitlines()
            raise InputError.of("SOUNDING-FORMAT", where, begins=begins[0] if begins else "")
    if name not in FORMATS:
        what = f"no format of soundings is called {name!r}"
        raise InputError(
            "SOUNDING-FORMAT", what, where=where, remedy=f"one of auto, {', '.join(FORMATS)}"
        )
    ascents = FORMATS[name][1](text, where, ledger)
    raw = nearest_in_time(ascents, time_ns, where, ledger)
    return check_levels(raw, ledger, latitude_rad=latitude_rad, station_h_m=station_h_m)


def nearest_in_time(
    ascents: list[RawLevels], time_ns: int | None, where: str, ledger: Ledger
) -> RawLevels:
    """Of several ascents the one released nearest to a time; without a time, the only one."""
    full = [raw for raw in ascents if raw.pressure_pa.size]
    if not full:
        raise InputError(
            "SOUNDING-EMPTY", "the file holds no levels", where=where, remedy="fetch it again"
        )
    if len(full) < len(ascents):  # a file that was cut off may end with a header
        count = len(ascents) - len(full)
        ledger.loss("SOUNDING-CUT-OFF", where=where, count=count)
    if len(full) == 1 and (time_ns is None or full[0].time_ns is None):
        return full[0]
    if time_ns is None:
        raise InputError.of("SOUNDING-CHOICE", where, total=len(full))
    dated = [(abs(raw.time_ns - time_ns), raw) for raw in full if raw.time_ns is not None]
    if not dated:
        raise InputError.of("SOUNDING-CHOICE/undated", where, total=len(full))
    apart, raw = min(dated, key=lambda pair: pair[0])
    hours = apart / NANOSECONDS_PER_SECOND / 3600.0
    if hours > FAR_HOURS:
        ledger.warning("SOUNDING-FAR-IN-TIME", where=raw.where, hours=hours)
    if len(full) > 1:
        ledger.note("SOUNDING-CHOSEN", where=raw.where, count=len(full), hours=hours)
    return raw
