"""The bug bundle: one file with all that is needed to understand a night, and nothing that is secret."""
