"""Commands about rigs and their files: `hil check`, `init`, `profile`, `rig`."""

__all__: list[str] = []
