"""``campaign.html`` and ``campaign.parquet``: all missions of a campaign, one row each."""

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.report.page.html import environment
from pipeline.report.verdict import verdict
from pipeline.tables.schemas import columns_of, schema_of

COLUMNS = columns_of("campaign")
DONE, WITH_LOSSES = "done", "done with losses or findings"


def row_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a mission that is done, by the names of the columns of ``campaign.parquet``."""
    flight, correction = manifest["flight"], manifest["correction"]
    rows, kinds = manifest["observations"], Counter(e["kind"] for e in manifest["ledger"])
    sigma = [of["all"] for of in manifest["sigma_budget"].values() if "all" in of]
    row = dict.fromkeys(COLUMNS) | {
        "mission": manifest["mission"],
        "state": WITH_LOSSES if manifest["exit_code"] else DONE,
        "exit_code": manifest["exit_code"],
        "what": verdict(manifest),
        "begin_utc": flight["begin_utc"],
        "end_utc": flight["end_utc"],
        "exposures": sum(manifest["stations"].values()),
        "observations": rows["rows"],
        "corrected": correction["shift_px"]["count"],
        "fingerprint": manifest["fingerprint"],
    }
    for name, of in (("lat_deg", "latitude_deg"), ("lon_deg", "longitude_deg"),
                     ("h_msl_m", "h_msl_m")):  # fmt: skip
        if flight[of]:
            row[name] = flight[of][1]
    for unit, of in (("px", "shift_px"), ("m", "shift_ground_m")):
        for part in ("median", "maximum"):
            row[f"shift_{part}_{unit}"] = correction[of][part]
        medians = [camera[unit]["median"] for camera in sigma]
        row[f"sigma_{unit}"] = max((m for m in medians if m is not None), default=None)
    return row | {f"{kind}s" if kind != "loss" else "losses": kinds[kind]
                  for kind in ("loss", "finding", "warning")}  # fmt: skip


def row_without(name: str, exit_code: int | None, code: str, what: str) -> dict[str, Any]:
    """The row of a mission that has no results: refused, or not run yet (no exit code)."""
    state = "refused" if exit_code is not None else "not run"
    own = {"mission": name, "state": state, "exit_code": exit_code, "code": code or None}
    return dict.fromkeys(COLUMNS) | own | {"what": what}


def campaign_table(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """The rows as a table, with units and meanings."""
    values = [
        {k: datetime.fromisoformat(v) if v and k.endswith("_utc") else v for k, v in row.items()}
        for row in rows
    ]
    return pa.Table.from_pylist(values, schema_of(COLUMNS, {"unbend.campaign": name}))


def campaign_page(name: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The page as HTML; the same rows give the same bytes."""
    placed = [row for row in rows if row["lat_deg"] is not None]
    # Longitudes in the turn of the first, so that a campaign at 180 degrees is one place.
    turn = placed[0]["lon_deg"] if placed else 0.0
    lon = np.array([(row["lon_deg"] - turn + 180.0) % 360.0 - 180.0 + turn for row in placed])
    lat = np.array([row["lat_deg"] for row in placed])
    state = np.array([row["state"] for row in placed])
    page = environment().get_template("campaign.html.j2")
    return page.render(
        name=name,
        rows=rows,
        states=Counter(row["state"] for row in rows),
        places={s: (lon[state == s], lat[state == s]) for s in (DONE, WITH_LOSSES)},
        limits=(lon.min(), lon.max(), lat.min(), lat.max()) if placed else None,
    )
