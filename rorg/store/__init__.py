"""What survives the process: the requests file, the lock, the journal, the published status."""
