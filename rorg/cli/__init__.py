"""The command line: one thin file for each command, which imports heavy modules only inside."""
