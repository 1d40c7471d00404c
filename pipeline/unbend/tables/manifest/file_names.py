"""Names of the files that a run writes into the folder of its results."""

MANIFEST = "manifest.json"
"""Written last: if it exists, all files that it lists exist."""

REPORT = "report.html"
