"""Commands of `hil bench`. The package names nothing: `hil` loads the command group by its module."""

__all__: list[str] = []
