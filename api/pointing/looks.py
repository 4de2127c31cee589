"""Where the commands that judge a mount get its looks from: a journal, or a file of observations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from mountnav.devices import Epoch
from mountnav.errors import BadRequest
from mountnav.journal.records import CommandEnd, CommandRecord, Outcome
from mountnav.pointing.doctor.findings import Mounting
from mountnav.pointing.model.model import PointingModel
from mountnav.pointing.observation import PointingObservation, read_observations
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Site
from mountnav.sky.iers import read_tables

FILES = (".jsonl", ".ndjson")


@dataclass(frozen=True, slots=True)
class Looks:
    """The solved looks of a mount, and what is known of it.

    Attributes
    ----------
    epoch : {"apparent", "icrs"}
        What the mount is believed to speak.
    slew_ends : list of datetime
        When slews arrived; empty if it isn't known.
    synced_on : list of PointingObservation or None
        What was synced, with the reading after it; None if it isn't known.
    """

    observations: list[PointingObservation]
    site: Site
    epoch: Epoch
    mounting: Mounting | None = None
    slew_ends: list[datetime] = field(default_factory=list)
    synced_on: list[PointingObservation] | None = None


def read_looks(
    source: str | None,
    *,
    config: Path | None = None,
    telescope: str | None = None,
    since: str | None = None,
    until: str | None = None,
    latitude: float | None = None,
    longitude: float | None = None,
    epoch: str | None = None,
    mounting: Mounting | None = None,
    unsynced: bool = False,
) -> Looks:
    """Read looks, and what is known of the mount.

    Parameters
    ----------
    source : str or None
        A file of observations (.jsonl), a journal's file or URL; None: the journal of the settings, else the
        usual place.
    config : Path, optional
        Settings: site, journal, and the telescope's epoch and mounting.
    telescope : str, optional
        Needed where there are several.
    since, until : str, optional
        As `mountnav journal` takes them: an instant, or how long ago.
    latitude, longitude : float, optional
        Site in degrees, east positive, instead of the settings'.
    epoch : str, optional
        Instead of the settings'; else the one that most readings are in.
    unsynced : bool
        Nothing was synced in a file's looks (a journal knows by itself).

    Raises
    ------
    BadRequest
        Options that make no sense together, a bad file, no site.
    """
    from mountnav.journal.reading import instant
    from mountnav.settings.observatory import Settings

    read_tables()
    settings = None if config is None else Settings.load(config)
    site = _site(latitude, longitude, None if settings is None else settings.site.site)
    now = datetime.now(UTC)
    start, stop = (None if text is None else instant(text, now) for text in (since, until))
    if settings is not None:
        ids = [known.id for known in settings.telescope]
        telescope = telescope or (ids[0] if len(ids) == 1 else None)
        chosen = next((known for known in settings.telescope if known.id == telescope), None)
        if chosen is None:
            raise BadRequest(f"no telescope {telescope!r} in {config}", advice=f"one of {', '.join(ids)}")
        mounting = mounting or chosen.mount.mounting
        epoch = epoch or chosen.mount.epoch
    ends: list[datetime] = []
    syncs: list[PointingObservation] | None = None
    if source is not None and source.endswith(FILES):
        syncs = [] if unsynced else None
        found = [
            look
            for look in read_observations(Path(source))
            if (start is None or look.utc >= start) and (stop is None or look.utc < stop)
        ]
    else:
        url = source or ("" if settings is None else settings.journal.url)
        found, ends, syncs = looks_of_journal(url, telescope, start, stop)
    return Looks(found, site, _epoch(epoch, found), mounting, ends, syncs)


def _site(latitude: float | None, longitude: float | None, known: Site | None) -> Site:
    if (latitude is None) != (longitude is None):
        raise BadRequest("latitude and longitude belong together", advice="give both, or --config")
    if latitude is not None and longitude is not None:
        if not (-90.0 <= latitude <= 90.0 and -180.0 <= longitude <= 180.0):
            raise BadRequest(
                f"{latitude}, {longitude} is not a site", advice="deg: -90 to 90, -180 to 180 (east)"
            )
        return Site(latitude, longitude)
    if known is None:
        raise BadRequest("the site isn't known", advice="give --config, or --latitude and --longitude")
    return known


def _epoch(asked: str | None, observations: Sequence[PointingObservation]) -> Epoch:
    if asked not in (None, "apparent", "icrs"):
        raise BadRequest(f"--epoch {asked}", advice="apparent (JNow) or icrs (J2000)")
    if asked is not None:
        return "apparent" if asked == "apparent" else "icrs"
    kinds = Counter(isinstance(look.reading, Apparent) for look in observations)
    return "icrs" if kinds[False] > kinds[True] else "apparent"


def looks_of_journal(
    url: str, telescope: str | None, since: datetime | None, until: datetime | None
) -> tuple[list[PointingObservation], list[datetime], list[PointingObservation]]:
    """Read a telescope's looks, when its slews were done, and what it was synced on.

    Parameters
    ----------
    url : str
        A journal's file or URL; empty: the usual place.

    Raises
    ------
    BadRequest
        No telescope.
    BadSettings, JournalFailed
        The journal can't be read.
    """
    from mountnav.journal.database import default_url
    from mountnav.journal.observations import observations
    from mountnav.journal.reading import COMMAND, JournalReader, Wanted

    where = url or default_url()
    if telescope is None:
        raise BadRequest("a journal may hold several telescopes", advice="give --telescope")
    found = observations(where, telescope, since, until)
    wanted = Wanted(telescope=telescope, kinds=frozenset({COMMAND}), since=since, until=until)
    done = [
        (command, end)
        for command, end in JournalReader(where).commands(wanted)
        if end is not None and end.outcome in (Outcome.DONE, Outcome.LATE)
    ]
    ends = [end.utc for command, end in done if command.order == "slew"]
    syncs = [_synced(command, end, found) for command, end in done if command.order == "sync"]
    return found, ends, [sync for sync in syncs if sync is not None]


def _synced(
    command: CommandRecord, end: CommandEnd, found: Sequence[PointingObservation]
) -> PointingObservation | None:
    """A sync as an observation of the segment that it began; None where no look followed in that segment."""
    later = (look for look in found if look.utc >= end.utc and look.segment_id != command.segment_id)
    after = next(later, None)
    if after is None or command.place is None or end.after is None:
        return None
    place = command.place
    return replace(
        after,
        utc=end.after.utc,
        seen=apparent_to_icrs(place) if isinstance(place, Apparent) else place,
        reading=end.after.place,
        rotation_deg=None,
        parity=None,
        look_id="",
    )


def read_model(path: Path | None) -> PointingModel | None:
    """Read a pointing model's file, if one is given. Raises `BadRequest`."""
    if path is None:
        return None
    try:
        return PointingModel.load(path)
    except OSError as cause:
        raise BadRequest(f"can't read the model in {path.name}: {cause.strerror or cause}") from cause
