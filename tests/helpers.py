"""What the tests of several rooms need: channels of a log, refusals, messages by their code."""

import contextlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from unbend.errors import UnbendError
from unbend.flight.channels import Channel, Source

NS_PER_S = 10**9
NED_FROM_ENU = np.array(
    [
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
    ]
)


def one_line(text):
    """A text with single blanks between its words, however it was wrapped."""
    return " ".join(text.split())


def ns(text):
    """A time in ISO 8601, UTC, as Unix nanoseconds."""
    return int(np.datetime64(text, "ns").astype(np.int64))


def channel(
    name,
    seconds,
    *roles,
    **columns,
):
    """A channel sampled at these seconds, of a message with its name; scalars hold throughout.

    >>> channel("BARO[0]", np.arange(3.0), "pressure", pressure_pa=9e4)["pressure_pa"]
    array([90000., 90000., 90000.])
    """
    seconds = np.asarray(seconds, float)
    time_ns = np.round(seconds * NS_PER_S).astype(np.int64)
    arrays = {}
    for key, values in columns.items():
        arrays[key] = np.empty(seconds.shape)
        arrays[key][:] = values
    source = Source(name.partition("[")[0])
    return Channel(name, time_ns, arrays, source, roles=roles)


@contextlib.contextmanager
def refused(code, kind=UnbendError, *, what="", where="", remedy="", says=""):
    """A block of a test that must end with the refusal of this code, which says what to do.

    Where a kind is given, the refusal is of just this class. The words that it must have are given
    by its part, or as what it ``says`` anywhere.
    """
    with pytest.raises(UnbendError) as caught:
        yield caught
    error = caught.value
    if kind is not UnbendError:
        kind_of_error = type(error)
        assert kind_of_error is kind, f"{code} is a {kind_of_error.__name__}"
    assert error.code == code, str(error)
    assert error.remedy, f"{code} does not say what to do"
    assert what in error.what
    assert where in error.where
    assert remedy in error.remedy
    assert says in str(error)


def with_code(messages, code):
    """The messages of a ledger that have this code."""
    return [message for message in messages if message.code == code]


def codes_of_losses(messages):
    """The codes of the losses in a ledger, in their order."""
    losses = []
    for message in messages:
        if message.kind == "loss":
            losses.append(message.code)
    return losses


def codes_of(manifest: Mapping[str, Any]):
    """The codes in the ledger of a manifest that was read as JSON."""
    return {entry["code"] for entry in manifest["ledger"]}


def entry_of(manifest: Mapping[str, Any], code):
    """The only entry with this code in the ledger of a manifest that was read as JSON."""
    entries = []
    for entry in manifest["ledger"]:
        if entry["code"] == code:
            entries.append(entry)
    codes = sorted(codes_of(manifest))
    assert len(entries) == 1, f"{code} is {len(entries)} times in {codes}"
    return entries[0]
