"""The findings of all rules: reported, accepted by the mission file, or held back for a cause."""

import math
from collections.abc import Iterable, Mapping, Sequence, Set

import numpy as np

from unbend.config.mission_file import AcceptedFinding
from unbend.messages import Kind, Ledger, Message
from unbend.stages.plausibility import messages
from unbend.stages.plausibility.facts import Facts
from unbend.stages.plausibility.rules import RULES, are_sides_exchanged

CAUSES_OF_ALL = frozenset(
    {
        "PLAUSIBLE-VIEW",
        "PLAUSIBLE-PRINCIPAL-POINT",
        "PLAUSIBLE-DISTORTION",
        "PLAUSIBLE-EXTENT",
        "PLAUSIBLE-DIRECTION",
        "PLAUSIBLE-ANGLE",
        "PLAUSIBLE-LEVER-ARM",
        "PLAUSIBLE-DELAY",
    }
)
"""Codes of mistakes that make rays of tie points miss each other: they may cause any finding of
tie points."""

CAUSES_OF_HEIGHTS = frozenset({"PLAUSIBLE-GROUND", "PLAUSIBLE-TERRAIN"})
"""Codes of mistakes with which rays meet, but not at the ground: they may cause `HEIGHT_TIES`."""

HEIGHT_TIES = frozenset({"TIES-HEIGHT"})
"""Codes of findings of tie points that wrong heights alone can cause."""

DECIDED_TIES = HEIGHT_TIES | frozenset(
    {
        "TIES-CALIBRATION",
        "TIES-CAMERAS",
        "TIES-FOCAL",
        "TIES-MOUNT",
        "TIES-PIXELS",
        "TIES-TIME",
    }
)
"""Codes of comparisons with tie points in which one mistake explains how rays miss."""

UNDECIDED_TIES = frozenset({"TIES-RESIDUALS", "ORIENTATION-TIES"})
"""Codes of comparisons with tie points in which no single mistake explains how rays miss."""

CODES_OF_COMPARISON = UNDECIDED_TIES
"""Codes that are in the ledger, at least as notes, if tie points were compared with the mission.
With an elevation model they were compared with its heights too."""

STATUSES_OF_WRONG_RAYS = ("misses_ground", "beyond_grazing", "far_branch")
"""Statuses of rows whose rays have a wrong direction or place."""


def report_findings(facts: Facts, ledger: Ledger) -> None:
    """Add the findings of all rules to the ledger.

    Also a warning (DEM-UNVERIFIED) if nothing in the mission can contradict its elevation model.
    """
    for rule in RULES:
        ledger.extend(rule(facts))
    has_model = facts.mission.ground.model is not None
    if has_model and not is_verified(facts, ledger):
        ledger.add(messages.model_unverified(where="ground.height.dem"))


def findings_causing_statuses(facts: Facts, ledger: Ledger) -> dict[str, str]:
    """For statuses of rows the code of the finding that is probably the cause of the status.

    Several codes of tie points are listed in one text. Findings that the mission file accepts cause
    nothing, nor do findings of tie points that will be held back (`hold_back_ties`).
    """
    codes = {entry.code for entry in ledger if entry.kind is Kind.FINDING}
    codes -= {accepted.code for accepted in facts.mission.accept}
    causing_findings = {}
    if "PLAUSIBLE-EXTENT" in codes:
        causing_findings["outside_camera"] = "PLAUSIBLE-EXTENT"
    if "PLAUSIBLE-SENSORS" in codes and are_suspect_by_height(facts, ledger):
        causing_findings["no_station"] = "PLAUSIBLE-SENSORS"
    tie_codes = codes & (DECIDED_TIES - consequences_in_ties(codes))
    if tie_codes:
        listed_codes = ", ".join(sorted(tie_codes))
        for status in STATUSES_OF_WRONG_RAYS:
            causing_findings[status] = listed_codes
    return causing_findings


def are_suspect_by_height(facts: Facts, ledger: Ledger) -> bool:
    """Whether all stations that are not ok are suspect, and barometer and GNSS height disagree."""
    status = facts.stations.status[~facts.stations.ok]
    heights_disagree = any(entry.code == "STATIONS-HEIGHT" for entry in ledger)
    return heights_disagree and status.size > 0 and bool(np.all(status == "suspect"))


