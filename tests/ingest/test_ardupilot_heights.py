"""Heights above the ellipsoid and above sea level, of logs that also have the undulation."""

import numpy as np

from tests.helpers import channel
from unbend.flight.channels import Channel
from unbend.ingest.channel_builder import HEIGHT_OPTION, with_both_heights
from unbend.messages import Ledger

# The undulation at Zurich is 47.5 m: the ellipsoid lies below sea level.
SEA_LEVEL = 552.5
UNDULATION = 47.5
ELLIPSOID = 600.0
BOTH = {"h_msl_m": SEA_LEVEL, "h_ellipsoid_m": ELLIPSOID}


def gps(**columns: float) -> Channel:
    return channel("GPS", np.zeros(1), **columns)


def heights(changed: Channel) -> dict[str, float]:
    return {name: values[0] for name, values in changed.columns.items()}


def test_sea_level_and_undulation_give_the_height_above_the_ellipsoid():
    logged = gps(h_msl_m=SEA_LEVEL, undulation_m=UNDULATION)
    (changed,) = with_both_heights(
        [logged],
        {},
        Ledger(),
        "PARM",
    )
    assert heights(changed) == BOTH


def test_a_logged_height_above_the_ellipsoid_is_kept():
    logged = gps(h_msl_m=SEA_LEVEL, h_ellipsoid_m=599.0, undulation_m=UNDULATION)
    (changed,) = with_both_heights(
        [logged],
        {},
        Ledger(),
        "PARM",
    )
    assert heights(changed)["h_ellipsoid_m"] == 599.0


def test_the_parameter_turns_heights_above_sea_level_into_those_above_the_ellipsoid():
    ledger = Ledger()
    logged = [
        gps(h_msl_m=ELLIPSOID, undulation_m=UNDULATION),
        gps(h_msl_m=ELLIPSOID, sigma_v_m=1.0),
        gps(pressure_pa=9e4),
    ]
    changed = with_both_heights(
        logged,
        {HEIGHT_OPTION: 16.0},
        ledger,
        "PARM",
    )
    assert [heights(each) for each in changed] == [
        BOTH,
        {"h_ellipsoid_m": ELLIPSOID, "sigma_v_m": 1.0},
        {"pressure_pa": 9e4},
    ]
    assert [(e.kind, e.code, e.where) for e in ledger] == [("note", "HEIGHT-ELLIPSOID", "PARM")]
