"""``campaign.html`` and ``campaign.parquet``: a table of the missions of a campaign."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import pyarrow as pa

from unbend.flight.stations import UNMATCHED
from unbend.report.summary import verdict
from unbend.tables.manifest.whole import Manifest
from unbend.tables.written_columns import columns_of, schema_of

COLUMNS = columns_of("campaign")

DONE = "done"
WITH_LOSSES = "done with losses or findings"
"""States of missions that have results."""

Row = Mapping[str, Any]
"""Name of a column of ``campaign.parquet`` -> its value for a mission, None if unknown."""


def row_of(manifest: Manifest) -> dict[str, Any]:
    """The row of a mission that has results."""
    run = manifest.run
    results = manifest.results
    flight = results.flight
    kinds = Counter(entry.kind for entry in results.ledger)
    images = sum(results.stations.values())
    row = dict.fromkeys(COLUMNS) | {
        "mission": run.mission,
        "state": WITH_LOSSES if run.exit_code else DONE,
        "exit_code": run.exit_code,
        "what": verdict(manifest),
        "begin_utc": flight.begin_utc,
        "end_utc": flight.end_utc,
        "lat_deg": middle_of(flight.latitude_deg),
        "lon_deg": middle_of(flight.longitude_deg),
        "h_msl_m": middle_of(flight.h_msl_m),
        "images": images,
        "exposures": images - results.stations.get(UNMATCHED, 0),
        "observations": results.observations.rows,
        "corrected": results.correction.shift_px.count,
        "fingerprint": run.fingerprint,
        "losses": kinds["loss"],
        "findings": kinds["finding"],
        "warnings": kinds["warning"],
    }
    totals = [parts["all"] for parts in results.sigma_budget.values() if "all" in parts]
    shift_px = results.correction.shift_px
    row["shift_median_px"] = shift_px.median
    row["shift_maximum_px"] = shift_px.maximum
    row["sigma_px"] = largest(total.px.median for total in totals)
    shift_m = results.correction.shift_ground_m
    row["shift_median_m"] = shift_m.median
    row["shift_maximum_m"] = shift_m.maximum
    row["sigma_m"] = largest(total.m.median for total in totals)
    return row


def middle_of(spread: Sequence[float] | None) -> float | None:
    """The median of [lowest, median, highest]; None if the spread is unknown."""
    return None if spread is None else spread[1]


def largest(values: Iterable[float | None]) -> float | None:
    """The largest of the values that are not None; None without any."""
    return max((value for value in values if value is not None), default=None)


def row_without(name: str, exit_code: int | None, code: str, what: str) -> dict[str, Any]:
    """The row of a mission without results: not run yet if ``exit_code`` is None, else refused.

    ``code`` and ``what`` are the code and text of the refusal, or "" and the reason.
    """
    return dict.fromkeys(COLUMNS) | {
        "mission": name,
        "state": "refused" if exit_code is not None else "not run",
        "exit_code": exit_code,
        "code": code or None,
        "what": what,
    }


def campaign_table(name: str, rows: Sequence[Row]) -> pa.Table:
    """The rows as an Arrow table with units, for a campaign of this name; times become UTC."""
    typed = []
    for row in rows:
        values = dict(row)
        for column in ("begin_utc", "end_utc"):
            if values[column]:
                values[column] = datetime.fromisoformat(values[column])
        typed.append(values)
    return pa.Table.from_pylist(typed, schema_of(COLUMNS, {"unbend.campaign": name}))


def campaign_page(name: str, rows: Sequence[Row], digest: str) -> str:
    """The page of a campaign as HTML; the same rows give the same bytes.

    ``digest`` is the hash of the inputs of the page, which is written into it.
    """
    from unbend.report.report_page import environment

    located = [row for row in rows if row["lat_deg"] is not None]
    # Longitudes within half a turn of the first: a campaign across 180 degrees is one place.
    middle = located[0]["lon_deg"] if located else 0.0
    longitudes = [(row["lon_deg"] - middle + 180.0) % 360.0 - 180.0 + middle for row in located]
    lon = np.array(longitudes)
    lat = np.array([row["lat_deg"] for row in located])
    state = np.array([row["state"] for row in located])
    places = {}
    for state_of_results in (DONE, WITH_LOSSES):
        is_in_state = state == state_of_results
        places[state_of_results] = (lon[is_in_state], lat[is_in_state])
    limits = None
    if located:
        limits = (lon.min(), lon.max(), lat.min(), lat.max())
    return (
        environment()
        .get_template("campaign.html.j2")
        .render(
            name=name,
            rows=rows,
            digest=digest,
            states=Counter(row["state"] for row in rows),
            places=places,
            limits=limits,
        )
    )
