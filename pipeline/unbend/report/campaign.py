"""``campaign.html`` and ``campaign.parquet``: a row a mission."""

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import pyarrow as pa

from unbend.report.summary import verdict
from unbend.tables.schemas import columns_of, schema_of

COLUMNS = columns_of("campaign")

DONE = "done"
WITH_LOSSES = "done with losses or findings"
"""States of missions that have results."""

Row = Mapping[str, Any]
"""What the page shows of a mission, by the names of the columns of the table."""


def row_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a mission that is done."""
    flight = manifest["flight"]
    correction = manifest["correction"]
    kinds = Counter(entry["kind"] for entry in manifest["ledger"])
    row = dict.fromkeys(COLUMNS) | {
        "mission": manifest["mission"],
        "state": WITH_LOSSES if manifest["exit_code"] else DONE,
        "exit_code": manifest["exit_code"],
        "what": verdict(manifest),
        "begin_utc": flight["begin_utc"],
        "end_utc": flight["end_utc"],
        "exposures": sum(manifest["stations"].values()),
        "observations": manifest["observations"]["rows"],
        "corrected": correction["shift_px"]["count"],
        "fingerprint": manifest["fingerprint"],
        "losses": kinds["loss"],
        "findings": kinds["finding"],
        "warnings": kinds["warning"],
    }
    spreads = {"lat_deg": "latitude_deg", "lon_deg": "longitude_deg", "h_msl_m": "h_msl_m"}
    for name, spread in spreads.items():
        if flight[spread]:
            row[name] = flight[spread][1]
    for unit, shift in (("px", "shift_px"), ("m", "shift_ground_m")):
        row[f"shift_median_{unit}"] = correction[shift]["median"]
        row[f"shift_maximum_{unit}"] = correction[shift]["maximum"]
        row[f"sigma_{unit}"] = largest_sigma(manifest["sigma_budget"], unit)
    return row


def largest_sigma(sigma_budget: Mapping[str, Any], unit: str) -> float | None:
    """The largest of the cameras' median standard deviations; None where none is known."""
    medians = []
    for camera in sigma_budget.values():
        if "all" in camera and camera["all"][unit]["median"] is not None:
            medians.append(camera["all"][unit]["median"])
    return max(medians, default=None)


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
    from unbend.report.html import environment

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
