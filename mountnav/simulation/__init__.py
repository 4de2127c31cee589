"""What replaces hardware: the mechanics of a telescope that points wrong, and the sky drawn as it is."""
