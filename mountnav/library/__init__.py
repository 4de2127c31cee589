"""The library for notebooks and scripts: `import mountnav as mn`. Astropy's types in and out."""
