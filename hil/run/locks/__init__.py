"""Locks that let one run drive a rig."""
