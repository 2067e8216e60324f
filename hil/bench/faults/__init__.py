"""Fault campaign: seeded faults of wires, rig and harness."""
