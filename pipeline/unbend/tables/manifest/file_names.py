"""Names of the files that a run writes into the folder of its results."""

MANIFEST = "manifest.json"
"""Written last: it exists only when all that it names does."""

REPORT = "report.html"
