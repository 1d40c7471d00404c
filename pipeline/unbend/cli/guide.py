"""Commands that need no mission: init, schema, help and warm."""

import json
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from unbend.caches import compiled_code_folder
from unbend.cli import messages
from unbend.cli.app import GROUPS, Answer, command
from unbend.errors import UnbendError, storage_errors
from unbend.report.words import count, hanging


@command(epilog="Example: unbend schema --out mission.schema.json")
def schema(
    answer: Answer,
    out: Annotated[Path | None, Option(help="the file to write")] = None,
    campaign: Annotated[bool, Option("--campaign", help="the schema of a campaign file")] = False,
) -> None:
    """The JSON schema of a mission file, for editors.

    Every key with its description, unit, default and example. An editor reads it where the first
    line of the mission file is: # yaml-language-server: $schema=mission.schema.json
    """
    with answer.progress("listing the keys"):
        from unbend.config.schema import campaign_schema, mission_schema

        text = json.dumps(campaign_schema() if campaign else mission_schema(), indent=1)
    if out is not None:
        with storage_errors(out):
            out.write_text(text + "\n", encoding="utf-8")
        answer.print_paths([str(out)])
        answer.print_json({"written": [str(out)]})
    elif answer.as_json or not answer.quiet:
        print(text)


@command("help", epilog="Example: unbend help f_px; unbend help EVENTS-AMBIGUOUS; unbend help gcp")
def explain_word(
    answer: Answer,
    words: Annotated[
        list[str],
        Argument(
            help=(
                "a key or a value of one, a code, an exit code, a status, a column of results, or "
                "a technical term such as gcp, boresight or lever arm"
            ),
            metavar="WORD",
        ),
    ],
) -> None:
    """Explain a key, a code, a column or a technical term."""
    word = " ".join(words)
    with answer.progress("looking it up"):
        lines = lines_on(word)
    answer.print_json({"word": word, "lines": lines})
    if answer.is_silent:
        return
    for line in lines:
        print(hanging(line, answer.console.width))


def lines_on(word: str) -> list[str]:
    """Lines that explain a word; for a command they refer to its --help.

    Refuses a word that is unknown.
    """
    from unbend.report.explanations import explain

    of_command = []
    if any(word in names for names in GROUPS.values()):
        of_command = [f"{word} (command)", f"  explained by: unbend {word} --help"]
    try:
        lines = explain(word)
    except UnbendError:
        if not of_command:
            raise
        return of_command
    return [*lines, "", *of_command] if of_command else lines


@command(epilog="Example: unbend init flight.bin observations.csv")
def init(
    answer: Answer,
    log: Annotated[Path, Argument(help="a flight log, or only a block", metavar="LOG")],
    observations: Annotated[
        Path | None,
        Argument(help="a table, or a block of another program", metavar="[OBSERVATIONS]"),
    ] = None,
    images: Annotated[
        Path | None, Option(help="folder of the images, or exiftool's table of them")
    ] = None,
    out: Annotated[Path, Option(help="the file to write; - prints it")] = Path("mission.yaml"),
    *,
    force: Annotated[bool, Option(help="replace the file if it exists")] = False,
) -> None:
    """Write a mission file from the content of a log and observations.

    Open questions are TODO; `unbend check` lists them. mission.schema.json is written next to
    the file. Editors use it to complete and check keys.
    """
    prints_it = str(out) == "-"
    if not prints_it and out.exists() and not force:
        raise messages.file_exists(path=str(out))
    with answer.progress(f"reading {log.name}"):
        import yaml

        from unbend.batch.proposal.mission_text import propose_mission
        from unbend.config.yaml_text import open_questions

        target = Path("mission.yaml") if prints_it else out  # its folder counts: paths are relative
        text = propose_mission(log, observations, images, target)
        questions = open_questions(yaml.safe_load(text))
    content = {"questions": [".".join(map(str, place)) for place in questions]}
    if prints_it:
        if answer.as_json:
            answer.print_json(content | {"text": text})
        elif not answer.quiet:
            print(text, end="")
        return
    schema_file = out.parent / "mission.schema.json"
    with storage_errors(out):
        out.write_text(text, encoding="utf-8")
    # Only one JSON may be printed: that of this answer has both files, so `schema` prints none.
    schema(Answer(quiet=answer.is_silent, as_json=False), schema_file)
    answer.print_json(content | {"written": [str(out), str(schema_file)]})
    summary = f"{out}: {count(len(questions), 'open question')} (TODO)"
    answer.print_paths([summary, f"  unbend check {out}"])


@command(epilog="Example: unbend warm --json")
def warm(answer: Answer) -> None:
    """Compile the code that runs need, once: ten seconds or longer.

    For container images and for many machines. The code is stored in the folder
    NUMBA_CACHE_DIR, or in the user's cache. It is valid for this version of the program and
    this kind of processor.
    """
    with answer.progress("compiling"):
        from unbend.library import correct_one_image
        from unbend.refraction.kernels.jit import cache_folder

        folder = cache_folder()
        if folder is None:
            raise messages.no_place_for_compiled_code(path=compiled_code_folder())
        correct_one_image()
    answer.print_json({"compiled": folder})
    answer.print_paths([folder])
