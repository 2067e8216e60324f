"""What an operator runs: command line, engine, journal, record, review and report."""

__version__ = "0.2.0"
