"""Exit codes of the command line, and which of 0 and 3 a run ends with."""

EXIT_DONE = 0
EXIT_BUG = 1
EXIT_CONFIG = 2
EXIT_LOSSES = 3
EXIT_IN_USE = 4
EXIT_STORAGE = 5
EXIT_REFUSED = 6
EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143


def exit_code_of(*, has_losses: bool) -> int:
    """The exit code of a run that came to its end: 3 with losses, 0 without.

    ``has_losses`` : `Ledger.has_losses`; findings that are not accepted count as losses.
    """
    return EXIT_LOSSES if has_losses else EXIT_DONE
