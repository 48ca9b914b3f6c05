"""The HTTP API of the running rorg, and every operation that it offers."""
