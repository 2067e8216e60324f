"""Guardian: a small process of its own that makes a rig safe when the engine no longer can.

`plan` writes down what is safe as requests in bytes, `client` is the engine's half, `process` and `wires` are the
guardian itself. The last two import nothing but the standard library, so that the guardian starts in milliseconds,
stays small, and depends on nothing that the engine may have broken.
"""
