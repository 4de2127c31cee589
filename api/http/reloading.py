"""Telescopes added, changed and taken out of a running service; the others go on untouched.

All that is new is put together before anything is let go, so that wrong settings change nothing. The exchange
itself is one turn of the loop: each order finds the telescopes of before or those of after.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from fastapi import FastAPI
from pydantic import ValidationError

from api.access.callers import Caller
from api.nights.nights import NightRunner, Nights, nights_of
from api.observatory.observatory import Observatory, Telescope, build_telescope, open_quietly
from api.orders.dispatcher import preempt
from api.orders.watching import Watch
from api.service import Service
from mountnav.errors import BadRequest, Busy, JournalFailed
from mountnav.settings.observatory import Settings

_log = logging.getLogger(__name__)

_FIRST_READINGS_S = 5.0
"""Longest wait for the first readings of the new telescopes, s, as at the start of a service. Doubled, a
reload with a silent mount is answered 5 s later."""

_ONE_AT_A_TIME = asyncio.Lock()


@dataclass(frozen=True, slots=True)
class Reloaded:
    """Ids of telescopes by what became of them, and tables of the settings that need a restart."""

    added: tuple[str, ...]
    changed: tuple[str, ...]
    removed: tuple[str, ...]
    untouched: tuple[str, ...]
    needs_restart: tuple[str, ...]

    @property
    def is_nothing(self) -> bool:
        """Whether all telescopes are as they were."""
        return not (self.added or self.changed or self.removed)


async def reloaded(app: FastAPI, caller: Caller) -> Reloaded:
    """Read the settings again, and exchange the telescopes that differ.

    Raises
    ------
    BadRequest
        The service was not started with a settings file, or it is a virtual observatory.
    BadSettings
        The file is wrong: nothing was changed.
    Busy
        A telescope that is taken out or changed isn't idle: nothing was changed.
    """
    service: Service = app.state.service
    read_again = getattr(app.state, "read_again", None)
    if read_again is None or service.settings.demo is not None:
        raise BadRequest(
            "this service was made without a settings file, or is a virtual observatory",
            advice="start it again with the settings that you want",
        )
    async with _ONE_AT_A_TIME:
        told = await _exchanged(service, await asyncio.to_thread(read_again), caller)
        app.state.settings = service.settings
    return told


def compared(now: Settings, wanted: Settings) -> Reloaded:
    """What differs."""
    before = {one.id: one for one in now.telescope}
    after = {one.id: one for one in wanted.telescope}
    both = [name for name in after if name in before]
    tables = (name for name in Settings.model_fields if name != "telescope")
    return Reloaded(
        added=tuple(name for name in after if name not in before),
        changed=tuple(name for name in both if after[name] != before[name]),
        removed=tuple(name for name in before if name not in after),
        untouched=tuple(name for name in both if after[name] == before[name]),
        needs_restart=tuple(name for name in tables if getattr(now, name) != getattr(wanted, name)),
    )


async def _exchanged(service: Service, read: Settings, caller: Caller) -> Reloaded:
    told = compared(service.settings, read)
    if told.is_nothing:
        return told
    # all other tables are those that the service runs with
    settings = service.settings.model_copy(update={"telescope": read.telescope})
    try:  # what a door shows must still be there
        Settings.model_validate(settings.model_dump())
    except ValidationError as error:
        raise BadRequest(
            "the telescopes don't go with the other tables that the service runs with",
            advice=f"start it again: {', '.join(told.needs_restart)} changed as well",
        ) from error
    _require_idle(service, told)
    fresh = await asyncio.to_thread(_built, service, settings, told)
    nights = nights_of(
        settings.model_copy(
            update={"telescope": tuple(one for one in settings.telescope if one.id in fresh)}
        ),
        Observatory(tuple(fresh.values())),
        service.catalog,
        service.jobs.heard,
        service.journal,
        make_way=partial(preempt, service.dispatcher, service.jobs),
    )
    try:
        _require_idle(service, told)  # while they were put together, something may have begun
    except Busy:
        await asyncio.gather(*(one.close() for one in fresh.values()))
        raise
    before, touched = service.settings, {*told.added, *told.changed, *told.removed}
    # from here to the end of the exchange nothing waits
    gone, runners, watches = _exchange(service, settings, fresh, nights, told)
    request = {"added": told.added, "changed": told.changed, "removed": told.removed}
    service.audit.note(caller, "reload", request=request)
    await asyncio.gather(*(one.close() for one in runners), return_exceptions=True)
    await asyncio.gather(*(one.close() for one in watches), return_exceptions=True)
    ends = await asyncio.gather(*(one.close() for one in gone), return_exceptions=True)
    for one, trouble in zip(gone, ends, strict=True):
        if isinstance(trouble, Exception):
            _log.error("%s could not be let go well", one.id, exc_info=trouble)
    await asyncio.gather(*(open_quietly(one) for one in fresh.values()))
    with suppress(TimeoutError):
        async with asyncio.timeout(_FIRST_READINGS_S):
            await asyncio.gather(*(_read(service.dispatcher.watch(name)) for name in fresh))
    try:
        await service.nights.start()
    except JournalFailed as failed:
        _log.error("nights could not begin: %s", failed)
    for name in _doors(before, settings, told):
        await service.listeners.renew(name, touched)
    _log.info("settings read again: added %s, changed %s, removed %s", told.added, told.changed, told.removed)
    return told


async def _read(watch: Watch) -> None:
    """Wait for a reading of now."""
    revision = watch.latest.revision
    watch.wake()
    await watch.next(revision)


def _require_idle(service: Service, told: Reloaded) -> None:
    for name in (*told.changed, *told.removed):
        job, lease = service.jobs.running_on(name), service.leases.of(name)
        why = None
        if job is not None:
            why = f"it has the job {job.kind} ({job.id})"
        elif lease is not None:
            why = f"{lease.holder} holds its lease"
        elif service.nights.is_running(name):
            why = "its night is under way"
        elif service.dispatcher.watch(name).latest.slewing:
            # by its hand control, or another program: to let it go would stop it
            why = "it slews"
        if why is not None:
            raise Busy(
                f"{name} can't be changed or taken out: {why}; nothing was changed",
                device=name,
                advice="end that, then reload again",
            )


def _built(service: Service, settings: Settings, told: Reloaded) -> dict[str, Telescope]:
    """The telescopes that are new or changed; nothing is opened but fakes. Raises `BadSettings`."""
    built: dict[str, Telescope] = {}
    try:
        for one in settings.telescope:
            if one.id in (*told.added, *told.changed):
                built[one.id] = build_telescope(
                    one, settings, service.catalog, service.jobs.heard, service.solver.of, service.journal
                )
    except BaseException:
        for made in built.values():
            if made.bench is not None:
                made.bench.stop()
        raise
    return built


def _exchange(
    service: Service, settings: Settings, fresh: dict[str, Telescope], nights: Nights, told: Reloaded
) -> tuple[list[Telescope], list[NightRunner], list[Watch]]:
    """Have the new telescopes in the place of the old ones, everywhere, in one turn of the loop."""
    kept = {one.id: one for one in service.observatory.telescopes}
    gone = service.observatory.put([fresh.get(one.id) or kept[one.id] for one in settings.telescope])
    watches = service.dispatcher.take_in(tuple(fresh.values()))
    watches += [service.dispatcher.let_go(name) for name in told.removed]
    runners = service.nights.exchange((*told.changed, *told.removed), nights)
    service.settings = settings
    if service.longer is not None:
        service.longer.know(settings)
    if service.job_store is not None:
        service.job_store.know(frozenset(one.id for one in settings.telescope))
    if service.mornings is not None:
        service.mornings.know(settings)
    service.events.publish(
        "telescopes",
        {"added": list(told.added), "changed": list(told.changed), "removed": list(told.removed)},
    )
    return gone, runners, watches


def _doors(before: Settings, settings: Settings, told: Reloaded) -> list[str]:
    """Listeners that show a telescope which differs."""
    touched = {*told.added, *told.changed, *told.removed}
    shown = set(settings.indi_server.telescopes)
    doors = ["indi"] if not shown or shown & touched else []
    for name, table in (("lx200", settings.lx200_server), ("stellarium", settings.stellarium)):
        # without a name it is the first, which may be another one now
        first = table.telescope or _first(settings)
        if first in touched or first != (table.telescope or _first(before)):
            doors.append(name)
    return doors


def _first(settings: Settings) -> str | None:
    return settings.telescope[0].id if settings.telescope else None
