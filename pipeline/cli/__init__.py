"""Words to one call each; errors to exit codes."""

from pipeline.cli.app import app
from pipeline.cli.entry import main

__all__ = ["app", "main"]
