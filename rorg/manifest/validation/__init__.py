"""What is wrong with a robot as a whole, though each of its manifests may be right: one file a family of checks."""
