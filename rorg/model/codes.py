"""Codes of waitings that commands look at."""

IMAGE, NO_IMAGE = "image", "no-image"
"""An image is being built or pulled; or it cannot be had."""
BAKING = "baking"
"""A new container is ready, and the one before it is kept until it has stayed well for its time."""
