"""Commands that must end in one way."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest


@pytest.fixture
def obeyed(unbend) -> Callable[..., str]:
    """Runs a command that must end with an exit code, by default 0; what it prints."""

    def run(*words: object, exit_code: int = 0) -> str:
        ended = unbend(*words)
        assert ended.code == exit_code, ended.text
        return ended.out

    return run


@pytest.fixture
def refusal_of(unbend) -> Callable[..., str]:
    """Runs a command that must be refused with a code; what it says."""

    def run(code: str, exit_code: int, *words: object) -> str:
        ended = unbend(*words)
        assert ended.code == exit_code, ended.text
        assert "Traceback" not in ended.text
        assert re.search(rf"^(.+: )?{code}: \S", ended.err, re.MULTILINE), ended.text
        return ended.err

    return run
