"""Bench of unmodelled effects found while a record goes on."""
__all__: list[str] = []
