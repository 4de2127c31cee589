"""What alembic runs to migrate; connection and lock are given by `mountnav.journal.upgrading`."""

from __future__ import annotations

from alembic import context

context.configure(connection=context.config.attributes["connection"], transactional_ddl=True)
with context.begin_transaction():
    context.run_migrations()
