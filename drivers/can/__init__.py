"""CAN receiver and DBC files."""
