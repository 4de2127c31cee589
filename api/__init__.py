"""The faces of mountnav: HTTP and command line. The only place where everything is put together."""
