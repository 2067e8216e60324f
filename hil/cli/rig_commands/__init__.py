"""Commands about rigs and their files: `hil check`, `init`, `profile`, `rig`, `start`."""

__all__: list[str] = []
