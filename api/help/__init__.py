"""The documentation as it is shipped: the site's files, and which of its pages answers a question."""
