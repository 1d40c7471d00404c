"""Extreme airs, as fixtures of their places."""

import pytest

from tests.atmosphere.adjusting import ARCTIC, DESERT, MONSOON, NIGHT, TRADES, extreme


@pytest.fixture
def arctic():
    return extreme(ARCTIC)


@pytest.fixture
def desert():
    return extreme(DESERT)


@pytest.fixture
def monsoon():
    return extreme(MONSOON)


@pytest.fixture
def trades():
    return extreme(TRADES)


@pytest.fixture
def night():
    return extreme(NIGHT)
