"""``campaign.html`` and ``campaign.parquet``: a row a mission."""

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
"""What the page shows of a mission, by the names of the columns of the table."""


def row_of(manifest: Manifest) -> dict[str, Any]:
    """The row of a mission that is done."""
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
    """The median of lowest, median and highest; None where nothing is known."""
    return None if spread is None else spread[1]


def largest(values: Iterable[float | None]) -> float | None:
    """The largest of the values that are known; None where none is."""
    return max((value for value in values if value is not None), default=None)


def row_without(name: str, exit_code: int | None, code: str, what: str) -> dict[str, Any]:
    """The row of a mission that has no results: refused, or not run yet (no exit code)."""
    return dict.fromkeys(COLUMNS) | {
        "mission": name,
        "state": "refused" if exit_code is not None else "not run",
        "exit_code": exit_code,
        "code": code or None,
        "what": what,
    }


def campaign_table(name: str, rows: Sequence[Row]) -> pa.Table:
    """The rows as a table with units."""
    typed = []
    for row in rows:
        values = dict(row)
        for column in ("begin_utc", "end_utc"):
            if values[column]:
                values[column] = datetime.fromisoformat(values[column])
        typed.append(values)
    return pa.Table.from_pylist(typed, schema_of(COLUMNS, {"unbend.campaign": name}))


def campaign_page(name: str, rows: Sequence[Row], digest: str) -> str:
    """The page as HTML; the same rows give the same bytes. ``digest`` says what it was made of."""
    from unbend.report.report_page import environment

    placed = [row for row in rows if row["lat_deg"] is not None]
    # Longitudes in the turn of the first, so that a campaign at 180 degrees is one place.
    turn = placed[0]["lon_deg"] if placed else 0.0
    longitudes = [(row["lon_deg"] - turn + 180.0) % 360.0 - 180.0 + turn for row in placed]
    lon = np.array(longitudes)
    lat = np.array([row["lat_deg"] for row in placed])
    state = np.array([row["state"] for row in placed])
    places = {}
    for of_results in (DONE, WITH_LOSSES):
        places[of_results] = (lon[state == of_results], lat[state == of_results])
    limits = None
    if placed:
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
