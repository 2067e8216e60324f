"""Records, Parquet or CSV: read, checked, in seconds and the units of their columns."""
