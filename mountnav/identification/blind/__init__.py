"""Blind search: an index of quads over the whole sky, made once per machine, and the search in it."""
