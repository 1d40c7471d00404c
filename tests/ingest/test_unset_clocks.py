"""Dates of clocks that no receiver has set."""

from unbend.ingest.utc_evidence import ROLLOVER_NS, Witness, missed_rollovers

JUNE_2025_NS = 1_750_000_000 * 10**9


def test_only_a_receiver_counts_weeks_modulo_1024():
    """A computer that begins in 2004 is not 19.6 years late; another clock may confirm that."""
    early_ns = JUNE_2025_NS - ROLLOVER_NS
    assert missed_rollovers(early_ns, []) == 1
    assert missed_rollovers(early_ns, [], of_receiver=False) is None
    confirmed = [Witness("log_time", JUNE_2025_NS)]
    assert missed_rollovers(early_ns, confirmed, of_receiver=False) == 1
