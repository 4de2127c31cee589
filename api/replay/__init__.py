"""A recorded night: the header that the service writes, and the replay that compares decisions."""
