"""The machine: cgroup files, git, file watching, image building, probes."""
