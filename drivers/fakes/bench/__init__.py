"""Puts fake devices on real wires - pseudo-terminals, TCP, UDP - each in a thread of its own."""

from drivers.fakes.bench.thread import Bench, Fake, SlowLine
from drivers.fakes.bench.wires import FakeOnPty, FakeOnTcp, FakeOnUdp

__all__ = ["Bench", "Fake", "FakeOnPty", "FakeOnTcp", "FakeOnUdp", "SlowLine"]
