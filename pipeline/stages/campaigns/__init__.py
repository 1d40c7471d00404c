"""The missions of a command together: which of them run, and the page of a campaign."""
