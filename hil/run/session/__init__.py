"""Session of a run from its request to its folder."""
