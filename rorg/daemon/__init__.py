"""The loop: one pass, its workers and wakes; and the wiring of all parts."""
