"""Simulates and emulates robots: containers in virtual time with faults on demand, traces, workloads and their
results."""
