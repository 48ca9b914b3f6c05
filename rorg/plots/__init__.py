"""Pictures of a robot: what it used, what happened, and who needs whom. The page (rorg/web) shows the same, live."""
