"""A camera that somebody else runs: its files are awaited in a folder."""
