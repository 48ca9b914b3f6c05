"""The machine that rorg runs on: cgroups, devices, git, files, sockets, processes."""
