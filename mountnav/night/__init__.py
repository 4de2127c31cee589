"""A night without a human: frames come in, drift is measured, and by rules the mount is corrected."""
