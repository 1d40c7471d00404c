"""The findings of all rules go into the ledger, and what the mission file accepts is accepted."""

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
"""Codes of mistakes with which the rays of tie points do not meet, whatever else is wrong."""

CAUSES_OF_HEIGHTS = frozenset({"PLAUSIBLE-GROUND", "PLAUSIBLE-TERRAIN"})
"""Codes of mistakes with which the rays meet, at other heights than those of the ground."""

OF_HEIGHTS = frozenset({"TIES-HEIGHT"})
"""Codes of what tie points find where heights alone are wrong."""

DECIDED_TIES = OF_HEIGHTS | frozenset(
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

VERIFYING = UNDECIDED_TIES
"""Codes by which one sees that tie points were compared, with an elevation model too; as notes."""

OF_RAYS = ("misses_ground", "beyond_grazing", "far_branch")
"""Statuses of rows whose rays have a wrong direction or place."""


def report_findings(facts: Facts, ledger: Ledger) -> None:
    """Add the findings of all rules to the ledger.

    Adds a warning (DEM-UNVERIFIED) if nothing in the mission could contradict its elevation model.
    """
    for rule in RULES:
        ledger.extend(rule(facts))
    has_model = facts.mission.ground.model is not None
    if has_model and not is_verified(facts, ledger):
        ledger.add(messages.model_unverified(where="ground.height.dem"))


def known_causes(facts: Facts, ledger: Ledger) -> dict[str, str]:
    """By status of rows the code of a finding that is probably its cause.

    Findings that the mission file accepts are no causes, nor are those of tie points that are held
    back (`hold_back_ties`).
    """
    codes = {entry.code for entry in ledger if entry.kind is Kind.FINDING}
    codes -= {accepted.code for accepted in facts.mission.accept}
    known = {}
    if "PLAUSIBLE-EXTENT" in codes:
        known["outside_camera"] = "PLAUSIBLE-EXTENT"
    if "PLAUSIBLE-SENSORS" in codes and are_suspect_by_height(facts, ledger):
        known["no_station"] = "PLAUSIBLE-SENSORS"
    of_ties = codes & (DECIDED_TIES - consequences_in_ties(codes))
    if of_ties:
        listed = ", ".join(sorted(of_ties))
        known.update(dict.fromkeys(OF_RAYS, listed))
    return known


def are_suspect_by_height(facts: Facts, ledger: Ledger) -> bool:
    """Whether stations without corrections are suspect, and their barometers say why."""
    status = facts.stations.status[~facts.stations.ok]
    by_height = any(entry.code == "STATIONS-HEIGHT" for entry in ledger)
    return by_height and bool(np.all(status == "suspect"))


def cameras_of_exchanged_sides(facts: Facts) -> list[str]:
    """The names of the cameras whose width and height seem exchanged."""
    return [name for name, camera in facts.cameras.items() if are_sides_exchanged(camera)]


def settle_findings(
    accepted: Iterable[AcceptedFinding],
    known: Mapping[str, str],
    exchanged: Sequence[str],
    ledger: Ledger,
) -> None:
    """Accept what the mission file accepts, and hold back what other findings may cause.

    That is what tie points find (`hold_back_ties`), what follows from the ``exchanged`` sides of
    the images of some cameras, and that many rows have a status whose cause is ``known`` by another
    finding.
    """
    accept_findings(accepted, ledger)
    hold_back_extents(exchanged, ledger)
    ledger.remove(
        lambda entry: (
            entry.kind is Kind.FINDING
            and entry.code == "PLAUSIBLE-FLAGGED"
            and entry.values["name"] in known
        )
    )
    hold_back_ties(ledger)


def hold_back_extents(exchanged: Sequence[str], ledger: Ledger) -> None:
    """Take out of the ledger what follows from exchanged sides of the images of some cameras.

    That are points outside the image, and rows that are flagged as such. A note (SIDES-HELD-BACK)
    names what was taken out. An accepted finding of the principal point is no cause.
    """
    causes = set()
    for entry in ledger:
        if entry.kind is Kind.FINDING and entry.code == "PLAUSIBLE-PRINCIPAL-POINT":
            causes.add(entry.values["name"])
    cameras = [name for name in exchanged if name in causes]
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
    """Take out of the ledger what tie points find, where another finding may be its cause.

    A note (TIES-HELD-BACK) names what was taken out. Accepted findings are no causes: what the
    mission file states is right.
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
    """Codes of what tie points find where findings of some codes may be the cause."""
    if codes & CAUSES_OF_ALL:
        return DECIDED_TIES | UNDECIDED_TIES
    if codes & CAUSES_OF_HEIGHTS:
        return OF_HEIGHTS
    return frozenset()


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
