"""Mutated files, replies and frames against their readers."""
