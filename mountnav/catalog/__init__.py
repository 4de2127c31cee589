"""Stars around a position at an epoch: the packed store, the embedded catalog, and readers of others."""
