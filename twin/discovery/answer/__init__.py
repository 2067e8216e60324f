"""The finding as a verdict, in plain words."""
