"""Drivers: rig files, signals, Modbus and CAN buses, and the virtual rig."""
