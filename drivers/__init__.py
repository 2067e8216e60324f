"""How a signal reaches the wire: rig file, points, codec, read planning, Modbus, CAN, virtual rig."""
