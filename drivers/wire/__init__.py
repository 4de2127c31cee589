"""Bytes to a device and back: lines, questions and answers, datagrams, logs, recordings."""
