"""What looks like a mistake in a mission file: rules whose findings it can accept."""
