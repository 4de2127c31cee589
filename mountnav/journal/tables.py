"""The journal's tables as they are now; how older ones become so stands in `migrations`.

Every quantity carries its unit in its name; every instant is UTC with microseconds. A reading of the mount
takes ten columns (`before_...`, `after_...`): its place in the mount's own kind of coordinates, raw, and what
it told of itself.
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Boolean, Column, Index, Integer, MetaData, String, Table

from mountnav.journal.database import Facts, Number, UtcTime, Words

HEAD = "0004"
"""The newest version, as `migrations` names it."""

metadata = MetaData()


def _place(prefix: str) -> list[Column[object]]:
    """A place in the sky: `frame` is ``apparent`` (true equator and equinox of `place_utc`) or ``icrs``."""
    return [
        Column(f"{prefix}_ra_deg", Number),
        Column(f"{prefix}_dec_deg", Number),
        Column(f"{prefix}_frame", String(16)),
        Column(f"{prefix}_place_utc", UtcTime),
    ]


def _reading(prefix: str) -> list[Column[object]]:
    return [
        *_place(prefix),
        Column(f"{prefix}_utc", UtcTime),
        Column(f"{prefix}_slewing", Boolean),
        Column(f"{prefix}_tracking", Boolean),
        Column(f"{prefix}_parked", Boolean),
        Column(f"{prefix}_at_home", Boolean),
        Column(f"{prefix}_pier_side", String(16)),
    ]


def _cause() -> list[Column[object]]:
    return [
        Column("run_id", String(64), nullable=False),
        Column("cause_job_id", Words),
        Column("cause_night_id", Words),
        Column("cause_look_id", Words),
        Column("why", Words, nullable=False),
    ]


run = Table(
    "run",
    metadata,
    Column("run_id", String(64), primary_key=True),
    Column("started_utc", UtcTime, nullable=False),
    Column("ended_utc", UtcTime),
    Column("version", Words, nullable=False),
    Column("host", Words, nullable=False),
    Column("pid", Integer, nullable=False),
    Column("settings_sha256", String(64), nullable=False),
    Column("settings", Words, nullable=False),
)

look = Table(
    "look",
    metadata,
    Column("row_id", Integer, primary_key=True, autoincrement=True),
    Column("look_id", Words, nullable=False, unique=True),
    Column("telescope", Words, nullable=False),
    Column("utc", UtcTime, nullable=False),
    Column("solved", Boolean, nullable=False),
    Column("reason", Words, nullable=False),
    Column("detail", Words, nullable=False),
    Column("seen_ra_deg", Number),
    Column("seen_dec_deg", Number),
    Column("covariance_east_arcsec2", Number),
    Column("covariance_cross_arcsec2", Number),
    Column("covariance_north_arcsec2", Number),
    *_reading("before"),
    *_reading("after"),
    Column("segment_id", Words, nullable=False),
    Column("model_id", Words),
    Column("pressure_hpa", Number),
    Column("temperature_c", Number),
    Column("relative_humidity", Number),
    Column("wavelength_um", Number),
    Column("dut1_s", Number),
    Column("camera", Words, nullable=False),
    Column("source", Words, nullable=False),
    Column("exposure_s", Number),
    Column("mode", Words, nullable=False),
    Column("catalog", Words, nullable=False),
    Column("pairs", Integer, nullable=False),
    Column("rms_arcsec", Number),
    Column("false_probability", Number),
    Column("scale_arcsec_px", Number),
    Column("rotation_deg", Number),
    Column("parity", Integer),
    Column("fwhm_px", Number),
    Column("limiting_mag", Number),
    Column("sky_adu", Number),
    Column("measured", Integer, nullable=False),
    Column("used", Words, nullable=False),
    *_cause(),
    Index("look_by_time", "telescope", "utc"),
    Index("look_of_all_by_time", "utc"),
)

command = Table(
    "command",
    metadata,
    Column("row_id", Integer, primary_key=True, autoincrement=True),
    Column("command_id", Words, nullable=False, unique=True),
    Column("telescope", Words, nullable=False),
    Column("utc", UtcTime, nullable=False),
    Column("order", String(32), nullable=False),
    *_place("to"),
    Column("facts", Facts, nullable=False),
    *_reading("before"),
    Column("segment_id", Words, nullable=False),
    *_cause(),
    Column("ended_utc", UtcTime),
    Column("outcome", String(32)),
    Column("end_detail", Words),
    *_reading("after"),
    Column("miss_arcsec", Number),
    Column("end_facts", Facts),
    Index("command_by_time", "telescope", "utc"),
    Index("command_of_all_by_time", "utc"),
    Index("command_by_job", "cause_job_id"),
    Index("command_open", "telescope", "outcome"),
)

entry = Table(
    "entry",
    metadata,
    Column("row_id", Integer, primary_key=True, autoincrement=True),
    Column("telescope", Words, nullable=False),
    Column("utc", UtcTime, nullable=False),
    Column("kind", String(32), nullable=False),
    Column("what", Words, nullable=False),
    Column("facts", Facts, nullable=False),
    *_cause(),
    Index("entry_by_time", "telescope", "kind", "utc"),
    Index("entry_of_all_by_time", "utc"),
)

job = Table(
    "job",
    metadata,
    Column("job_id", Words, primary_key=True),
    Column("run_id", String(64), nullable=False),
    Column("telescope", Words, nullable=False),
    Column("kind", Words, nullable=False),
    Column("request", Facts, nullable=False),
    Column("state", String(16), nullable=False),
    Column("phase", Words, nullable=False),
    Column("attempts", Facts, nullable=False),
    Column("result", Facts),
    Column("problem", Facts),
    Column("created_utc", UtcTime, nullable=False),
    Column("started_utc", UtcTime),
    Column("finished_utc", UtcTime),
    Column("idempotency_key", Words),
    Column("request_sha256", String(64), nullable=False),
    Index("job_by_time", "created_utc"),
    Index("job_by_key", "idempotency_key"),
)

audit = Table(
    "audit",
    metadata,
    Column("row_id", Integer, primary_key=True, autoincrement=True),
    Column("run_id", String(64), nullable=False),
    Column("utc", UtcTime, nullable=False),
    Column("telescope", Words, nullable=False),
    Column("caller", Words, nullable=False),
    Column("role", String(16), nullable=False),
    Column("face", String(16), nullable=False),
    Column("address", Words, nullable=False),
    Column("what", Words, nullable=False),
    Column("request", Facts, nullable=False),
    Column("outcome", Words, nullable=False),
    Column("detail", Words, nullable=False),
    Column("status", Integer),
    Column("job_id", Words),
    Column("chain_no", BigInteger),
    Column("sha256", String(64)),
    Column("seal", String(64)),
    Index("audit_by_time", "utc"),
    Index("audit_by_telescope", "telescope", "row_id"),
    Index("audit_by_caller", "caller", "row_id"),
    Index("audit_by_chain", "chain_no", unique=True),
)

audit_head = Table(
    "audit_head",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("chain_no", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("seal", String(64)),
)

audit_gap = Table(
    "audit_gap",
    metadata,
    Column("first_no", BigInteger, primary_key=True, autoincrement=False),
    Column("last_no", BigInteger, nullable=False),
    Column("last_sha256", String(64), nullable=False),
    Column("why", Words, nullable=False),
    Column("removed_utc", UtcTime, nullable=False),
    Column("run_id", String(64), nullable=False),
    Column("seal", String(64)),
)

lease = Table(
    "lease",
    metadata,
    Column("telescope", Words, primary_key=True),
    Column("run_id", String(64), nullable=False),
    Column("holder", Words, nullable=False),
    Column("role", String(16), nullable=False),
    Column("face", String(16), nullable=False),
    Column("address", Words, nullable=False),
    Column("secret_sha256", String(64), nullable=False),
    Column("note", Words, nullable=False),
    Column("ttl_s", Number, nullable=False),
    Column("on_expiry", String(16), nullable=False),
    Column("taken_utc", UtcTime, nullable=False),
    Column("deadline_utc", UtcTime, nullable=False),
)
