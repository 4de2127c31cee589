"""LX200's words, dialect by dialect: bytes, readers of replies, and no I/O."""
