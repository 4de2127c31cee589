"""The operator's settings file, a section each, and what is said when it is wrong."""
