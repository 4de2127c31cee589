"""Proving a mount: graded steps on real hardware, what they found, and how a fake of its kind compares."""
