"""The command line: one thin file a command. Heavy modules are imported inside of the commands."""
