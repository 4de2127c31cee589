"""Telescopes as INDI devices: a server of our own, for KStars, Cartes du Ciel, and `indiserver` to chain."""
