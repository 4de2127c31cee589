"""Tycho-2 as mountnav reads it: two data files beside this one, and nothing else."""
