"""Importing a catalog: its files are read part by part, kept, sorted, checked, and installed at once."""
