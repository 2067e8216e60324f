"""Rig file: its model, its checks, and messages with the line of each mistake."""
