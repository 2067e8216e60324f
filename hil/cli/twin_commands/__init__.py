"""Commands about twins: `hil commission`, `diagnose`, `track`, `train`, `twin`."""

__all__: list[str] = []
