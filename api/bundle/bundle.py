"""A bug bundle made: settings without secrets, journal, audit, wire, recordings, report, versions, system.

It works without a running service, and with a journal or settings that are broken: what can't be had is named
in the manifest, with the reason. Nothing that goes into it leaves without being masked.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import resource
import shutil
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from api.bundle.form import FORM, MANIFEST, recording_name
from mountnav.errors import BadRequest, BadSettings, MountnavError
from mountnav.files import FILE_MODE, require_replaceable
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.wording import as_json
from mountnav.night.morning_report import report_of
from mountnav.night.report_pages import as_markdown
from mountnav.settings.observatory import Settings
from mountnav.settings.secrets import Masker, masked_settings, masked_table, secrets_in, secrets_of
from mountnav.version import version

__all__ = ["Asked", "Bundled", "make_bundle"]

MOST_LINES = 200_000
"""Lines of the journal and of the audit at most, the newest: some 100 MB before they are packed. Doubled, so
is the bundle of a service in a storm."""
MOST_RECORD_BYTES = 200_000_000
"""Longest recording that is put in, bytes: four nights of a busy line. One that was cut could not be played.
Doubled, a bundle gets too large to be sent."""
_PACKED = zipfile.ZIP_DEFLATED
_SECRET_VARIABLES = ("TOKEN", "PASSWORD", "SECRET", "KEY", "PGPASSWORD")
_SHOWN_VARIABLES = (
    "MOUNTNAV_",
    "XDG_",
    "OMP_",
    "OPENBLAS_",
    "LANG",
    "LC_",
    "TZ",
    "JOURNAL_STREAM",
    "NOTIFY_",
)

Service = Callable[[str], str]
"""The text at a path of a running service. Raises if there is none."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a bundle is to be about.

    Attributes
    ----------
    since, until : datetime
        The window of journal and audit.
    config : Path
        The settings.
    journal : str or None
        Instead of that of the settings.
    service : callable or None
        Asks a running service; None leaves it out.
    """

    since: datetime
    until: datetime
    config: Path
    journal: str | None = None
    service: Service | None = None


@dataclass(slots=True)
class Bundled:
    """What came of it.

    Attributes
    ----------
    files : dict of str to int
        Bytes of each, before it was packed.
    missing : dict of str to str
        What could not be had, and why.
    """

    files: dict[str, int] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)


def make_bundle(asked: Asked, target: Path, utc: datetime) -> Bundled:
    """Write a bundle, whole or not at all, readable by its owner alone.

    Raises
    ------
    BadRequest
        The target can't be written.
    """
    part = target.with_name(f".{target.name}.part")
    try:
        require_replaceable(target)
        with open(part, "xb", opener=_private) as file, zipfile.ZipFile(file, "w", _PACKED) as archive:
            found = _Writer(archive, asked, utc).write()
        os.replace(part, target)
    except FileExistsError as there:
        raise BadRequest(f"{part} is there", advice="another one is being made, or remove it") from there
    except OSError as wrong:
        part.unlink(missing_ok=True)
        raise BadRequest(
            f"the bundle can't be written: {wrong.strerror or wrong}", device=str(target), advice="see --out"
        ) from wrong
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return found


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, FILE_MODE)


class _Writer:
    def __init__(self, archive: zipfile.ZipFile, asked: Asked, utc: datetime) -> None:
        self._archive, self._asked, self._utc = archive, asked, utc
        self._found = Bundled()
        self._sha256: dict[str, str] = {}
        self._settings: Settings | None = None
        self._masker = Masker(_of_environment())

    def write(self) -> Bundled:
        """All of it; each part by itself, so that one that fails takes no other with it."""
        parts: Mapping[str, Callable[[], None]] = {
            "settings.json": self._write_settings,
            "journal.jsonl": self._write_journal,
            "audit.jsonl": self._write_audit,
            "runs.json": self._write_runs,
            "report.md": self._write_report,
            "recordings": self._write_recordings,
            "service": self._ask_service,
            "system.json": self._write_system,
        }
        for name, part in parts.items():
            try:
                part()
            except Exception as trouble:  # whatever is broken is what the bundle is about
                self._miss(name, trouble)
        manifest = {
            "form": FORM,
            "mountnav": version(),
            "made_utc": self._utc.isoformat(),
            "since_utc": self._asked.since.isoformat(),
            "until_utc": self._asked.until.isoformat(),
            "telescopes": [] if self._settings is None else [one.id for one in self._settings.telescope],
            "files": [
                {"name": name, "bytes": size, "sha256": self._sha256[name]}
                for name, size in self._found.files.items()
            ],
            "missing": self._found.missing,
            "masked": (
                "tokens, passwords, keys, headers and addresses of webhooks; see `mountnav docs security`"
            ),
        }
        self._put(MANIFEST, json.dumps(self._masker.value(manifest), indent=1))
        return self._found

    def _put(self, name: str, text: str) -> None:
        self._put_lines(name, [text])

    def _put_lines(self, name: str, lines: Iterable[str]) -> None:
        digest, size = hashlib.sha256(), 0
        with self._archive.open(name, "w", force_zip64=True) as file:
            for line in lines:
                data = line.encode("utf-8", "replace") + b"\n"
                file.write(data)
                digest.update(data)
                size += len(data)
        self._found.files[name], self._sha256[name] = size, digest.hexdigest()

    def _miss(self, name: str, trouble: BaseException) -> None:
        words = str(trouble) or type(trouble).__name__
        self._found.missing[name] = self._masker.text(f"{type(trouble).__name__}: {words}")[:1000]

    def _write_settings(self) -> None:
        try:
            self._settings = Settings.load(self._asked.config)
        except BadSettings as wrong:
            # the file may be what is wrong: its tables, as far as they can be read
            try:
                table = tomllib.loads(self._asked.config.read_text("utf-8", "replace"))
            except (OSError, ValueError):
                # its text may quote what nobody can tell from a secret
                self._found.missing["settings.json"] = "the file can't be read as TOML"
                return
            self._masker = Masker([*_of_environment(), *secrets_in(table)])
            self._miss("settings.json", wrong)
            self._put("settings-as-found.json", json.dumps(masked_table(table), indent=1, default=str))
            return
        self._masker = Masker([*_of_environment(), *secrets_of(self._settings)])
        self._put("settings.json", json.dumps(masked_settings(self._settings), indent=1))

    @property
    def _reader(self) -> JournalReader:
        from mountnav.journal.database import default_url

        of_settings = default_url() if self._settings is None else self._settings.journal.where
        return JournalReader(self._asked.journal or of_settings)

    def _masked_lines(self, values: Iterable[object]) -> Iterator[str]:
        for value in values:
            yield json.dumps(self._masker.value(value), ensure_ascii=True, default=str)

    def _write_journal(self) -> None:
        wanted = Wanted(since=self._asked.since, until=self._asked.until)
        newest = self._reader.lines(wanted, limit=MOST_LINES, newest_first=True)[::-1]
        if len(newest) == MOST_LINES:
            self._found.missing["journal.jsonl (its beginning)"] = f"only the newest {MOST_LINES} lines"
        self._put_lines("journal.jsonl", self._masked_lines(as_json(line) for line in newest))

    def _write_audit(self) -> None:
        rows = self._reader.audits(since=self._asked.since, until=self._asked.until, limit=MOST_LINES)
        told = ({**asdict(row), "utc": row.utc.isoformat()} for row in reversed(rows))
        self._put_lines("audit.jsonl", self._masked_lines(told))

    def _write_runs(self) -> None:
        runs = [
            {
                "run_id": one.run_id,
                "started_utc": one.started_utc.isoformat(),
                "ended_utc": one.ended_utc.isoformat() if one.ended_utc else None,
                "version": one.version,
                "settings_sha256": one.settings_sha256,
            }
            for one in self._reader.runs(100)
        ]
        self._put("runs.json", json.dumps(runs, indent=1))

    def _write_report(self) -> None:
        if self._settings is None:
            return
        reader, asked = self._reader, self._asked
        reports = [report_of(reader, one.id, asked.since, asked.until) for one in self._settings.telescope]
        self._put("report.md", self._masker.text("\n".join(as_markdown(one) for one in reports)))
        told = [one.as_dict() for one in reports]
        self._put("report.json", json.dumps(self._masker.value(told), indent=1, default=str))

    def _write_recordings(self) -> None:
        """Nights that were recorded in the window, with their wire."""
        if self._settings is None:
            return
        for telescope in self._settings.telescope:
            folder = telescope.night.record
            if folder is None or not folder.is_dir():
                continue
            for path in sorted(folder.glob(f"{telescope.id}-????-??-??.jsonl")):
                if not self._is_of_window(path.stem[len(telescope.id) + 1 :]):
                    continue
                name = recording_name(path.name)
                try:
                    self._put_recording(name, path)
                except (OSError, ValueError, MountnavError) as trouble:
                    self._miss(name, trouble)

    def _is_of_window(self, date: str) -> bool:
        try:
            evening = datetime.fromisoformat(date).replace(tzinfo=UTC)
        except ValueError:
            return False
        # from noon to noon by the Sun, wherever on Earth
        return self._asked.since - timedelta(days=2) < evening < self._asked.until + timedelta(days=1)

    def _put_recording(self, name: str, path: Path) -> None:
        size = path.stat().st_size
        if size > MOST_RECORD_BYTES:
            self._found.missing[name] = f"it has {size / 1e6:.0f} MB: send {path.name} by itself"
            return

        def lines() -> Iterator[str]:
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    text = line.rstrip("\n")
                    try:
                        value = json.loads(text)
                    except ValueError:  # half a line, of a service that was killed
                        yield self._masker.text(text)
                        continue
                    # only what was changed is written anew: a recording is played by its very numbers
                    clean = self._masker.value(value)
                    yield text if clean == value else json.dumps(clean)

        self._put_lines(name, lines())

    def _ask_service(self) -> None:
        ask = self._asked.service
        if ask is None:
            return
        paths = {
            "service/health.json": "/v1/health",
            "service/capabilities.json": "/v1/capabilities",
            "service/telescopes.json": "/v1/telescopes",
            "service/jobs.json": "/v1/jobs?count=1000",
            "service/metrics.txt": "/metrics",
        }
        for telescope in () if self._settings is None else self._settings.telescope:
            paths[f"wire/{telescope.id}.jsonl"] = f"/v1/telescopes/{telescope.id}/wire"
        for name, path in paths.items():
            try:
                text = ask(path)
            except Exception as trouble:  # of whatever kind: it is told
                self._miss(name, trouble)
                continue
            self._put(name, self._masked_text(text))

    def _masked_text(self, text: str) -> str:
        """JSON, JSON lines or plain text, without secrets."""
        try:
            return json.dumps(self._masker.value(json.loads(text)), indent=1)
        except ValueError:
            pass
        lines = []
        for line in text.splitlines():
            try:
                lines.append(json.dumps(self._masker.value(json.loads(line))))
            except ValueError:
                lines.append(self._masker.text(line))
        return "\n".join(lines)

    def _write_system(self) -> None:
        disk = shutil.disk_usage(self._asked.config.resolve().parent)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        told = {
            "python": sys.version,
            "executable": sys.executable,
            "platform": platform.platform(),
            "machine": platform.machine(),
            "processors": os.cpu_count(),
            "memory_mb": _memory_mb(),
            "disk_free_mb": round(disk.free / 1e6),
            "open_files": [soft, hard],
            "utc": datetime.now(UTC).isoformat(),
            "local": datetime.now().astimezone().isoformat(),
            "packages": {one.name: one.version for one in importlib.metadata.distributions()},
            "environment": {
                name: "***" if _is_secret(name) else value
                for name, value in sorted(os.environ.items())
                if name.startswith(_SHOWN_VARIABLES)
            },
        }
        self._put("system.json", json.dumps(self._masker.value(told), indent=1))


def _is_secret(name: str) -> bool:
    return any(word in name.upper() for word in _SECRET_VARIABLES)


def _of_environment() -> list[str]:
    """Secrets that this process was given: they may stand in logs and texts."""
    return [value for name, value in os.environ.items() if _is_secret(name) and not value.startswith("/")]


def _memory_mb() -> int | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6)
    except (ValueError, OSError):
        return None


def summary(found: Bundled) -> dict[str, Any]:
    """What was made, as JSON values."""
    return {"files": found.files, "missing": found.missing}
