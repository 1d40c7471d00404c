"""The seed of what tests draw.

A new one each day, so that in time all is tried that one seed would leave out; UNBEND_SEED states
another. The first line of a run prints it, and so does the report of a failure.
"""

import datetime
import os

# Kept in the environment: processes that run tests side by side draw the same, past midnight too.
SEED = int(os.environ.setdefault("UNBEND_SEED", f"{datetime.date.today():%Y%m%d}"))
