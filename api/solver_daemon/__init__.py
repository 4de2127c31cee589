"""Commands of other plate solvers, answered by a solver that is warm: stub, socket, daemon, installation."""
