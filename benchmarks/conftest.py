"""The ratios of a run of the benchmarks, and their table at its end."""

import pytest
from timing import Ratios

RATIOS = Ratios()


@pytest.fixture
def ratios() -> Ratios:
    """Measures and notes ratios."""
    return RATIOS


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter):
    """The table of all ratios."""
    if not RATIOS.rows:
        return
    terminalreporter.section("ratios")
    for what, ratio, bound, remark in RATIOS.rows:
        terminalreporter.write_line(f"{what:<62} {ratio:>8} {bound:>9}  {remark}".rstrip())
