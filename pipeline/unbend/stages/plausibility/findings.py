"""The findings of all rules go into the ledger, and what the mission file accepts is accepted."""

import math
from collections.abc import Iterable

import numpy as np

from unbend.config.mission_file import AcceptedFinding
from unbend.messages import Kind, Ledger
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.rules import RULES

VERIFYING = ("TIES-RESIDUALS", "ORIENTATION-TIES")
"""Codes of the comparison with tie points, which compares an elevation model with them too."""


def report_findings(facts: Facts, ledger: Ledger) -> None:
    """Add the findings of all rules to the ledger, and accept those that the mission file accepts.

    Adds a warning (DEM-UNVERIFIED) if nothing in the mission could contradict its elevation model.
    """
    for rule in RULES:
        ledger.extend(rule(facts))
    has_model = facts.mission.ground.model is not None
    if has_model and not is_verified(facts, ledger):
        ledger.add(messages.model_unverified(where="ground.height.dem"))
    accept_findings(facts.mission.accept, ledger)


def accept_findings(accepted: Iterable[AcceptedFinding], ledger: Ledger) -> None:
    """Turn the findings in the ledger that the mission file accepts into warnings.

    The warnings keep the reasons that the mission file gives. Refuses (MissionError ACCEPT-LOSS)
    the code of a loss, which cannot be accepted; warns of an accepted code that no finding has.
    """
    losses = {entry.code for entry in ledger if entry.kind is Kind.LOSS}
    reasons = {}
    for finding in accepted:
        if finding.code in losses:
            raise messages.loss_accepted(where="accept", accepted_code=finding.code)
        reasons[finding.code] = finding.reason
    unused_codes = ledger.accept(reasons)
    for code in unused_codes:
        ledger.add(messages.accepted_code_unused(where="accept", accepted_code=code))


def is_verified(facts: Facts, ledger: Ledger) -> bool:
    """Whether something in the mission could contradict its elevation model.

    That is a take-off from ground that the model covers, terrain heights that the autopilot logged,
    or tie points.
    """
    takeoff = facts.takeoff
    if takeoff is not None and takeoff.stands and math.isfinite(facts.model_at_takeoff_m):
        return True
    if bool(np.isfinite(facts.logged_terrain_m).any()):
        return True
    return any(entry.code in VERIFYING for entry in ledger)
