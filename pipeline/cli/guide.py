"""Commands that lead in: the JSON schema, and what a key or a code means."""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.app import app, new_console
from pipeline.errors import storage_errors


@app.command(epilog="Example: unbend schema --out mission.schema.json")
def schema(
    out: Annotated[Path | None, typer.Option(help="the file to write")] = None,
) -> None:
    """The JSON schema of a mission file, for editors.

    Every key with its description, unit, default and example. An editor reads it where the first
    line of the mission file is: # yaml-language-server: $schema=mission.schema.json
    """
    from pipeline.config.schema import mission_schema

    text = json.dumps(mission_schema(), indent=1)
    if out is None:
        print(text)
        return
    with storage_errors(out):
        out.write_text(text + "\n", encoding="utf-8")
    print(out)


@app.command(
    "help", epilog="Example: unbend help f_px; unbend help EVENTS-AMBIGUOUS; unbend help 3"
)
def explain_word(
    word: Annotated[
        str, typer.Argument(help="a key, a code or an exit code", metavar="KEY|CODE|EXITCODE")
    ],
) -> None:
    """What a key, a code or an exit code means."""
    from pipeline.report.explanations import explain

    width = max(40, new_console().width)
    for line in explain(word):
        indent = " " * (len(line) - len(line.lstrip()))
        print(textwrap.fill(line, width, subsequent_indent=indent + "  " * bool(indent),
                            break_on_hyphens=False, break_long_words=False))  # fmt: skip
