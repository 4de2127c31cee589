"""The solver's processes: what they are asked, what they may take of the machine, and what they answer."""
