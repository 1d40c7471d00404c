"""The report of a run: one page of HTML, its figures drawn by templates."""
