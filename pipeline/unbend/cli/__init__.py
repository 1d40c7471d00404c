"""The command line: each command is one call of a stage; errors become exit codes."""

from unbend.cli.app import app
from unbend.cli.entry import main

__all__ = ["app", "main"]
