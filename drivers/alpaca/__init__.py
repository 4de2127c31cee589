"""Telescopes and cameras of an Alpaca server: HTTP outside, a language and a camera inside."""
