"""Runs the steps of a trial one after the other; what was declined, or went wrong, is told as well."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

from drivers.acceptance.findings import Capabilities, StepResult
from drivers.acceptance.steps import Step
from drivers.acceptance.trial import Trial, halted
from mountnav.errors import MountnavError
from mountnav.sky.coordinates import utc_now

Ask = Callable[[str], Awaitable[bool]]
"""Asks the owner; True for yes."""


async def tried(
    trial: Trial,
    steps: Sequence[Step],
    ask: Ask,
    *,
    driver: str,
    told: Callable[[StepResult], None] = lambda _: None,
) -> Capabilities:
    """Try a mount.

    Parameters
    ----------
    trial : Trial
        Its mount is open.
    steps : sequence of Step
        In order of danger.
    ask : callable
        Asked before each step, and before a position that doesn't count is taken for right.
    driver : str
        For the report.
    told : callable
        Told of each step when it is over.

    Returns
    -------
    Capabilities
    """
    found = begun(trial, driver)
    await go_on(found, trial, steps, ask, told)
    return found


def begun(trial: Trial, driver: str) -> Capabilities:
    """The report of a trial of which nothing was tried yet."""
    report = trial.mount.report
    return Capabilities(
        mount=trial.mount.name,
        identity=report.identity if report else "unknown",
        driver=driver,
        began_utc=utc_now().isoformat(timespec="seconds"),
        skills=sorted(trial.mount.skills),
        problems=list(report.problems) if report else [],
    )


async def go_on(
    found: Capabilities,
    trial: Trial,
    steps: Sequence[Step],
    ask: Ask,
    told: Callable[[StepResult], None] = lambda _: None,
) -> None:
    """Try the steps, and add what comes of each to the report: what was done is in it however it ends."""
    for step in steps:
        result = await _one(trial, step, ask)
        found.steps.append(result)
        told(result)


async def _one(trial: Trial, step: Step, ask: Ask) -> StepResult:
    if not await ask(f"{step.name}: {step.asks}?"):
        return StepResult(step.name, done=False, why_not="declined")
    if step.moves and not trial.mount.trusted:
        if not await ask("its position may be wrong; is what it says about where it points right?"):
            return StepResult(step.name, done=False, why_not="its position can't be trusted")
        trial.mount.trust()
    noted = trial.mount.wire_log.count
    trial.mount.wire_log.note("event", meaning=f"step {step.name}")
    try:
        findings = await step.do(trial)
    except MountnavError as error:
        stopped = await halted(trial) if step.moves else ""
        return StepResult(step.name, done=False, why_not=f"{error}{stopped}")
    assert trial.mount.wire_log.count > noted, "the step noted itself"
    return StepResult(step.name, findings=findings)
