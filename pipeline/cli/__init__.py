"""The command line: each command is one call of a stage; errors become exit codes."""

from pipeline.cli.app import app
from pipeline.cli.entry import main

__all__ = ["app", "main"]
