"""Fake mounts: what all of them share, and the bench that puts them on real lines."""
