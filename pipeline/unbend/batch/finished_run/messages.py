"""Refusals and notes of exports of a finished run."""

from collections.abc import Sequence

from unbend.errors import Code, ConfigError, MissionError
from unbend.messages import Message, fallback, note, warning

EXPORT_CONFIG = Code(
    "EXPORT-CONFIG",
    means="The manifest's mission file has entries that this version does not understand.",
    effect="The export is refused.",
    remedy="Run the mission again with this version.",
)
EXPORT_DIRECTION = Code(
    "EXPORT-DIRECTION",
    means="The run displaced ideal observations (direction: apply): it has no corrections.",
    effect="The export is refused.",
    remedy="Export from a run that removes refraction.",
)
EXPORT_EXISTS = Code(
    "EXPORT-EXISTS",
    means="The file or folder exists already.",
    effect="The export is refused.",
    remedy="Choose another name, replace a file with --force, or delete the folder.",
)
EXPORT_GROUND = Code(
    "EXPORT-GROUND",
    means=(
        "Images without observations have no ground height, so the median of the other images is "
        "used. Or --ground-height is not a valid ground height."
    ),
    effect="For images, an allowed substitute. For the option, a refusal.",
    remedy="Give --ground-height in metres above sea level.",
)
EXPORT_INSIDE_RUN = Code(
    "EXPORT-INSIDE-RUN",
    means="The export would be written into the folder of the results of the run.",
    effect="The export is refused.",
    remedy="Write it to another folder, for example next to that of the run.",
)
EXPORT_NOT_REPRODUCED = Code(
    "EXPORT-NOT-REPRODUCED",
    means="The corrections of the run differ when they are computed again.",
    effect="The export is refused.",
    remedy="Run the mission again with this version, then export.",
)
EXPORT_STALE = Code(
    "EXPORT-STALE",
    means=(
        "The mission file, or one of its inputs, has changed since the run. An export or report is "
        "of the run, so of the values before."
    ),
    effect="The export or report is written as it was asked for.",
    remedy="Run the mission again, then export.",
)
EXPORT_USE = Code(
    "EXPORT-USE",
    means="How to use the export, and which correction to switch off in the program that reads it.",
    effect="None.",
    remedy="Follow it, so that refraction is not removed twice.",
)


def config_not_understood(*, path: str, mistakes: int, first: str) -> MissionError:
    """The mission in a manifest is of another version; the ``first`` key that is not understood."""
    return MissionError(
        EXPORT_CONFIG,
        "the mission file in the manifest has {count} keys that this version does not understand, "
        "the first is {first}",
        one="the mission file in the manifest has a key that this version does not understand: "
        "{first}",
        where=path,
        count=mistakes,
        first=first,
        remedy="run the mission again with this version",
    )


def no_corrections(*, path: str) -> ConfigError:
    """The run applied refraction."""
    return ConfigError(
        EXPORT_DIRECTION,
        "the run displaced ideal observations; there is no correction to export",
        where=f"{path}, refraction.direction",
        remedy="export from a run that removes refraction",
    )


def file_exists(*, path: str) -> ConfigError:
    """The file that an export would write is there."""
    return ConfigError(
        EXPORT_EXISTS,
        "the file exists already",
        where=path,
        remedy="choose another name, or replace it: --force",
    )


def folder_exists(*, path: str) -> ConfigError:
    """A folder has the name of the export."""
    return ConfigError(
        EXPORT_EXISTS,
        "there is a folder of that name",
        where=path,
        remedy="choose another name, or delete it: --force replaces files only",
    )


def ground_of_others(*, count: int, median: float) -> Message:
    """Images without observations get the median ground height of the others."""
    return fallback(
        EXPORT_GROUND,
        (
            "{count} images have no observations with a ground height: {median:.1f} m is used, the "
            "median of the other images"
        ),
        one=(
            "1 image has no observations with a ground height: {median:.1f} m is used, the median "
            "of the other images"
        ),
        where="observations",
        count=count,
        median=median,
    )


def no_ground_height(*, height: float, lowest: float, highest: float) -> ConfigError:
    """--ground-height is below or above all ground."""
    return ConfigError(
        EXPORT_GROUND,
        "{height:g} m is not a valid ground height ({lowest:g} to {highest:g} m)",
        where="--ground-height",
        remedy="give it in metres above sea level",
        height=height,
        lowest=lowest,
        highest=highest,
    )


