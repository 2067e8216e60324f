"""Time axis of a record in seconds."""
