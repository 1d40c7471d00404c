"""What is told of 479 public ascents: they are right, so nothing may be told of more than a few."""

import lzma
import math
from collections import Counter
from itertools import groupby

import numpy as np
import pytest

from tests.atmosphere.adjusting import codes
from tests.atmosphere.flights import SHARED_SOUNDINGS
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.profile import profile_from_table
from unbend.atmosphere.soundings import parse_sounding
from unbend.geodesy import normal_gravity
from unbend.messages import Ledger
from unbend.refraction.effect import effects_on_r
from unbend.stages.plausibility.air_limits import limits_of_factor

pytestmark = pytest.mark.shared("soundings/many")


@pytest.fixture(scope="module")
def ledger():
    return Ledger()


@pytest.fixture(scope="module")
def ascents(ledger):
    soundings = []
    for path in sorted((SHARED_SOUNDINGS / "many").glob("*.csv.xz")):
        head, *rows = lzma.decompress(path.read_bytes()).decode().splitlines()
        for _, of_ascent in groupby(rows, key=lambda row: row.split(",", 1)[0]):
            soundings.append(parse_sounding("\n".join([head, *of_ascent]), ledger))
    return soundings


def test_few_of_them_have_anything_to_tell(ascents, ledger):
    assert len(ascents) == 479
    told = Counter(codes(ledger))
    assert told["SOUNDING-SUPERADIABATIC"] <= 4
    assert told["SOUNDING-INDEX-RISES"] <= 4


def test_the_refraction_of_none_is_implausible(ascents):
    """At most 0.1 % may be told, which is none of 479."""
    standard = standard_atmosphere("us1976")
    checked = 0
    for sounding in ascents:
        air = profile_from_table(
            sounding.h_m,
            sounding.temperature_k,
            sounding.pressure_pa,
            np.nan_to_num(sounding.vapour_pressure_pa),
            gravity=normal_gravity(sounding.latitude_rad),
        )
        ground_m = float(sounding.h_m[0])
        for climb_m in (500.0, 700.0, 1000.0, 1400.0, 2000.0, 4000.0, 8000.0):
            limits = limits_of_factor(climb_m)
            for effect in effects_on_r(air, standard, None, ground_m + climb_m, ground_m)[:1]:
                assert not limits.exclude(effect.factor, math.nan), sounding.name
                checked += 1
    assert checked > 3000
