"""rorg: declared, requested, time-shared services for robots."""

__version__ = "0.1.0"
