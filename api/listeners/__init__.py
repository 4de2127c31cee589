"""What listens besides HTTP and what all of it shares: TCP ports, admission, fair reading, descriptors."""
