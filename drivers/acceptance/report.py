"""The report of a trial: findings that can be compared with those of a fake, and be read by people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a step: an outcome or a measurement.

    Attributes
    ----------
    key : str
        The same for every mount: ``move.north``.
    value : str or float
        A word for outcomes, a number for measurements.
    unit : str
        Of a number.
    fine : bool or None
        Whether it is as it should be; None for a mere measurement.
    words : str
        An explanation, where the value alone says too little.
    """

    key: str
    value: str | float
    unit: str = ""
    fine: bool | None = None
    words: str = ""

    @property
    def text(self) -> str:
        """Value and unit."""
        if isinstance(self.value, str):
            return self.value
        return f"{self.value:.4g}{' ' * bool(self.unit)}{self.unit}"


@dataclass(slots=True)
class StepResult:
    """The result of one step.

    Attributes
    ----------
    done : bool
        False if it was declined, or could not be tried.
    why_not : str
        Empty if it was done.
    """

    name: str
    done: bool = True
    why_not: str = ""
    findings: list[Finding] = field(default_factory=list)


@dataclass(slots=True)
class Capabilities:
    """The report of a trial: the mount's identity, and the results step by step."""

    mount: str
    identity: str
    driver: str
    began_utc: str
    skills: list[str]
    problems: list[str]
    steps: list[StepResult] = field(default_factory=list)

    def findings(self) -> dict[str, Finding]:
        """All findings by their keys."""
        return {finding.key: finding for step in self.steps for finding in step.findings}

    @property
    def is_fine(self) -> bool:
        """Whether no finding is bad."""
        return all(finding.fine is not False for finding in self.findings().values())

    def as_dict(self) -> dict[str, object]:
        """The content of a JSON file."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Difference:
    """An outcome in which a mount and a fake of its kind differ."""

    key: str
    mount: str
    fake: str


def differences(mount: Capabilities, fake: Capabilities) -> list[Difference]:
    """Outcomes (words, not measurements) in which the two differ; only of steps that both have done."""
    theirs = fake.findings()
    found = []
    for key, ours in mount.findings().items():
        other = theirs.get(key)
        if other is None or not (isinstance(ours.value, str) and isinstance(other.value, str)):
            continue
        if ours.value != other.value:
            found.append(Difference(key, ours.value, other.value))
    return found


def as_lines(report: Capabilities, fake: Capabilities | None) -> list[str]:
    """The report as lines of text."""
    lines = [f"{report.identity} at {report.mount}", f"skills: {', '.join(report.skills) or 'none'}"]
    lines += [f"problem: {problem}" for problem in report.problems]
    theirs: Mapping[str, Finding] = {} if fake is None else fake.findings()
    for step in report.steps:
        lines.append("")
        lines.append(f"{step.name}: {'done' if step.done else 'not done, ' + step.why_not}")
        lines += _rows(step.findings, theirs)
    if fake is not None:
        apart = differences(report, fake)
        lines.append("")
        lines.append(
            "where a fake of its kind does otherwise:" if apart else "a fake of its kind does the same"
        )
        lines += [f"  {other.key}: the mount {other.mount}, the fake {other.fake}" for other in apart]
    return lines


def _rows(findings: Iterable[Finding], theirs: Mapping[str, Finding]) -> list[str]:
    rows = []
    for finding in findings:
        mark = {True: "ok ", False: "BAD", None: "   "}[finding.fine]
        other = f"   (fake: {theirs[finding.key].text})" if finding.key in theirs else ""
        words = f"   {finding.words}" if finding.words else ""
        rows.append(f"  {mark} {finding.key}: {finding.text}{other}{words}")
    return rows
