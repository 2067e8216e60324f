"""Commands of operators beside a run: `hil alarms`, `serve`."""

__all__: list[str] = []
