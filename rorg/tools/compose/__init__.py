"""Reads Compose files into a Project, and writes a robot as a Compose file."""

from rorg.tools.compose.load import load
from rorg.tools.compose.project import Loaded, Project, Variable

__all__ = ["Loaded", "Project", "Variable", "load"]
