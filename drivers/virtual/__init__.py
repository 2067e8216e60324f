"""The stand-in rig: plant physics, Modbus server and CAN node, each in its own process."""
