"""Drivers: each protocol a room of its own; no room knows another."""
