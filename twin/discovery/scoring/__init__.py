"""One quadratic form for every hypothesis: scores, with the tunables and the structure projected out."""
