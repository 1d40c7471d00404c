"""Heights above the ellipsoid and above sea level, of logs that also have the undulation."""

from __future__ import annotations

import numpy as np

from unbend.flight.channels import Channel, Source
from unbend.ingest.channel_builder import HEIGHT_OPTION, with_both_heights
from unbend.messages import Ledger

# The undulation at Zurich is 47.5 m: the ellipsoid lies below sea level.
SEA_LEVEL = 552.5
UNDULATION = 47.5
ELLIPSOID = 600.0


def channel(**columns: float) -> Channel:
    arrays = {name: np.array([value]) for name, value in columns.items()}
    return Channel("GPS", np.zeros(1, np.int64), arrays, Source("GPS"))


def heights(of: Channel) -> dict[str, float]:
    return {name: values[0] for name, values in of.columns.items()}


BOTH = {"h_msl_m": SEA_LEVEL, "h_ellipsoid_m": ELLIPSOID}


def test_sea_level_and_undulation_give_the_height_above_the_ellipsoid():
    assert (
        heights(
            with_both_heights(
                [channel(h_msl_m=SEA_LEVEL, undulation_m=UNDULATION)], {}, Ledger(), "PARM"
            )[0]
        )
        == BOTH
    )


def test_a_logged_height_above_the_ellipsoid_is_kept():
    logged = channel(h_msl_m=SEA_LEVEL, h_ellipsoid_m=599.0, undulation_m=UNDULATION)
    assert heights(with_both_heights([logged], {}, Ledger(), "PARM")[0])["h_ellipsoid_m"] == 599.0


def test_the_parameter_turns_heights_above_sea_level_into_those_above_the_ellipsoid():
    ledger = Ledger()
    logged = [
        channel(h_msl_m=ELLIPSOID, undulation_m=UNDULATION),
        channel(h_msl_m=ELLIPSOID, sigma_v_m=1.0),
        channel(pressure_pa=9e4),
    ]
    with_undulation_, without, baro = with_both_heights(
        logged, {HEIGHT_OPTION: 16.0}, ledger, "PARM"
    )
    assert heights(with_undulation_) == BOTH
    assert heights(without) == {"h_ellipsoid_m": ELLIPSOID, "sigma_v_m": 1.0}
    assert heights(baro) == {"pressure_pa": 9e4}
    assert [(e.kind, e.code, e.where) for e in ledger] == [("note", "HEIGHT-ELLIPSOID", "PARM")]
