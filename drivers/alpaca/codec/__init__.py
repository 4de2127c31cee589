"""Alpaca's forms, envelopes and images; no I/O."""
