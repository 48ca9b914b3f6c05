"""Compose files as values: files -> Project."""

from rorg.compose.load import load
from rorg.compose.project import Loaded, Project, Variable

__all__ = ["Loaded", "Project", "Variable", "load"]
