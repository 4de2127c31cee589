"""Stars round a place at an epoch: the packed store, the embedded catalog, and the recipe to pack others."""
