"""How a journal of an older version becomes one of today: alembic's scripts, run when a journal is opened."""
