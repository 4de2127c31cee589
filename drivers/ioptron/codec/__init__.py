"""iOptron's words, by command set: bytes, readers of replies, and no I/O."""
