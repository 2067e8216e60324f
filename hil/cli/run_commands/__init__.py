"""Commands about runs: `hil run`, `test`, `resume`, `ctl`, `note`, `report`, `review`, `ls`, `compare`."""

__all__: list[str] = []
