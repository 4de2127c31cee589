"""The words of a hand control (NexStar, SynScan): bytes, readers of replies, and no I/O."""
