"""Modbus protocol without I/O: PDUs, frames, matching of replies."""
