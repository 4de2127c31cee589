"""HTTP: the application, its routes and views, its errors, and the bounds on what clients send."""
