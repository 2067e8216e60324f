"""Application packages: command line, runs, journal, records, diagnosis, reports and benchmarks."""

__version__ = "0.2.0"
