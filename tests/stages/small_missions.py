"""Missions of a small block with known truth, by the files of another program."""

import pandas as pd
import yaml

from tests.helpers import refused
from unbend.batch.runs import run_mission


def enu_at(lat_deg, lon_deg, h_ellipsoid_m):
    """A local frame as a mission file states it."""
    origin = {
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "h_ellipsoid_m": h_ellipsoid_m,
    }
    return {"enu": origin}


ORIGIN = enu_at(46.95, 7.45, 0.0)


def mission_of(observed, program, **orientation):
    return {
        "mission": {"name": "small"},
        "observations": {"path": observed, "format": program},
        "cameras": {"c": {"calibration": "laboratory"}},
        "stations": {"orientation": {"date": "2026-05-14"} | orientation},
        "ground": {"height": "block"},
        "atmosphere": {"adjust": False},
        "output": {"path": "results"},
    }


def started(folder, mission):
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(mission))
    return run_mission(path, force=True)


def run(folder, mission, code=0):
    """The stations of a run that ends with this code, and its messages by their codes."""
    outcome = started(folder, mission)
    ledger = outcome.manifest.values["ledger"]
    assert outcome.exit_code == code, ledger
    stations = pd.read_parquet(outcome.output / "stations.parquet")
    return stations, {entry["code"]: entry for entry in ledger}


def rows_of(folder):
    """The corrected observations of the last run."""
    return pd.read_parquet(folder / "results" / "observations")


def refusal(folder, mission, code):
    """What a mission is refused with."""
    with refused(code) as caught:
        started(folder, mission)
    return str(caught.value)
