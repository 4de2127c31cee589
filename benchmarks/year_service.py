"""The service of `benchmarks.year`: the real one, with a line to its parent for what happens to it.

Run by the parent: python -m benchmarks.year_service SETTINGS STEP_S TRUTH_FILE

Everything is what `mountnav serve` runs. Beside it a thread reads orders from the standard input, one JSON a
line, and answers on the standard output with lines that begin with ``@``: a power cut of a mount, a step of
the service's clock (the sky's and the mounts' own go on), where a tube truly looked. Each slew, park, home
and sync that reaches a fake mount is appended to TRUTH_FILE before it is carried out. When the parent is
gone, the service ends.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import api.http.serving as serving
import api.observatory.fake_mounts as fake_mounts
import api.observatory.virtual as virtual
from api.http.app import create_app
from drivers.fakes.faults import Fault
from mountnav.errors import MountnavError
from mountnav.settings.observatory import Settings
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Icrs


class SteppedClock(FastClock):
    """The service's clock: its UTC may be stepped, as by an operator or a time server; its seconds never."""

    step_s = 0.0

    def __call__(self) -> datetime:
        """Aware UTC, as the service takes it."""
        return super().__call__() + timedelta(seconds=self.step_s)

    def sky(self) -> datetime:
        """The UTC that the sky and the mounts' own clocks go by."""
        return super().__call__()


class Under:
    """What the orders are carried out on."""

    clock: SteppedClock | None = None
    app: Any = None
    truth: Path | None = None


def sky_now() -> datetime:
    """The true present."""
    assert Under.clock is not None
    return Under.clock.sky()


def service_of(utc: datetime | None) -> datetime | None:
    """The true instant of one by the service's clock."""
    assert Under.clock is not None
    return None if utc is None else utc - timedelta(seconds=Under.clock.step_s)


class TrueMechanics(Mechanics):
    """Lives under the true sky, is asked in the service's time, and notes what reaches it."""

    name = ""

    def truth(self, utc: datetime | None = None) -> Icrs:
        """At an instant of the service's clock."""
        return super().truth(service_of(utc))

    def tube_angle_deg(self, utc: datetime | None = None) -> float:
        """At an instant of the service's clock."""
        return super().tube_angle_deg(service_of(utc))


def powered(*given: Any, machine: Machine | None = None, **more: Any) -> TrueMechanics:
    """Mechanics with absolute encoders: what wakes at home in another posture needs a person's hands."""
    built = replace(machine or Machine(), boots_believing="kept")
    return TrueMechanics(*given, machine=built, clock=sky_now, **more)


def noted(mechanics: TrueMechanics, name: str) -> None:
    """Have each order noted on the disk before it is carried out."""
    for order in ("slew", "park", "home", "sync", "unpark", "stop"):
        carry_out: Callable[..., Any] = getattr(mechanics, order)

        def noting(*given: Any, _order: str = order, _do: Callable[..., Any] = carry_out, **more: Any) -> Any:
            assert Under.truth is not None
            assert Under.clock is not None
            line = {"utc": Under.clock().isoformat(), "telescope": name, "order": _order}
            with Under.truth.open("a", encoding="utf-8") as opened:
                opened.write(json.dumps(line) + "\n")
            return _do(*given, **more)

        setattr(mechanics, order, noting)


def answered(asked: dict[str, Any]) -> dict[str, Any]:
    """Carry one order out."""
    assert Under.clock is not None
    match asked:
        case {"do": "now"}:
            return {"utc": Under.clock().isoformat(), "sky_utc": sky_now().isoformat()}
        case {"do": "step", "by_s": by_s}:
            Under.clock.step_s += by_s
            return {"utc": Under.clock().isoformat()}
        case {"do": "truth", "telescope": name, "utcs": utcs}:
            mechanics = telescope(name).mechanics
            places = [mechanics.truth(datetime.fromisoformat(utc).astimezone(UTC)) for utc in utcs]
            return {"places": [[place.ra_deg, place.dec_deg] for place in places]}
        case {"do": "power-cut", "telescope": name, "for_s": for_s}:
            # dead at once, and it begins again as a mount does that was switched on
            spoken = telescope(name).bench.fake
            spoken._fake.add_fault(Fault("reboot", for_s=for_s))
            return {"boots": telescope(name).mechanics.boots}
    return {"wrong": f"no such order: {asked}"}


def telescope(name: str) -> Any:
    """One of the running service."""
    return Under.app.state.service.observatory.telescope(name)


def listen() -> None:
    """Carry out the parent's orders until it is gone."""
    for line in sys.stdin:
        try:
            told = answered(json.loads(line))
        except (MountnavError, AttributeError, ValueError) as error:
            told = {"wrong": f"{type(error).__name__}: {error}"}
        sys.stdout.write(f"@{json.dumps(told)}\n")
        sys.stdout.flush()
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> int:
    """Serve."""
    settings_file, step_s, Under.truth = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])

    def clock(speed: float, start: datetime) -> SteppedClock:
        Under.clock = SteppedClock(speed, start)
        Under.clock.step_s = step_s
        return Under.clock

    def app(settings: Settings) -> Any:
        Under.app = create_app(settings)
        return Under.app

    def mechanics(one: Any, settings: Settings) -> Mechanics:
        made = make_mechanics(one, settings)
        assert isinstance(made, TrueMechanics)
        noted(made, one.id)
        return made

    make_mechanics = fake_mounts.mechanics_of
    vars(virtual)["FastClock"] = clock
    vars(serving)["create_app"] = app
    vars(fake_mounts).update(Mechanics=powered, utc_now=sky_now)
    vars(sys.modules["api.observatory.observatory"])["mechanics_of"] = mechanics
    threading.Thread(target=listen, name="orders of the year", daemon=True).start()
    return serving.serve(Settings.load(Path(settings_file)))


if __name__ == "__main__":
    sys.exit(main())
