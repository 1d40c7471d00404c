"""What has to be looked at before the results of a run are used."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from unbend.report.explanations import meanings
from unbend.report.words import count
from unbend.tables.manifest.whole import Manifest

LOSSES_OF_ROWS = (
    "IMAGES-UNMATCHED",
    "OBS-FLAGGED",
    "OBS-GROUND-RANGE",
    "OBS-NO-IMAGE",
    "POINTS-MISSING",
    "STATIONS-FLAGGED",
)
"""Losses of single rows, which have no corrected coordinates: counted apart."""

OF_SUSPECTS = ("STATIONS-SUSPECT", "STATIONS-HEIGHT", "ORIENTATION-FAR", "ORIENTATION-UP")
"""Codes of what makes stations suspect."""

OF_INCOMPLETE_LOGS = ("LOG-DROPOUT", "LOG-GAP", "LOG-LINK-LOSS")
"""Findings that messages are missing between the rest of a log, which is no mistake."""


OF_LOGS = "LOG-"
"""Codes of damaged or incomplete logs begin so."""

MOST_REMEDIES = 3  # that the next steps have of losses; the ledger has the others


class Concern(NamedTuple):
    """What is to be looked at, in words, and how."""

    what: str
    step: str


def concerns_of(manifest: Manifest) -> list[Concern]:
    """What has to be looked at before the results are used, the gravest first."""
    return [
        *_mistakes(manifest),
        *_incomplete_log(manifest),
        *_suspect_stations(manifest),
        *_losses(manifest),
        *_published_method(manifest),
    ]


def _codes(manifest: Manifest, kind: str, *, without: Sequence[str]) -> list[str]:
    """The codes of a kind of messages, each once, in the order of the alphabet."""
    codes = {entry.code for entry in manifest.results.ledger if entry.kind == kind}
    return sorted(codes.difference(without))


def _mistakes(manifest: Manifest) -> Iterator[Concern]:
    """Findings: contradictions in the mission file and its inputs."""
    other_codes = (*OF_INCOMPLETE_LOGS, *LOSSES_OF_ROWS, *OF_SUSPECTS)
    codes = _codes(manifest, "finding", without=other_codes)
    if codes:
        names = ", ".join(codes)
        yield Concern(
            f"{count(len(codes), 'likely mistake')} ({names})",
            f"Correct the cause of {names} and run again, or accept it with the reason (accept).",
        )


def _incomplete_log(manifest: Manifest) -> Iterator[Concern]:
    """Findings that a log lacks messages."""
    codes = _codes(manifest, "finding", without=())
    names = ", ".join(code for code in codes if code in OF_INCOMPLETE_LOGS)
    if names:
        yield Concern(
            f"an incomplete log ({names})",
            f"Use a complete log, for example from the vehicle's card, or accept {names} (accept).",
        )


def _suspect_stations(manifest: Manifest) -> Iterator[Concern]:
    """Stations that other evidence contradicts."""
    number = manifest.results.stations.get("suspect", 0)
    if not number:
        return
    stations = count(number, "suspect station")
    reasons = [entry.what for entry in manifest.results.ledger if entry.code in OF_SUSPECTS]
    more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
    left_out = ""
    if not manifest.sections.stations.use_suspect:
        left_out = " (without corrected coordinates)"
    yield Concern(
        f"{stations}{left_out}",
        f"Check the {stations} (unbend stations MISSION --plot FILE): {reasons[0]}{more}.",
    )


def _losses(manifest: Manifest) -> Iterator[Concern]:
    """Losses of more than single rows."""
    codes = _codes(manifest, "loss", without=(*LOSSES_OF_ROWS, *OF_SUSPECTS))
    if codes:
        names = ", ".join(codes)
        yield Concern(
            f"{count(len(codes), 'loss', 'losses')} ({names})",
            " ".join(steps_of_losses(codes)),
        )


def steps_of_losses(codes: Sequence[str]) -> list[str]:
    """What to do about losses: for those of a log as one, for others the remedies of their codes.

    >>> steps_of_losses(["GEOID-OUTSIDE"])
    ['GEOID-OUTSIDE: Give mission.undulation_m, or a grid that covers the flight.']
    """
    steps = []
    of_logs = [code for code in codes if code.startswith(OF_LOGS)]
    if of_logs:
        names = ", ".join(of_logs)
        steps.append(f"Check which data was lost ({names}). If there is a complete file, use it.")
    others = [code for code in codes if code not in of_logs]
    meaning_of_code = meanings()["codes"]
    explained = [code for code in others if code in meaning_of_code][:MOST_REMEDIES]
    for code in explained:
        steps.append(f"{code}: {meaning_of_code[code].remedy}")
    unexplained = [code for code in others if code not in explained]
    if unexplained:
        steps.append(f"See the ledger about {', '.join(unexplained)}.")
    return steps


def _published_method(manifest: Manifest) -> Iterator[Concern]:
    """A method that was published, and that only comparisons need."""
    method = manifest.sections.refraction.method
    if method != "spherical":
        yield Concern(
            f"the method {method} (published, for comparison)",
            "Run again without refraction.method: the published methods are only for comparison.",
        )
