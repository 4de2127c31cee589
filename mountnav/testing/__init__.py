"""Checks that any mount or camera must pass, for those who write drivers; published."""
