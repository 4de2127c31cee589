"""Navigation: look, decide, sync, slew, read back, verify."""
