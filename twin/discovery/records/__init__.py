"""Records as a diagnosis sees them: blocks, noise, and the readings that may be used."""
