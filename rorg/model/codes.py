"""Codes of waitings that commands look at."""

IMAGE, NO_IMAGE = "image", "no-image"
"""An image is being built or pulled; or it cannot be had."""
DEVICE = "device"
"""A device of a driver is not there, or cannot be told from others."""
BAKING = "baking"
"""A new container is ready, and the one before it is kept until it has stayed well for its time."""
