"""Which effects are missing from a record when there is no healthy one to compare with."""
