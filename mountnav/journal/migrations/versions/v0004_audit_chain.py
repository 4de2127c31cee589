"""Version 4: the audit is a chain of hashes, so that it can't be rewritten unnoticed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from mountnav.journal.audit_chain import chain_old_rows
from mountnav.journal.database import UtcTime, Words

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the chain's columns, its head and its gaps; chain what is there already."""
    op.add_column("audit", sa.Column("chain_no", sa.BigInteger))
    op.add_column("audit", sa.Column("sha256", sa.String(64)))
    op.add_column("audit", sa.Column("seal", sa.String(64)))
    op.create_table(
        "audit_head",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("chain_no", sa.BigInteger, nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("seal", sa.String(64)),
    )
    op.create_table(
        "audit_gap",
        sa.Column("first_no", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("last_no", sa.BigInteger, nullable=False),
        sa.Column("last_sha256", sa.String(64), nullable=False),
        sa.Column("why", Words, nullable=False),
        sa.Column("removed_utc", UtcTime, nullable=False),
        sa.Column("run_id", sa.String(64), nullable=False),
        sa.Column("seal", sa.String(64)),
    )
    chain_old_rows(op.get_bind())
    op.create_index("audit_by_chain", "audit", ["chain_no"], unique=True)
