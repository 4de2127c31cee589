"""Puts fake devices on real wires - pseudo-terminals, TCP, UDP - each in a thread of its own."""

from drivers.fakes.bench.pty import FakeOnPty
from drivers.fakes.bench.slow_line import SlowLine
from drivers.fakes.bench.tcp import FakeOnTcp
from drivers.fakes.bench.thread import Bench, Fake
from drivers.fakes.bench.udp import FakeOnUdp

__all__ = ["Bench", "Fake", "FakeOnPty", "FakeOnTcp", "FakeOnUdp", "SlowLine"]
