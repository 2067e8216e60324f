"""Verbs of `hil tower`, one module a verb, each with a `command`."""
