"""Guardian: a small process of its own that makes a rig safe when the engine no longer can.

`plan` holds the safe values as requests in bytes, `client` is the engine's half, `process` and `wires` are the guardian
itself. The last two import the standard library alone. The guardian therefore starts in milliseconds, stays small, and
is independent of faults in the engine.
"""
