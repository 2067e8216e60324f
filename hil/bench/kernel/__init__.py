"""Cost of the twin's kernel and of its fits, and that of other tools."""
