"""Many frames solved one after the other or side by side, and what is written of each."""
