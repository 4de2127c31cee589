"""A series of frames of one field: one is solved, the rest are followed by their shift."""
