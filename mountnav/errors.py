"""The error tree. Each error tells what happened, to which device, and what the user can do.

::

    MountnavError                   slug                 retryable
    ├── DeviceError                                                device side
    │   ├── DeviceMissing           device-missing       yes       no such port, or it can't be opened
    │   ├── DeviceSilent            device-silent        yes       no answer within the deadline
    │   ├── DeviceGarbled           device-garbled       yes       answers that match nothing
    │   ├── CameraStale             camera-stale         no        the camera hands out old frames as new
    │   ├── DeviceRefused           device-refused       no        the device said no
    │   ├── RefusedButDone          refused-but-done     no        it said no, and did it all the same
    │   ├── SyncIgnored             sync-ignored         no        it said yes, and nothing changed
    │   └── SyncElsewhere           sync-elsewhere       no        it took another place than it was told
    ├── SkyError                                                   sky side
    │   ├── SolveFailed             solve-failed         yes       the frame was not identified (reason)
    │   ├── OffsetTooLarge          offset-too-large     no        solved, but too far off to be believed
    │   ├── OutsideLimits           outside-limits       no        target or way are not allowed (which limit)
    │   ├── SyncRefused             sync-refused         no        solved, but not synced on (why)
    │   ├── ModelRefused            model-refused        no        a pointing model can't be fitted or applied
    │   ├── MountMoved              mount-moved          yes       the mount moved during an exposure
    │   └── TargetNotReached        target-not-reached   yes       tries or time ran out
    ├── UserError                                                  user side
    │   ├── BadFrame                bad-frame            no        a file that is no usable image
    │   ├── BadSettings             bad-settings         no        the configuration is wrong (line, fix)
    │   │   └── BadCatalog          bad-catalog          no        a star catalog is damaged or no such thing
    │   ├── BadRequest              bad-request          no        values that make no sense together
    │   └── NotFound                not-found            no        no telescope, job or file of that name
    ├── JournalFailed           journal-failed       yes       what is ordered can't be written down
    ├── StoreFailed             store-failed         yes       an archive's results can't be written
    │   └── ResultsDiffer       results-differ       no        the same frames gave other results
    ├── StarsUnavailable            stars-unavailable    yes       no catalog has stars for a place just now
    ├── Busy                        busy                 yes       another job holds the telescope
    └── Cancelled                   cancelled            no        somebody stopped it
"""

from __future__ import annotations

from enum import StrEnum


class MountnavError(Exception):
    """Anything that mountnav reports on purpose.

    Parameters
    ----------
    what : str
        What happened, in one sentence.
    device : str, optional
        Name or address of the device it happened to.
    advice : str, optional
        What the user can do about it.
    """

    slug: str = "error"
    retryable: bool = False

    def __init__(self, what: str, *, device: str | None = None, advice: str | None = None) -> None:
        self.what = what
        self.device = device
        self.advice = advice
        text = f"{device}: {what}" if device else what
        super().__init__(f"{text} ({advice})" if advice else text)


class DeviceError(MountnavError):
    """Something a device did, or did not do."""

    slug = "device-error"


class DeviceMissing(DeviceError):
    """The device's port doesn't exist or can't be opened, or its link is lost."""

    slug = "device-missing"
    retryable = True


class DeviceSilent(DeviceError):
    """No answer came within the deadline."""

    slug = "device-silent"
    retryable = True


class DeviceGarbled(DeviceError):
    """Answers came that match nothing the question allows."""

    slug = "device-garbled"
    retryable = True


class Refusal(StrEnum):
    """Why a device said no."""

    BELOW_HORIZON = "below-horizon"
    LIMIT = "limit"
    PARKED = "parked"
    BUSY = "busy"
    UNTRUSTED = "untrusted"
    SITE_OR_TIME = "site-or-time"
    """Mount and settings contradict each other on where it stands or what time it is."""
    NOT_ALIGNED = "not-aligned"
    NOT_TRACKING = "not-tracking"
    UNSUPPORTED = "unsupported"
    OTHER = "other"


class DeviceRefused(DeviceError):
    """The device understood and said no.

    Parameters
    ----------
    what, device, advice
        As of every error.
    reason : Refusal
        As far as it is known.
    """

    slug = "device-refused"

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        reason: Refusal = Refusal.OTHER,
    ) -> None:
        super().__init__(what, device=device, advice=advice)
        self.reason = reason

    @property
    def of_place(self) -> bool:
        """Whether it refuses the place alone, by a limit or a horizon of its own; another may be allowed."""
        return self.reason in (Refusal.LIMIT, Refusal.BELOW_HORIZON)


class CameraStale(DeviceError):
    """The camera hands out frames from before as if they were new: the same pixels, or the sky of before."""

    slug = "camera-stale"


class RefusedButDone(DeviceError):
    """The device said no, and did what it was ordered all the same; its position counts no more.

    No `DeviceRefused`: what goes on after a refusal must not go on after this.
    """

    slug = "refused-but-done"


class SyncIgnored(DeviceError):
    """The device accepted a sync and its reading did not follow."""

    slug = "sync-ignored"


class SyncElsewhere(DeviceError):
    """The device took another place than it was synced to (half of it, say); its position counts no more."""

    slug = "sync-elsewhere"


class SkyError(MountnavError):
    """Something about the sky or where the telescope looks."""

    slug = "sky-error"


class SolveFailed(SkyError):
    """The frame was not identified.

    Parameters
    ----------
    what, device, advice
        As of every error.
    reason : str
        The verdict's `mountnav.solution.Reason`, in its words.
    """

    slug = "solve-failed"
    retryable = True

    def __init__(
        self, what: str, *, device: str | None = None, advice: str | None = None, reason: str = ""
    ) -> None:
        super().__init__(what, device=device, advice=advice)
        self.reason = reason


