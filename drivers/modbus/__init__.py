"""Modbus client: link, wires, read planning and writes."""
