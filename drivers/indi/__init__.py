"""INDI: mounts and cameras behind an `indiserver`, by its XML over TCP."""
