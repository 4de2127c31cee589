"""A family of mounts as small as one can be: what docs/how-to/add-a-mount-family.md makes."""