def inside_run(*, path: str) -> ConfigError:
    """The export would lie among the results."""
    return ConfigError(
        EXPORT_INSIDE_RUN,
        "the file would be in the folder of the results of the run",
        where=path,
        remedy="write it to another folder, for example next to that folder",
    )


def not_reproduced(*, path: str, largest_px: float) -> MissionError:
    """The corrections computed now are not those of the run."""
    return MissionError(
        EXPORT_NOT_REPRODUCED,
        (
            "the corrections, computed again, differ from those of the run by up to "
            "{largest_px:.2g} px"
        ),
        where=path,
        remedy="the run was made by another version: run the mission again, then export",
        largest_px=largest_px,
    )


def changed_since_run(*, file: str, changes: Sequence[str]) -> Message:
    """Mission file or inputs have changed since the run; ``changes`` are texts on each."""
    return warning(
        EXPORT_STALE,
        "this is from the run before these changes: {listed_changes}; `unbend run {where}` uses "
        "them",
        where=file,
        listed_changes="; ".join(changes),
    )


def use_of_export(*, use: str, name: str) -> Message:
    """How the program that reads a format is to be used."""
    return note(EXPORT_USE, "{use}", where=f"--format {name}", use=use)


REPORT_BROWSER = Code(
    "REPORT-BROWSER",
    means=(
        "A PDF of the report is printed by Chromium, Chrome or Edge. No such browser is installed, "
        "or it did not print a complete PDF in time."
    ),
    effect="No PDF is written.",
    remedy="Install chromium, or open report.html in any browser and print it there.",
)


def no_browser(*, names: str) -> ConfigError:
    """There is no browser that prints."""
    return ConfigError(
        REPORT_BROWSER,
        "a PDF is printed by a browser, and none of {names} is installed",
        where="--pdf",
        remedy=(
            "install chromium (Debian: apt-get install chromium), or name a browser: --browser "
            "PATH; or open report.html in any browser and print it as PDF"
        ),
        names=names,
    )


def browser_not_there(*, name: str) -> ConfigError:
    """The browser that was named is not there."""
    return ConfigError(
        REPORT_BROWSER,
        "there is no program {name!r}",
        where="--browser",
        remedy="give the path of Chromium, Chrome or Edge, or leave it out",
        name=name,
    )


def print_failed(*, browser: str, said: str) -> ConfigError:
    """The browser ended without a whole PDF."""
    return ConfigError(
        REPORT_BROWSER,
        "{browser} did not write a complete PDF: {said}",
        where="--pdf",
        remedy="try another browser: --browser PATH; or open report.html and print it there",
        browser=browser,
        said=said,
    )


def print_too_long(*, browser: str, seconds: float) -> ConfigError:
    """The browser did not end in time, and was ended."""
    return ConfigError(
        REPORT_BROWSER,
        "{browser} did not end within {seconds:g} s, and was stopped",
        where="--timeout",
        remedy="give it more time: --timeout 600; or open report.html and print it there",
        browser=browser,
        seconds=seconds,
    )


REPORT_ENDING = Code(
    "REPORT-ENDING",
    means="The name of the file does not have the ending of the output: .html or .pdf.",
    effect="Nothing is written.",
    remedy="Rename it, or give --pdf.",
)


def report_ending(*, path: str, ending: str) -> ConfigError:
    """The file has another ending than what is written to it."""
    return ConfigError(
        REPORT_ENDING,
        "the report is written to a file that ends in {ending}",
        where=path,
        remedy="rename it; with --pdf a PDF is written, without --pdf an HTML page",
        ending=ending,
    )


REPORT_DATE = Code(
    "REPORT-DATE",
    means="The report was written by an older version. It has no field for the date.",
    effect="The date of processing is not stated.",
    remedy="If the date is needed, run the mission again with this version.",
)


def report_without_date(*, path: str) -> Message:
    """A page without a place for the date of processing."""
    return fallback(
        REPORT_DATE,
        "the report was written by an older version: it does not state the date of processing",
        where=path,
    )
