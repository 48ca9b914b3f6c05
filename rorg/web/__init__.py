"""A page in the browser: a client of the API like any other, with the rights of the user who started it."""
