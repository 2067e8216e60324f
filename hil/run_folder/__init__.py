"""Folder of a run: its files, its manifest, and commands that start from it."""
