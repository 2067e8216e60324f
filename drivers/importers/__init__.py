"""Importers of rig files: vendor tables, Telegraf, Home Assistant, DBC files, described points."""
