"""INDI's messages, and what a client keeps of them; no I/O."""
