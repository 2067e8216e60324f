"""One thermometer of several: its error, its lateness, or the heat at its place."""
