"""The findings of all rules go into the ledger, and what the mission file accepts is accepted."""

import math

import numpy as np

from unbend.messages import Kind, Ledger
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.rules import RULES

VERIFYING = ("TIES-RESIDUALS", "ORIENTATION-TIES")
"""Codes of comparisons of tie points, which have been compared with an elevation model too."""


def report_findings(facts: Facts, ledger: Ledger) -> None:
    """Findings of all rules, and warnings of those that the mission file accepts.

    A warning (DEM-UNVERIFIED) where nothing could contradict its elevation model. Losses cannot be
    accepted: refuses (MissionError ACCEPT-LOSS) the code of one.
    """
    mission = facts.mission
    for rule in RULES:
        ledger.extend(rule(facts))
    if mission.ground.model is not None and not is_verified(facts, ledger):
        ledger.add(messages.model_unverified(where="ground.height.dem"))
    losses = {entry.code for entry in ledger if entry.kind is Kind.LOSS}
    for accepted in mission.accept:
        if accepted.code in losses:
            raise messages.loss_accepted(where="accept", accepted_code=accepted.code)
    reasons = {accepted.code: accepted.reason for accepted in mission.accept}
    for code in ledger.accept(reasons):
        ledger.add(messages.accepted_code_unused(where="accept", accepted_code=code))


def is_verified(facts: Facts, ledger: Ledger) -> bool:
    """Whether something in the mission could contradict its elevation model."""
    takeoff = facts.takeoff
    if takeoff is not None and takeoff.stands and math.isfinite(facts.model_at_takeoff_m):
        return True
    if bool(np.isfinite(facts.logged_terrain_m).any()):
        return True
    return any(entry.code in VERIFYING for entry in ledger)
