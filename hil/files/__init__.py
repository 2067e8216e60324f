"""Files and text from untrusted sources: atomic writing, names, limits, escaping."""
