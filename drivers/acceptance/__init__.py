"""Acceptance of a mount: graded steps on real hardware, findings, comparison with a fake of its kind."""
