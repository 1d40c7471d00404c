"""Error of R by source of air, in the air of nine real soundings."""

import numpy as np
from matplotlib.figure import Figure

from docs.gallery.plates import bars
from tests.atmosphere import flights
from unbend.atmosphere import Profile, standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.soundings import Sounding
from unbend.messages import Ledger

SIZE = (8.2, 3.8)
CLIMBS_M = (1000, 3000, 6000)
FLOWN = {
    "barometer and GNSS": {"thermometer": False},
    "thermometer, climb": {},
    "thermometer, climb and descent": {"descent": True},
}
SOURCES = ["US 1976", "climatology", "sounding 12 h apart", *FLOWN]
PAIRS = {5: 4, 4: 5, 7: 6, 6: 7}  # ascents 12 hours apart
HALF_A_DAY_NS = 12 * 3600 * 10**9
US1976 = standard_atmosphere("us1976")
AIRS = [flights.Truth(balloon) for balloon in flights.balloons()]


def sounding_before(number: int) -> Sounding:
    """The other sounding of the place, as of 12 hours before."""
    truth = AIRS[number]
    air = AIRS[PAIRS[number]]
    levels = (column[::50] for column in (air.h, air.p, air.t, air.e))
    time_ns = truth.start_ns - HALF_A_DAY_NS
    return Sounding(*levels, time_ns, "", truth.latitude, 0.0)


def air_of(number: int, climb_m: int, source: str) -> Profile:
    """What a source tells of the air of a sounding, by its number from 0."""
    if source == "US 1976":
        return US1976
    truth = AIRS[number]
    samples = AirSamples()
    soundings = []
    if source == "sounding 12 h apart":
        soundings.append(sounding_before(number))
    elif source in FLOWN:
        rng = np.random.default_rng(number)
        samples = flights.fly(truth, climb_m, flights.drawn(rng), rng, **FLOWN[source])
    month = month_of(truth.start_ns)
    ground_m = float(truth.h[0])
    background = climatology(latitude_rad=truth.latitude, month=month, ground_h_m=ground_m)
    adjusted = build_adjusted_profile(
        samples,
        US1976,
        truth.latitude,
        Ledger(),
        background=background,
        time_ns=truth.start_ns,
        longitude_rad=0.0,
        soundings=soundings,
    )
    return adjusted.profile


def rows(numbers: tuple[int, ...] = tuple(range(9))) -> list[list[str]]:
    table = [["error of R [%] in the air of", *SOURCES]]
    for number in numbers:
        for climb_m in CLIMBS_M:
            row = [f"{AIRS[number].name[2:]}, {climb_m // 1000} km"]
            for source in SOURCES:
                cell = ""
                if source != "sounding 12 h apart" or number in PAIRS:
                    profile = air_of(number, climb_m, source)
                    cell = f"{100.0 * AIRS[number].error(profile, climb_m):+.2f}"
                row.append(cell)
            table.append(row)
    return table


def draw(figure: Figure, table: list[list[str]]) -> None:
    panels = figure.subplots(1, 3, sharey=True)
    for i, climb_m in enumerate(CLIMBS_M):
        values = {}
        for column, source in enumerate(SOURCES, start=1):
            cells = [row[column] for row in table[1 + i :: 3]]
            values[source] = [cell for cell in cells if cell]
        bars(panels[i], values)
        panels[i].set_title(f"climb to {climb_m // 1000} km")
        panels[i].set_xlabel("error of R [%]")
