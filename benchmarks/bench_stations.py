"""20,000 exposures become stations beside the ingest of a log that has 256."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from unbend.config import load_mission
from unbend.flight.exposures import Events
from unbend.ingest import open_log
from unbend.messages import Ledger
from unbend.stages.flight_log import flight_log
from unbend.stages.opened_inputs import OpenedInputs
from unbend.stages.stations import StationBuilder
from unbend.tables.observations import open_observations

LOG = Path(__file__).resolve().parents[2] / "shared" / "logs" / "sitl_survey.BIN"
COUNT = 20_000
MISSION = """
mission: {{name: stations}}
log: {{path: {log}}}
observations: {{path: observations.parquet}}
cameras:
  c:
    width_px: 6000
    height_px: 4000
    f_px: 5000.0
    cx_px: 3000.0
    cy_px: 2000.0
    calibration: laboratory
mount: {{c: {{}}}}
events: {{log: {{c: {{channel: "CAM[0]", image: "{{n}}"}}}}}}
ground: {{height: 500.0, reference: msl}}
output: {{path: results}}
"""


@pytest.mark.skipif(not LOG.is_file(), reason="../shared/logs is not beside this checkout")
def test_twenty_thousand_stations_beside_the_ingest_of_a_log(ratios, tmp_path):
    observed = pa.table({"image": ["1"], "point": ["p"], "x_px": [1.0], "y_px": [1.0]})
    pq.write_table(observed, tmp_path / "observations.parquet")
    path = tmp_path / "mission.yaml"
    path.write_text(MISSION.format(log=LOG), "utf-8")
    mission = load_mission(path)
    columns = mission.observations.columns.model_dump()
    observations = open_observations(
        tmp_path / "observations.parquet",
        columns,
        None,
        Ledger(),
    )
    inputs = OpenedInputs(observations, open_log(LOG))
    flight = flight_log(mission, inputs, Ledger())
    builder = StationBuilder.of(mission, flight, "c", None)
    (logged,) = (channel for channel in flight.channels if channel.name == "CAM[0]")
    time_ns = np.linspace(logged.time_ns[0], logged.time_ns[-1], COUNT)
    names = np.array([f"i{k}" for k in range(COUNT)], object)
    events = Events("c", names, time_ns.astype(np.int64))
    assert builder.stations(events).ok.mean() > 0.99
    ratio = ratios.of_times(
        lambda: builder.stations(events),
        lambda: open_log(LOG),
    )
    ratios.check("20,000 stations, times the ingest of a log", 1.0 / ratio, at_most=0.5)
