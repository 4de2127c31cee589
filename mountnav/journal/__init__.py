"""Every look, solution, sync, move, refusal, fault, model and configuration change, with absolute values."""
