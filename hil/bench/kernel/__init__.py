"""Cost of the twin's kernel and of its fits, beside other tools."""
