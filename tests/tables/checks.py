"""Numbers within a tolerance, and refusals that say something."""

import contextlib
import re

from numpy.testing import assert_allclose

from tests.helpers import refused


@contextlib.contextmanager
def refused_with(code, pattern):
    """A block of a test that must end with the refusal of this code, in which words are found."""
    with refused(code) as caught:
        yield caught
    assert re.search(pattern, str(caught.value)), str(caught.value)


def assert_within(actual, expected, tolerance):
    """Numbers differ by no more than the tolerance, however large they are."""
    assert_allclose(actual, expected, rtol=0.0, atol=tolerance)
