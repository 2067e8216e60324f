"""Files and text that may come from anybody: atomic writing, names, limits, escaping."""
