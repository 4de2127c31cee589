"""Other plate solvers: `astap`, `solve-field`, `wcsinfo`, `image2xy`, PlateSolve, ASPS, Watney."""
