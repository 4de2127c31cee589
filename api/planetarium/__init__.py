"""Planetariums and telescope apps by their own protocols: LX200 over TCP, Stellarium's; and their orders."""
