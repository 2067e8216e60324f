"""Commands of `hil tower`. The package names nothing: `hil tower` loads each command by its module."""

__all__: list[str] = []
