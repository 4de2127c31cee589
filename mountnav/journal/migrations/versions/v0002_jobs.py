"""Version 2: jobs and their idempotency keys; what is in flight is found by an index."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from mountnav.journal.database import Facts, UtcTime, Words

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table of jobs, and two indexes to commands."""
    op.create_table(
        "job",
        sa.Column("job_id", Words, primary_key=True),
        sa.Column("run_id", sa.String(64), nullable=False),
        sa.Column("telescope", Words, nullable=False),
        sa.Column("kind", Words, nullable=False),
        sa.Column("request", Facts, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("phase", Words, nullable=False),
        sa.Column("attempts", Facts, nullable=False),
        sa.Column("result", Facts),
        sa.Column("problem", Facts),
        sa.Column("created_utc", UtcTime, nullable=False),
        sa.Column("started_utc", UtcTime),
        sa.Column("finished_utc", UtcTime),
        sa.Column("idempotency_key", Words),
        sa.Column("request_sha256", sa.String(64), nullable=False),
    )
    op.create_index("job_by_time", "job", ["created_utc"])
    op.create_index("job_by_key", "job", ["idempotency_key"])
    op.create_index("command_by_job", "command", ["cause_job_id"])
    op.create_index("command_open", "command", ["telescope", "outcome"])
