"""The commands of `mountnav`."""
