"""Many services on one page, read only; STOP ALL goes to each of them with its own key."""
