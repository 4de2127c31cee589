"""Settings of services in tests: what all of them begin with."""

SERVICE_AND_SITE = """
[service]
port = 0
[solving]
worker = false
blind = "never"
[site]
latitude_deg = 47.0
longitude_deg = 11.0
"""
"""A free port, no process for solving, and a site in the Alps; telescopes follow."""
