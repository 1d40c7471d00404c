"""The manifest: everything a reader of the results may ask about how they came to be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.atmosphere.adjust import Adjustment
from pipeline.batch.plan import Plan, versions
from pipeline.batch.tally import Tally
from pipeline.errors import EXIT_DONE, EXIT_LOSSES
from pipeline.flight.channels import Channel
from pipeline.flight.stations import Stations
from pipeline.ingest import Log
from pipeline.ledger import Ledger

MANIFEST_VERSION = 1


@dataclass(frozen=True)
class Outcome:
    """How a mission ended: where its results are, its manifest, and its exit code."""

    name: str
    output: Path
    manifest: dict[str, Any]
    exit_code: int
    repeated: bool


def outcome_of(plan: Plan, manifest: dict[str, Any], *, repeated: bool) -> Outcome:
    """The outcome that a manifest tells of."""
    return Outcome(
        plan.mission.mission.name, plan.output, manifest, int(manifest["exit_code"]), repeated
    )


def manifest_of(
    plan: Plan,
    log: Log,
    roles: Mapping[str, Channel],
    stations: Stations,
    adjustment: Adjustment,
    tally: Tally,
    ledger: Ledger,
) -> dict[str, Any]:
    """The manifest of a run, without its outputs.

    Holds no clock, no host name and no absolute path: the same inputs give the same bytes.
    """
    entries = ledger.rows()
    for entry in entries:  # the log is known by its name in the mission file
        entry["where"] = str(entry["where"]).replace(str(log.path), plan.mission.log.path)
    return {
        "manifest_version": MANIFEST_VERSION,
        "mission": plan.mission.mission.name,
        "fingerprint": plan.fingerprint,
        "config": plan.mission.model_dump(mode="json"),
        "inputs": [
            {"role": item.role, "name": item.name, "sha256": item.sha256} for item in plan.inputs
        ],
        "versions": versions(),
        "log": {
            "format": log.format,
            "messages": dict(log.messages),
            "bad_bytes": log.bad_bytes,
            "lost_messages": log.lost_messages,
            "boots": log.boots,
            "duration_s": round(log.duration_s, 3),
            "time_base": log.time_base,
        },
        "channels": {role: channel.name for role, channel in sorted(roles.items())},
        "stations": dict(sorted(Counter(stations.status.tolist()).items())),
        "profile": _profile(adjustment, stations),
        "observations": {"rows": tally.rows, "parts": tally.parts, "status": tally.status},
        "correction": tally.correction(),
        "ledger": entries,
        "exit_code": EXIT_LOSSES if ledger.has_losses else EXIT_DONE,
    }


def _profile(adjustment: Adjustment, stations: Stations) -> dict[str, Any]:
    """How the air was found, and by how much it differs from the standard at the cameras."""
    profile, standard = adjustment.profile, adjustment.standard
    heights, latitude = stations.h_msl_m[stations.ok], profile.gravity.latitude_rad
    difference = None
    if heights.size:
        level = float(np.median(heights))
        difference = round(float(profile.temperature(level) - standard.temperature(level)), 3)
    return {
        "basis": adjustment.basis,
        "reason": adjustment.reason,
        "standard": standard.name,
        "layers": dict(sorted(Counter(profile.layers.source).items())),
        "latitude_deg": round(float(np.degrees(latitude)), 6) if latitude is not None else None,
        "departure_at_cameras_k": difference,
    }
