"""Measurement: machine, processes, tables and manifests."""
