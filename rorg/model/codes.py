"""Codes of waitings that commands look at."""

IMAGE, NO_IMAGE = "image", "no-image"
"""An image is being built or pulled; or it cannot be had."""
BLOCKED = "blocked"
"""A network or volume is not there, or not rorg's, and a person has to see to it."""
BAKING = "baking"
"""A new container is ready, and the one before it is kept until it has stayed well for its time."""
