"""The sim engine: containers in virtual time, with faults on demand, under the same planner."""
