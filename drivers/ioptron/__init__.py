"""iOptron mounts of the v3 command set: codec, mount and fake."""
