"""One run on a rig: engine, outputs, locks, restore, session."""
