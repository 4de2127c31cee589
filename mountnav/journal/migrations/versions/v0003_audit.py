"""Version 3: who ordered what, and who holds which telescope."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from mountnav.journal.database import Facts, Number, UtcTime, Words

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables of audits and of leases."""
    op.create_table(
        "audit",
        sa.Column("row_id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("run_id", sa.String(64), nullable=False),
        sa.Column("utc", UtcTime, nullable=False),
        sa.Column("telescope", Words, nullable=False),
        sa.Column("caller", Words, nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("face", sa.String(16), nullable=False),
        sa.Column("address", Words, nullable=False),
        sa.Column("what", Words, nullable=False),
        sa.Column("request", Facts, nullable=False),
        sa.Column("outcome", Words, nullable=False),
        sa.Column("detail", Words, nullable=False),
        sa.Column("status", sa.Integer),
        sa.Column("job_id", Words),
    )
    op.create_index("audit_by_time", "audit", ["utc"])
    op.create_index("audit_by_telescope", "audit", ["telescope", "row_id"])
    op.create_index("audit_by_caller", "audit", ["caller", "row_id"])
    op.create_table(
        "lease",
        sa.Column("telescope", Words, primary_key=True),
        sa.Column("run_id", sa.String(64), nullable=False),
        sa.Column("holder", Words, nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("face", sa.String(16), nullable=False),
        sa.Column("address", Words, nullable=False),
        sa.Column("secret_sha256", sa.String(64), nullable=False),
        sa.Column("note", Words, nullable=False),
        sa.Column("ttl_s", Number, nullable=False),
        sa.Column("on_expiry", sa.String(16), nullable=False),
        sa.Column("taken_utc", UtcTime, nullable=False),
        sa.Column("deadline_utc", UtcTime, nullable=False),
    )
