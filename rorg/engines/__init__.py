"""What runs services: the Engine protocol, Docker, processes; observing and executing. No decisions here."""

ENGINES = ("docker", "process")
"""Names to choose from."""
WITH_IMAGES = ("docker",)
"""Those for which an image is more than a name."""