class OffsetTooLarge(SkyError):
    """The frame was solved, but so far off that nothing is moved or synced by it."""

    slug = "offset-too-large"


class LimitKind(StrEnum):
    """Which limit it is."""

    ALTITUDE = "altitude"
    HORIZON = "horizon"
    HOUR_ANGLE = "hour-angle"
    DECLINATION = "declination"
    MERIDIAN = "meridian"
    SUN = "sun"
    MOON = "moon"
    DAYLIGHT = "daylight"
    UNREACHABLE = "unreachable"


class OutsideLimits(SkyError):
    """The target, or a place on the way to it, is outside a limit; nothing was moved.

    Parameters
    ----------
    what, device, advice
        As of every error.
    limit : LimitKind
        The limit that would be violated.
    """

    slug = "outside-limits"

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        limit: LimitKind = LimitKind.ALTITUDE,
    ) -> None:
        super().__init__(what, device=device, advice=advice)
        self.limit = limit


class SyncDoubt(StrEnum):
    """Why a solved frame is not synced on; each has its own advice."""

    POLICY_NEVER = "policy-never"
    NOT_FIRST = "policy-not-the-first-of-the-night"
    SAME_TARGET = "policy-target-had-its-sync"
    NOT_OFF_ENOUGH = "policy-not-off-enough"
    TOO_MANY = "too-many-syncs"
    TOO_FAR = "offset-too-large"
    NOT_EXPECTED = "offset-not-expected"
    TOO_OLD = "frame-too-old"
    OLDER_THAN_MOVE = "frame-older-than-the-last-move"
    MOVED = "mount-moved"
    NEAR_MERIDIAN = "too-near-the-meridian"
    NEAR_POLE = "too-near-the-pole"
    TOLD_TOO_MUCH = "told-syncs-add-up-to-too-much"
    TOO_LOW = "altitude-too-low"
    ODDS = "odds-too-low"
    FEW_STARS = "too-few-stars"
    SCALE = "scale-not-as-before"
    ROTATION = "rotation-not-as-before"
    PARITY = "parity-not-as-before"
    WRONG_SIDE = "pier-side-misreported"
    NOT_FRESH = "frame-not-proven-new"
    NOT_TRACKING = "not-tracking"
    UNSURE = "offset-not-known-well-enough"


class SyncRefused(SkyError):
    """The frame was solved, but nothing is synced by it; nothing was sent.

    Parameters
    ----------
    what, device, advice
        As of every error.
    doubts : tuple of SyncDoubt
        All that stood against it, the gravest first.
    """

    slug = "sync-refused"

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        doubts: tuple[SyncDoubt, ...] = (),
    ) -> None:
        super().__init__(what, device=device, advice=advice)
        self.doubts = doubts


class ModelRefused(SkyError):
    """A pointing model can't be fitted to what there is, doesn't predict better, or can't be applied."""

    slug = "model-refused"


class MountMoved(SkyError):
    """The mount moved while the frame was exposed; the pair is refused."""

    slug = "mount-moved"
    retryable = True


class NotReached(StrEnum):
    """Why a target was not reached."""

    TRIES = "tries-out"
    TIME = "time-out"
    STUCK = "tube-does-not-follow"
    WORSE = "corrections-make-it-worse"
    SLIPPING = "pointing-jumps-from-slew-to-slew"
    REST = "came-to-rest-elsewhere"
    RESTLESS = "tube-does-not-hold-still"
    SIDE = "wrong-side"
    POLE = "hole-at-the-pole"
    OTHER = "other"


class TargetNotReached(SkyError):
    """Tries or time ran out, or something stood in the way, before the target was centered.

    Parameters
    ----------
    what, device, advice
        As of every error.
    reason : NotReached
        Why, for programs.
    """

    slug = "target-not-reached"
    retryable = True

    def __init__(
        self,
        what: str,
        *,
        device: str | None = None,
        advice: str | None = None,
        reason: NotReached = NotReached.OTHER,
    ) -> None:
        super().__init__(what, device=device, advice=advice)
        self.reason = reason


class UserError(MountnavError):
    """Something the caller can put right."""

    slug = "user-error"


class BadFrame(UserError):
    """The file or upload is no usable image."""

    slug = "bad-frame"


class BadSettings(UserError):
    """The configuration is wrong; the message names the place and the fix."""

    slug = "bad-settings"


class BadCatalog(BadSettings):
    """A star catalog's file is damaged or is none; tells the offset and what was expected there."""

    slug = "bad-catalog"


class BadRequest(UserError):
    """The request's values make no sense."""

    slug = "bad-request"


class NotFound(UserError):
    """There is nothing of that name."""

    slug = "not-found"


class JournalFailed(MountnavError):
    """The journal can't be written: nothing is ordered that would leave no trace, but a stop or a park."""

    slug = "journal-failed"
    retryable = True


class JournalDamaged(JournalFailed):
    """The journal's file is damaged: it is never used, nor replaced by itself."""

    retryable = False


class StoreFailed(MountnavError):
    """An archive's results can't be written: a full disk, a store that is gone. What is finished stays."""

    slug = "store-failed"
    retryable = True


class ResultsDiffer(StoreFailed):
    """Frames of an archive were solved twice with the same settings, and the results are not the same."""

    slug = "results-differ"
    retryable = False


class StarsUnavailable(MountnavError):
    """An online catalog has no stars for a place, neither live nor cached, and there is nothing behind it."""

    slug = "stars-unavailable"
    retryable = True


class Busy(MountnavError):
    """Another job holds the telescope."""

    slug = "busy"
    retryable = True


class Cancelled(MountnavError):
    """The work was stopped on request."""

    slug = "cancelled"
