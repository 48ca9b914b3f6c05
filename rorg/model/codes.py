"""Codes of waitings that commands look at."""

IMAGE, NO_IMAGE = "image", "no-image"
"""An image is being built or pulled; or it cannot be had."""
