"""A camera without hardware: it draws the sky where the simulated telescope truly looks."""
