"""What looks teach of a mount, for the service and the commands: pointing models, diagnosis, drift."""
