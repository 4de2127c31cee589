"""Puts fake devices on real wires - pseudo-terminals, TCP, UDP - each in a thread of its own."""

from drivers.bench.pty import FakeOnPty
from drivers.bench.slow_line import SlowLine
from drivers.bench.tcp import FakeOnTcp
from drivers.bench.thread import Bench, Fake
from drivers.bench.udp import FakeOnUdp

__all__ = ["Bench", "Fake", "FakeOnPty", "FakeOnTcp", "FakeOnUdp", "SlowLine"]
