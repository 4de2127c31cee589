"""Holding a telescope still by what solves show: what is known of drift, and the corrections it is worth."""
