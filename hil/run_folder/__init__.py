"""Folder of a run: paths of its files, its lock, and the checks of its manifest."""
