"""Measurements and catalog stars in; identified pairs, a plate model and its odds out. Knows no files."""
