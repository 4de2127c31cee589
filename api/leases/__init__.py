"""Leases: a telescope is controlled by a holder with a heartbeat until it is given back or falls silent."""
