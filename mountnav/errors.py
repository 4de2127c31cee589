"""The error tree. Each error tells what happened, to which device, and what the user can do.

::

    MountnavError                   slug                 retryable
    ├── DeviceError                                                device side
    │   ├── DeviceMissing           device-missing       yes       no such port, or it can't be opened
    │   ├── DeviceSilent            device-silent        yes       no answer within the deadline
    │   ├── DeviceGarbled           device-garbled       yes       answers that match nothing
    │   ├── DeviceRefused           device-refused       no        the device said no
    │   └── SyncIgnored             sync-ignored         no        it said yes, and nothing changed
    ├── SkyError                                                   sky side
    │   ├── NotSolved               solve-failed         yes       the frame was not identified (reason)
    │   ├── OffsetImplausible       offset-too-large     no        solved, but too far off to be believed
    │   ├── OutsideLimits           outside-limits       no        the target is not allowed
    │   ├── MountMoved              mount-moved          yes       the mount moved during an exposure
    │   └── TargetNotReached        target-not-reached   yes       tries or time ran out
    ├── UserError                                                  user side
    │   ├── BadFrame                bad-frame            no        a file that is no usable image
    │   ├── BadSettings             bad-settings         no        the configuration is wrong (line, fix)
    │   ├── BadRequest              bad-request          no        values that make no sense together
    │   └── Unknown                 not-found            no        no telescope, job or file of that name
    ├── Busy                        busy                 yes       another job holds the telescope
    └── Cancelled                   cancelled            no        somebody stopped it
"""

from __future__ import annotations

from typing import ClassVar


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

    slug: ClassVar[str] = "error"
    retryable: ClassVar[bool] = False

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


class DeviceRefused(DeviceError):
    """The device understood and said no."""

    slug = "device-refused"


class SyncIgnored(DeviceError):
    """The device accepted a sync and its reading did not follow."""

    slug = "sync-ignored"


class SkyError(MountnavError):
    """Something about the sky or where the telescope looks."""

    slug = "sky-error"


class NotSolved(SkyError):
    """The frame could not be identified; `what` holds the reason."""

    slug = "solve-failed"
    retryable = True


class OffsetImplausible(SkyError):
    """The frame was solved, but so far off that nothing is moved or synced by it."""

    slug = "offset-too-large"


class OutsideLimits(SkyError):
    """The target is below the horizon or outside a limit; nothing was moved."""

    slug = "outside-limits"


class MountMoved(SkyError):
    """The mount moved while the frame was exposed; the pair is refused."""

    slug = "mount-moved"
    retryable = True


class TargetNotReached(SkyError):
    """Tries or time ran out before the target was within the tolerance."""

    slug = "target-not-reached"
    retryable = True


class UserError(MountnavError):
    """Something the caller can put right."""

    slug = "user-error"


class BadFrame(UserError):
    """The file or upload is no usable image."""

    slug = "bad-frame"


class BadSettings(UserError):
    """The configuration is wrong; the message names the place and the fix."""

    slug = "bad-settings"


class BadRequest(UserError):
    """The request's values make no sense."""

    slug = "bad-request"


class Unknown(UserError):
    """There is nothing of that name."""

    slug = "not-found"


class Busy(MountnavError):
    """Another job holds the telescope."""

    slug = "busy"
    retryable = True


class Cancelled(MountnavError):
    """The work was stopped on request."""

    slug = "cancelled"
