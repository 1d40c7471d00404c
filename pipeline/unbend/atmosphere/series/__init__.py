"""The profile in time: estimates in windows of a flight, and the profile of each exposure."""