def cameras_of_exchanged_sides(facts: Facts) -> list[str]:
    """The names of the cameras whose width and height seem exchanged."""
    return [name for name, camera in facts.cameras.items() if are_sides_exchanged(camera)]


def settle_findings(
    accepted: Iterable[AcceptedFinding],
    causing_findings: Mapping[str, str],
    exchanged: Sequence[str],
    ledger: Ledger,
) -> None:
    """Accept what the mission file accepts, then take findings that others cause from the ledger.

    * Findings that may follow from exchanged sides of images (`hold_back_extents`); ``exchanged``
      are the cameras with such images.
    * Findings that many rows have a status, if that is among ``causing_findings`` (by status, as of
      `findings_causing_statuses`).
    * Findings of tie points that may follow from others (`hold_back_ties`).
    """
    accept_findings(accepted, ledger)
    hold_back_extents(exchanged, ledger)
    ledger.remove(
        lambda entry: (
            entry.kind is Kind.FINDING
            and entry.code == "PLAUSIBLE-FLAGGED"
            and entry.values["name"] in causing_findings
        )
    )
    hold_back_ties(ledger)


def hold_back_extents(exchanged: Sequence[str], ledger: Ledger) -> None:
    """Take findings that may follow from exchanged sides of images from the ledger.

    They are points outside the image, and rows that are flagged as outside_camera. ``exchanged``
    are the cameras with such images; only those count that have a finding of the principal point
    that is not accepted. A note (SIDES-HELD-BACK) names what was taken out.
    """
    cameras_off_centre = set()
    for entry in ledger:
        if entry.kind is Kind.FINDING and entry.code == "PLAUSIBLE-PRINCIPAL-POINT":
            cameras_off_centre.add(entry.values["name"])
    cameras = [name for name in exchanged if name in cameras_off_centre]
    if not cameras:
        return

    def follows(entry: Message) -> bool:
        if entry.kind is not Kind.FINDING:
            return False
        if entry.code == "PLAUSIBLE-EXTENT":
            return entry.values["name"] in cameras
        return entry.code == "PLAUSIBLE-FLAGGED" and entry.values["name"] == "outside_camera"

    held = ledger.remove(follows)
    if held:
        codes = [entry.code for entry in held]
        ledger.add(messages.sides_held_back(codes=codes, cameras=cameras))


def hold_back_ties(ledger: Ledger) -> None:
    """Take findings of tie points from the ledger, where another finding may be their cause.

    A note (TIES-HELD-BACK) names what was taken out. Accepted findings cause nothing: there the
    mission file is right.
    """
    codes = {entry.code for entry in ledger if entry.kind is Kind.FINDING}
    consequences = consequences_in_ties(codes)
    held = ledger.remove(lambda entry: entry.kind is Kind.FINDING and entry.code in consequences)
    if held:
        ledger.add(
            messages.ties_held_back(
                codes=[entry.code for entry in held],
                keys=[entry.where for entry in held],
                causes=sorted(codes & (CAUSES_OF_ALL | CAUSES_OF_HEIGHTS)),
            )
        )


def consequences_in_ties(codes: Set[str]) -> frozenset[str]:
    """Codes of the findings of tie points that findings with ``codes`` may cause."""
    if codes & CAUSES_OF_ALL:
        return DECIDED_TIES | UNDECIDED_TIES
    if codes & CAUSES_OF_HEIGHTS:
        return HEIGHT_TIES
    return frozenset()


def accept_findings(accepted: Iterable[AcceptedFinding], ledger: Ledger) -> None:
    """Turn the findings that the mission file accepts into warnings with its reasons.

    Refuses (MissionError ACCEPT-LOSS) to accept the code of a loss in the ledger; warns of an
    accepted code that no finding has.
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
    """Whether something in the mission can contradict its elevation model.

    It is a take-off from ground that the model covers, or terrain heights that the autopilot
    logged, or tie points.
    """
    takeoff = facts.takeoff
    if takeoff is not None and takeoff.stands and math.isfinite(facts.model_at_takeoff_m):
        return True
    if bool(np.isfinite(facts.logged_terrain_m).any()):
        return True
    return any(entry.code in CODES_OF_COMPARISON for entry in ledger)
