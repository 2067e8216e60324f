"""Commands about runs: `hil run`, `resume`, `ctl`, `report`, `review`."""

__all__: list[str] = []
