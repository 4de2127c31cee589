"""Version 1: runs, looks, commands with their ends, entries.

Written out, not taken from `tables`: what a version was doesn't change when the tables do.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from mountnav.journal.database import Facts, Number, UtcTime, Words

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def _place(prefix: str) -> list[sa.Column[object]]:
    return [
        sa.Column(f"{prefix}_ra_deg", Number),
        sa.Column(f"{prefix}_dec_deg", Number),
        sa.Column(f"{prefix}_frame", sa.String(16)),
        sa.Column(f"{prefix}_place_utc", UtcTime),
    ]


def _reading(prefix: str) -> list[sa.Column[object]]:
    return [
        *_place(prefix),
        sa.Column(f"{prefix}_utc", UtcTime),
        sa.Column(f"{prefix}_slewing", sa.Boolean),
        sa.Column(f"{prefix}_tracking", sa.Boolean),
        sa.Column(f"{prefix}_parked", sa.Boolean),
        sa.Column(f"{prefix}_at_home", sa.Boolean),
        sa.Column(f"{prefix}_pier_side", sa.String(16)),
    ]


def _cause() -> list[sa.Column[object]]:
    return [
        sa.Column("run_id", sa.String(64), nullable=False),
        sa.Column("cause_job_id", Words),
        sa.Column("cause_night_id", Words),
        sa.Column("cause_look_id", Words),
        sa.Column("why", Words, nullable=False),
    ]


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "run",
        sa.Column("run_id", sa.String(64), primary_key=True),
        sa.Column("started_utc", UtcTime, nullable=False),
        sa.Column("ended_utc", UtcTime),
        sa.Column("version", Words, nullable=False),
        sa.Column("host", Words, nullable=False),
        sa.Column("pid", sa.Integer, nullable=False),
        sa.Column("settings_sha256", sa.String(64), nullable=False),
        sa.Column("settings", Words, nullable=False),
    )
    op.create_table(
        "look",
        sa.Column("row_id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("look_id", Words, nullable=False, unique=True),
        sa.Column("telescope", Words, nullable=False),
        sa.Column("utc", UtcTime, nullable=False),
        sa.Column("solved", sa.Boolean, nullable=False),
        sa.Column("reason", Words, nullable=False),
        sa.Column("detail", Words, nullable=False),
        sa.Column("seen_ra_deg", Number),
        sa.Column("seen_dec_deg", Number),
        sa.Column("covariance_east_arcsec2", Number),
        sa.Column("covariance_cross_arcsec2", Number),
        sa.Column("covariance_north_arcsec2", Number),
        *_reading("before"),
        *_reading("after"),
        sa.Column("segment_id", Words, nullable=False),
        sa.Column("model_id", Words),
        sa.Column("pressure_hpa", Number),
        sa.Column("temperature_c", Number),
        sa.Column("relative_humidity", Number),
        sa.Column("wavelength_um", Number),
        sa.Column("dut1_s", Number),
        sa.Column("camera", Words, nullable=False),
        sa.Column("source", Words, nullable=False),
        sa.Column("exposure_s", Number),
        sa.Column("mode", Words, nullable=False),
        sa.Column("catalog", Words, nullable=False),
        sa.Column("pairs", sa.Integer, nullable=False),
        sa.Column("rms_arcsec", Number),
        sa.Column("false_probability", Number),
        sa.Column("scale_arcsec_px", Number),
        sa.Column("rotation_deg", Number),
        sa.Column("parity", sa.Integer),
        sa.Column("fwhm_px", Number),
        sa.Column("limiting_mag", Number),
        sa.Column("sky_adu", Number),
        sa.Column("measured", sa.Integer, nullable=False),
        sa.Column("used", Words, nullable=False),
        *_cause(),
    )
    op.create_table(
        "command",
        sa.Column("row_id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("command_id", Words, nullable=False, unique=True),
        sa.Column("telescope", Words, nullable=False),
        sa.Column("utc", UtcTime, nullable=False),
        sa.Column("order", sa.String(32), nullable=False),
        *_place("to"),
        sa.Column("facts", Facts, nullable=False),
        *_reading("before"),
        sa.Column("segment_id", Words, nullable=False),
        *_cause(),
        sa.Column("ended_utc", UtcTime),
        sa.Column("outcome", sa.String(32)),
        sa.Column("end_detail", Words),
        *_reading("after"),
        sa.Column("miss_arcsec", Number),
        sa.Column("end_facts", Facts),
    )
    op.create_table(
        "entry",
        sa.Column("row_id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("telescope", Words, nullable=False),
        sa.Column("utc", UtcTime, nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("what", Words, nullable=False),
        sa.Column("facts", Facts, nullable=False),
        *_cause(),
    )
    for table in ("look", "command"):
        op.create_index(f"{table}_by_time", table, ["telescope", "utc"])
        op.create_index(f"{table}_of_all_by_time", table, ["utc"])
    op.create_index("entry_by_time", "entry", ["telescope", "kind", "utc"])
    op.create_index("entry_of_all_by_time", "entry", ["utc"])
