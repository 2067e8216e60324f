"""The stand-in rig: plant physics, Modbus server and CAN node, each in its own process.

The package is 'firmware': it imports neither a Modbus nor a CAN library, and nothing of the twin.
"""
