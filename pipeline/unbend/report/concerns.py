"""What has to be checked before the results of a run are used."""

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
"""Losses of single rows without corrected coordinates, which the verdict counts separately."""

CODES_OF_SUSPECTS = ("STATIONS-SUSPECT", "STATIONS-HEIGHT", "ORIENTATION-FAR", "ORIENTATION-UP")
"""Codes of evidence against stations, which are then suspect."""

CODES_OF_INCOMPLETE_LOGS = ("LOG-DROPOUT", "LOG-GAP", "LOG-LINK-LOSS")
"""Findings that messages are missing within a log, which is not a mistake of the mission file."""

PREFIX_OF_LOGS = "LOG-"
"""Begin of all codes of damaged or incomplete logs."""

MOST_REMEDIES = 3  # of losses in the next steps; the ledger has all


class Concern(NamedTuple):
    """What is to be checked, as a noun phrase, and the step to do so, as a sentence."""

    what: str
    step: str


def concerns_of(manifest: Manifest) -> list[Concern]:
    """What has to be checked before the results are used, the most severe first."""
    return [
        *_mistakes(manifest),
        *_incomplete_log(manifest),
        *_suspect_stations(manifest),
        *_losses(manifest),
        *_published_method(manifest),
    ]


def _codes(manifest: Manifest, kind: str, *, without: Sequence[str]) -> list[str]:
    """The sorted codes of all messages of a kind in the ledger, except those of ``without``."""
    codes = {entry.code for entry in manifest.results.ledger if entry.kind == kind}
    return sorted(codes.difference(without))


def _mistakes(manifest: Manifest) -> Iterator[Concern]:
    """The concern about findings, which are contradictions between mission file and inputs."""
    other_codes = (*CODES_OF_INCOMPLETE_LOGS, *LOSSES_OF_ROWS, *CODES_OF_SUSPECTS)
    codes = _codes(manifest, "finding", without=other_codes)
    if codes:
        names = ", ".join(codes)
        yield Concern(
            f"{count(len(codes), 'likely mistake')} ({names})",
            f"Correct the cause of {names} and run again, or accept it with the reason (accept).",
        )


def _incomplete_log(manifest: Manifest) -> Iterator[Concern]:
    """The concern about findings that messages are missing within a log."""
    codes = _codes(manifest, "finding", without=())
    names = ", ".join(code for code in codes if code in CODES_OF_INCOMPLETE_LOGS)
    if names:
        yield Concern(
            f"an incomplete log ({names})",
            f"Use a complete log, for example from the vehicle's card, or accept {names} (accept).",
        )


def _suspect_stations(manifest: Manifest) -> Iterator[Concern]:
    """The concern about stations that are contradicted by other evidence."""
    number = manifest.results.stations.get("suspect", 0)
    if not number:
        return
    stations = count(number, "suspect station")
    reasons = [entry.what for entry in manifest.results.ledger if entry.code in CODES_OF_SUSPECTS]
    more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
    left_out = ""
    if not manifest.sections.stations.use_suspect:
        left_out = " (without corrected coordinates)"
    yield Concern(
        f"{stations}{left_out}",
        f"Check the {stations} (unbend stations MISSION --plot FILE): {reasons[0]}{more}.",
    )


def _losses(manifest: Manifest) -> Iterator[Concern]:
    """The concern about losses, except those of single rows and of suspect stations."""
    codes = _codes(manifest, "loss", without=(*LOSSES_OF_ROWS, *CODES_OF_SUSPECTS))
    if codes:
        names = ", ".join(codes)
        yield Concern(
            f"{count(len(codes), 'loss', 'losses')} ({names})",
            " ".join(steps_of_losses(codes)),
        )


def steps_of_losses(codes: Sequence[str]) -> list[str]:
    """Sentences on what to do about losses with these codes.

    Losses of a log have one step together; of other codes, the first three have their remedies.

    >>> steps_of_losses(["GEOID-OUTSIDE"])
    ['GEOID-OUTSIDE: Give mission.undulation_m, or a grid that covers the flight.']
    """
    steps = []
    log_codes = [code for code in codes if code.startswith(PREFIX_OF_LOGS)]
    if log_codes:
        names = ", ".join(log_codes)
        steps.append(f"Check which data was lost ({names}). If there is a complete file, use it.")
    other_codes = [code for code in codes if code not in log_codes]
    meaning_of_code = meanings()["codes"]
    with_remedy = [code for code in other_codes if code in meaning_of_code][:MOST_REMEDIES]
    for code in with_remedy:
        steps.append(f"{code}: {meaning_of_code[code].remedy}")
    without_remedy = [code for code in other_codes if code not in with_remedy]
    if without_remedy:
        steps.append(f"See the ledger about {', '.join(without_remedy)}.")
    return steps


def _published_method(manifest: Manifest) -> Iterator[Concern]:
    """The concern about a published method, which is only for comparisons."""
    method = manifest.sections.refraction.method
    if method != "spherical":
        yield Concern(
            f"the method {method} (published, for comparison)",
            "Run again without refraction.method: the published methods are only for comparison.",
        )
