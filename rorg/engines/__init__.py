"""What runs services: the Engine protocol, Docker, processes; observing and executing. No decisions here."""
