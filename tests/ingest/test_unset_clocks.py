"""Dates of clocks that no receiver has set."""

import io

import numpy as np

from unbend.ingest.utc_evidence import ROLLOVER_NS, Witness, missed_rollovers
from unbend.report.message_csv import write_messages_csv

JUNE_2025_NS = 1_750_000_000 * 10**9


def test_only_a_receiver_counts_weeks_modulo_1024():
    """A computer that begins in 2004 is not 19.6 years late; another clock may confirm that."""
    early_ns = JUNE_2025_NS - ROLLOVER_NS
    assert missed_rollovers(early_ns, []) == 1
    assert missed_rollovers(early_ns, [], of_receiver=False) is None
    confirmed = [Witness("log_time", JUNE_2025_NS)]
    assert missed_rollovers(early_ns, confirmed, of_receiver=False) == 1


def test_a_listing_has_no_utc_where_time_counts_from_boot():
    stream = io.StringIO()
    write_messages_csv(
        stream,
        {"time_ns": np.array([90 * 10**9]), "TimeUS": np.array([90])},
    )
    assert stream.getvalue() == "time_utc,TimeUS\n,90\n"
