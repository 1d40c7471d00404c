"""Error of R by source of air, in the air of nine real soundings."""

import numpy as np
from matplotlib.figure import Figure

from docs.gallery.plates import bars
from tests.atmosphere import flights
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.air_samples import AirSamples
from unbend.atmosphere.climatology import climatology, month_of
from unbend.atmosphere.estimate.adjusted_profile import build_adjusted_profile
from unbend.atmosphere.soundings import Sounding
from unbend.messages import Ledger

SIZE = (8.2, 3.8)
CLIMBS = (1000, 3000, 6000)
FLOWN = {
    "barometer and GNSS": {"thermometer": False},
    "thermometer, climb": {},
    "thermometer, climb and descent": {"descent": True},
}
SOURCES = ["US 1976", "climatology", "sounding 12 h apart", *FLOWN]
PAIRS = {5: 4, 4: 5, 7: 6, 6: 7}  # ascents 12 hours apart
US1976 = standard_atmosphere("us1976")
AIRS = [flights.Truth(balloon) for balloon in flights.balloons()]


def error(number: int, climb: int, source: str) -> float:
    """Error of R [%] in the air of a sounding, by its number from 0."""
    truth = AIRS[number]
    rng = np.random.default_rng(number)
    month = month_of(truth.start_ns)
    ground = float(truth.h[0])
    usual = climatology(latitude_rad=truth.latitude, month=month, ground_h_m=ground)
    samples = AirSamples()
    soundings = []
    if source == "sounding 12 h apart":
        other = AIRS[PAIRS[number]]
        levels = (column[::50] for column in (other.h, other.p, other.t, other.e))
        before = truth.start_ns - 12 * 3600 * 10**9
        soundings = [Sounding(*levels, before, "", truth.latitude, 0.0)]
    elif source in FLOWN:
        samples = flights.fly(truth, climb, flights.drawn(rng), rng, **FLOWN[source])
    profile = US1976
    if source != "US 1976":
        more = {"time_ns": truth.start_ns, "longitude_rad": 0.0, "soundings": soundings}
        made = build_adjusted_profile(
            samples, US1976, truth.latitude, Ledger(), background=usual, **more
        )
        profile = made.profile
    return 100.0 * truth.error(profile, climb)


def rows(numbers: tuple[int, ...] = tuple(range(9))) -> list[list[str]]:
    found = [["error of R [%] in the air of", *SOURCES]]
    for number in numbers:
        able = [number in PAIRS or "sounding" not in source for source in SOURCES]
        for climb in CLIMBS:
            values = (
                f"{error(number, climb, s):+.2f}" if ok else ""
                for s, ok in zip(SOURCES, able, strict=True)
            )
            found.append([f"{AIRS[number].name[2:]}, {climb // 1000} km", *values])
    return found


def draw(figure: Figure, table: list[list[str]]) -> None:
    for i, axis in enumerate(figure.subplots(1, 3, sharey=True)):
        bars(
            axis,
            {
                name: [row[column] for row in table[1 + i :: 3] if row[column]]
                for column, name in enumerate(SOURCES, start=1)
            },
        )
        axis.set_title(f"climb to {CLIMBS[i] // 1000} km")
        axis.set_xlabel("error of R [%]")
