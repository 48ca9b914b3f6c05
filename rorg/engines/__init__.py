"""What runs services: the Engine protocol, its engines, and what observes and calls them. No decisions here."""
