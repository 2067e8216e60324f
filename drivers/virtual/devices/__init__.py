"""Devices of the virtual rig: PLC with Modbus server, CAN node, control port."""
