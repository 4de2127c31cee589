"""One file for each version; what has been released is never changed."""
