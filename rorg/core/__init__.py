"""The planner: pure functions over frozen values. No clock, randomness, I/O or engine here, so that the same inputs
always give the same plan and a test can replay any pass."""
