"""The other end of an LX200 cable, dialect by dialect."""
